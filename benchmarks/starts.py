"""How surely panogs starts: the first depth of simulated recordings, judged by truth.

    python benchmarks/starts.py                           # 40 recordings: five rooms, eight kinds, 256 pixels
    python benchmarks/starts.py --rooms room1 --kinds operator-15+gait --json starts.jsonl
    python benchmarks/starts.py --video walk.mp4 --reference walk.tum --every 2 --firsts 0 60 120

A recording starts if a first depth passes its check, and the start is right if its positions are within 3% of the
path's length after Sim(3) alignment: depth is found anew from every keyframe later. How much of the view has a depth
within 15% of the truth, after its median ratio, is said beside it; videos have no true depth.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from panobench.bench.run.masking import apply_mask, choose_mask
from panobench.bench.run.request import RunRequest
from panobench.bench.run.setup import open_input
from panobench.bench.run.views import ChosenFrames
from panobench.depth.bootstrap import BootstrapDepth
from panobench.geometry import umeyama
from panobench.types import DepthEstimate, Frame

ROOMS = ("room1", "room2", "room3", "room4", "room5")
KINDS = (
    "operator-15+gait",
    "operator-30+gait+rolling-15ms",
    "operator-15+walkers-3+gait",
    "car-25",
    "operator-15+stitch-41mm+lenses-0.3+gait",
    "operator-15+gait+levelled+h264-0.1",
    "operator-5+turn-200+blur-10ms",
    "operator-15+walkers-3+rolling-15ms+stitch-41mm+lenses+gait+h264",
)
#: A start is right if its positions are within PATH_OFF of the path; depth counts where it is within DEPTH_OFF.
PATH_OFF, DEPTH_OFF = 0.03, 0.15


@dataclass(frozen=True)
class Started:
    """frames: taken until the answer. depth: share of the view within 15%. path: RMS over the path's length."""

    name: str
    frames: int
    ok: bool
    depth: float | None
    path: float | None
    hidden: float
    cpu_s: float
    message: str

    @property
    def right(self) -> bool:
        return self.path is not None and self.path <= PATH_OFF


def start(request: RunRequest, first: int = 0) -> Started:
    """Give the bootstrap the frames from ``first`` on until it answers."""
    frames = open_input(request)
    hidden = apply_mask(choose_mask(request.mask, request.dataset), frames, request.seed, lambda line: None)
    estimator = BootstrapDepth()
    estimator.start(frames.camera, request.seed)
    estimate, taken, began = None, 0, time.process_time()
    for k in range(first, len(frames)):
        taken += 1
        estimate = estimator.add(Frame(k, float(frames.times[k]), frames.image(k), mask=frames.frame_mask(k)))
        if estimate is not None:
            break
    estimate = estimate or estimator.finish()
    assert estimate is not None
    spent = time.process_time() - began
    name = f"{request.sequence}{f' from {first}' if first else ''}"
    share = hidden.hidden if hidden else 0.0
    return Started(
        name, taken, estimate.ok, _depth(frames, estimate), _path(frames, estimate), share, spent, estimate.message
    )


def _depth(frames: ChosenFrames, estimate: DepthEstimate) -> float | None:
    truth = frames.depth(estimate.frame_index)
    if truth is None:
        return None
    known = np.isfinite(truth) & (truth > 0) & frames.camera.valid_mask() & np.isfinite(estimate.depth)
    ratio = np.log(estimate.depth[known] / truth[known])
    area = frames.camera.solid_angle()[known]
    return float(area[np.abs(ratio - np.median(ratio)) < DEPTH_OFF].sum() / area.sum())


def _path(frames: ChosenFrames, estimate: DepthEstimate) -> float | None:
    """RMS of the estimator's positions after Sim(3) alignment over the length of the true path they cover."""
    truth = frames.groundtruth
    if truth is None or len(estimate.T_wc) < 4:
        return None
    pairs = [
        (estimate.T_wc[i][:3, 3], truth.T_wc[k][:3, 3])
        for i in sorted(estimate.T_wc)
        for k in [int(np.argmin(np.abs(truth.times - frames.times[i])))]
        if abs(truth.times[k] - frames.times[i]) < 0.012
    ]
    if len(pairs) < 4:
        return None
    found, true = (np.stack(p) for p in zip(*pairs))
    error = umeyama(found, true).apply_points(found) - true
    length = float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum())
    return float(np.sqrt((error**2).sum(axis=1).mean())) / max(length, 1e-9)


def requests(options: argparse.Namespace) -> Iterator[tuple[RunRequest, int]]:
    for first in options.firsts:
        if options.video:
            yield (
                RunRequest(
                    dataset="video", root=str(options.video), width=options.width, every=options.every,
                    groundtruth=str(options.reference), mask=options.mask,
                ),
                first,
            )  # fmt: skip
            continue
        for kind in options.kinds:
            for room in options.rooms:
                sequence = f"rooms/{room}+{kind}"
                mask = options.mask
                yield (
                    RunRequest(
                        dataset="disturbed", sequence=sequence, width=options.width, every=options.every, mask=mask
                    ),
                    first,
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS))
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), help="parts of a simulated recording")
    parser.add_argument("--video", type=Path, help="a video in place of simulated recordings")
    parser.add_argument("--reference", type=Path, help="the video's poses, TUM")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--firsts", nargs="+", type=int, default=[0], help="first frames")
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--mask", default="auto")
    parser.add_argument("--json", type=Path, help="also append a line of JSON for each")
    options = parser.parse_args()
    results = []
    for request, first in requests(options):
        found = start(request, first)
        results.append(found)
        depth, path = ("-" if v is None else f"{100 * v:.1f}%" for v in (found.depth, found.path))
        word = ("right" if found.right else "WRONG") + (", ok" if found.ok else ", not ok")
        print(f"{found.name}: {word}; {found.frames} frames, depth {depth}, path {path}, hidden "
              f"{found.hidden:.0%}, {found.cpu_s:.1f} CPU-s; {found.message}", flush=True)  # fmt: skip
        if options.json:
            with options.json.open("a") as lines:
                lines.write(json.dumps(asdict(found)) + "\n")
    right, passed = [r for r in results if r.right], [r for r in results if r.ok]
    wrong, frames = sum(not r.right for r in passed), np.median([r.frames for r in results])
    print(f"{len(results)} recordings: {len(passed)} passed their check, {wrong} of those are wrong; {len(right)} are "
          f"right; {frames:.0f} frames in the median")  # fmt: skip
    depths = [r.depth for r in right if r.depth is not None]
    if depths:
        print(f"depth within {100 * DEPTH_OFF:.0f}% in {100 * np.median(depths):.0f}% of the view in the median")


if __name__ == "__main__":
    main()
