"""How good the first depth is: `bootstrap` on the rooms, from several starts, through several cameras.

    python benchmarks/bootstrap.py                                    # all rooms, 256 and 512 wide, first frame
    python benchmarks/bootstrap.py --rooms room3 --widths 256 --cases every2 yaw6 turn15 --starts 0 40
    python benchmarks/bootstrap.py --root DATA --rooms synpano/devroom --cases pinhole fov360x80

A case is a way to start: `plain`, `everyN` (each N-th frame), `yawN` (N degrees a frame besides the camera's own
motion), `turnN` (N frames on the spot at 3 degrees each, then the motion), `fovHxV` (a panorama of limited view) and
`pinhole` (120 x 60 degrees, 288 pixels wide for a panorama of 512); joined by "+". Depth is compared after its median
ratio to the truth is taken out, positions after the best scale.
"""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.tables import text_table
from panobench.cameras.factory import parse_camera_option
from panobench.datasets.base import FrameSequence
from panobench.datasets.open import open_sequence
from panobench.datasets.synthetic.disturb import Disturbances, Disturber, roll_columns
from panobench.datasets.writing.converted import ConvertedSequence
from panobench.depth.bootstrap import BootstrapDepth
from panobench.geometry import invert_pose
from panobench.types import DepthEstimate, Frame, Trajectory

ROOMS = ("synpano/devroom", "room1", "room2", "room3", "room4", "room5", "tiny")
#: Degrees a frame of a turn on the spot.
TURN_STEP = 3.0


class Start(FrameSequence):
    """Frames ``index`` of a panorama's sequence, each turned to the right by ``angle_deg``."""

    def __init__(self, source: FrameSequence, index: NDArray[np.intp], angle_deg: NDArray[np.float64]) -> None:
        self.source, self.index, self.angle = source, index, angle_deg
        self.name, self.dataset, self.camera = source.name, source.dataset, source.camera
        self.times = np.arange(len(index)) / 15.0
        self._turn = Disturber(Disturbances(yaw=1.0), source.camera, len(index))

    def _columns(self, k: int) -> float:
        return float(self.angle[k]) / 360 * self.camera.width

    def image(self, k: int) -> NDArray[np.uint8]:
        image = self.source.image(int(self.index[k]))
        if not self.angle[k]:
            return image
        return np.round(np.clip(roll_columns(image.astype(float), self._columns(k)), 0, 255)).astype(np.uint8)

    def frame_name(self, k: int) -> str:
        return self.source.frame_name(int(self.index[k]))

    def depth(self, k: int) -> NDArray[np.float32] | None:
        depth = self.source.depth(int(self.index[k]))
        return None if depth is None else np.roll(depth, -round(self._columns(k)), axis=1)

    @property
    def groundtruth(self) -> Trajectory | None:
        truth = self.source.groundtruth
        assert truth is not None
        T = [truth.T_wc[i] @ self._turn.rotation(a) for i, a in zip(self.index, self.angle)]  # type: ignore[arg-type]
        return Trajectory(self.times, np.stack(T))


def opened(room: str, root: Path | None, case: str, width: int, first: int) -> FrameSequence:
    """The sequence that a case of a room is, ``width`` pixels for the whole turn."""
    dataset, _, name = room.rpartition("/")
    source = open_sequence(dataset or "rooms", name, root if dataset else None, None)
    every, yaw, turn, fov, kind = 1, 0.0, 0, None, "erp"
    for part in case.split("+"):
        word, number = re.fullmatch(r"([a-z]+)([0-9.x]*)", part).groups()  # type: ignore[union-attr]
        if word == "every":
            every = int(number)
        elif word == "yaw":
            yaw = float(number)
        elif word == "turn":
            turn = int(number)
        elif word == "fov":
            fov = number
        elif word == "pinhole":
            kind = "pinhole:front"
        elif word != "plain":
            raise SystemExit(f"case '{part}': must be plain, everyN, yawN, turnN, fovHxV or pinhole")
    moving = np.arange(first, len(source), every)
    index = np.concatenate([np.full(turn, first), moving])
    spot = TURN_STEP * np.minimum(np.arange(len(index)), turn)
    sequence: FrameSequence = Start(source, index, spot + yaw * np.arange(len(index)))
    size = width if kind == "erp" else width * 9 // 16 // 16 * 16
    if kind == "erp" and fov is None and source.camera.width == width:
        return sequence
    choice = parse_camera_option(kind, source.camera, size, fov)
    return ConvertedSequence(sequence, choice.camera, choice.R_target_source)


@dataclass(frozen=True)
class Score:
    """frames taken; error: median relative; over: share over 10% off; rms_mm of positions; cpu_s of the process."""

    frames: int
    error: float
    over: float
    rms_mm: float
    ok: bool
    cpu_s: float
    message: str


def score(sequence: FrameSequence, estimate: DepthEstimate, frames: int, cpu_s: float) -> Score:
    """Against the depth and the poses of the sequence."""
    truth, poses = sequence.depth(estimate.frame_index), sequence.groundtruth
    assert poses is not None
    off = np.full(1, np.nan)  # the truth of this frame's depth may not be known
    if truth is not None:
        known = np.isfinite(truth) & (truth > 0) & sequence.camera.valid_mask() & np.isfinite(estimate.depth)
        ratio = estimate.depth[known] / truth[known]
        off = np.abs(ratio / np.median(ratio) - 1)
    first = invert_pose(poses.T_wc[estimate.frame_index])
    rms = float("nan")
    if len(estimate.T_wc) > 1:
        index = sorted(estimate.T_wc)
        found = np.stack([estimate.T_wc[i][:3, 3] for i in index])
        true = np.stack([(first @ poses.T_wc[i])[:3, 3] for i in index])
        scale = float((found * true).sum() / max(float((found * found).sum()), 1e-12))
        rms = 1e3 * float(np.sqrt(((scale * found - true) ** 2).sum(axis=1).mean()))
    return Score(frames, float(np.median(off)), float(np.mean(off > 0.1)), rms, estimate.ok, cpu_s, estimate.message)


def measure(sequence: FrameSequence) -> Score:
    """Feed frames until there is an answer."""
    estimator = BootstrapDepth()
    estimator.start(sequence.camera)
    spent, estimate, k = 0.0, None, 0
    for k in range(len(sequence)):
        frame = Frame(k, float(sequence.times[k]), sequence.image(k))
        began = time.process_time()
        estimate = estimator.add(frame)
        spent += time.process_time() - began
        if estimate is not None:
            break
    if estimate is None:
        began = time.process_time()
        estimate = estimator.finish()
        spent += time.process_time() - began
    assert estimate is not None
    return score(sequence, estimate, k + 1, spent)


def rows(options: argparse.Namespace) -> Iterator[list[str]]:
    for room in options.rooms:
        for case in options.cases:
            for width in options.widths:
                for first in options.starts:
                    if (room == "synpano/devroom" and first % 10) or (room == "tiny" and first > 20):
                        continue  # devroom has depth for every tenth frame, tiny has 40 frames
                    s = measure(opened(room, options.root, case, width, first))
                    yield [
                        room.rpartition("/")[2], case, str(width), str(first), str(s.frames), f"{100 * s.error:.2f}",
                        f"{100 * s.over:.1f}", f"{s.rms_mm:.2f}", f"{s.cpu_s:.1f}", "yes" if s.ok else "NO", s.message,
                    ]  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--root", type=Path, help="folder of the data set that rooms with a '/' name")
    parser.add_argument("--rooms", nargs="+", default=list(ROOMS[1:]))
    parser.add_argument("--cases", nargs="+", default=["plain"])
    parser.add_argument("--widths", nargs="+", type=int, default=[256, 512])
    parser.add_argument("--starts", nargs="+", type=int, default=[0], help="first frames")
    options = parser.parse_args()
    header = ["room", "case", "width", "start", "frames", "error %", "off %", "pose mm", "cpu s", "ok", "message"]
    table: list[list[Any]] = []
    for row in rows(options):
        table.append(row)
        print("  ".join(row), flush=True)
    print()
    print(text_table(header, table, markdown=True))


if __name__ == "__main__":
    main()
