"""What a run folder holds: run.json from what was found out, and the files beside it."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from panobench.bench.records.provenance import ProvenanceRecord
from panobench.bench.records.record import (
    DepthRecord,
    FramesRecord,
    MapRecord,
    MethodRecord,
    RunRecord,
    SpecRecord,
    TimingRecord,
    write_record,
)
from panobench.bench.records.runfolder import FRAMES, GROUNDTRUTH, MAP, RENDERS, TRAJECTORY, write_frames
from panobench.bench.run.config import config_values
from panobench.bench.run.evaluate import Scores
from panobench.bench.run.masking import moving_record, write_masks
from panobench.bench.run.request import RunRequest
from panobench.bench.run.setup import RunSetup
from panobench.bench.run.tracking import Tracked, frame_indices
from panobench.bench.run.truth import clock_remark, truth_record
from panobench.errors import PanobenchError
from panobench.methods.base import BatchMethod, OnlineMethod
from panobench.metrics.base import PROTOCOL_VERSION
from panobench.metrics.clock import ClockOffset
from panobench.types import DepthEstimate, RunStatus


def run_record(
    request: RunRequest,
    setup: RunSetup,
    tracked: Tracked,
    holdout: list[int],
    scores: Scores,
    timing: TimingRecord,
    origin: ProvenanceRecord,
    offset: ClockOffset | None = None,
) -> RunRecord:
    """What is known of a run (the map's entry is added when the map is written).

    ``offset``: of the clocks, if it was looked for, found and applied to ``setup``.
    """
    estimate, sequence = tracked.estimate, setup.sequence
    assert estimate is not None
    used_depth = setup.depth is not None and (setup.depth.made > 0 or setup.depth.chosen)
    return RunRecord(
        status=scores.status.value,
        message=scores.message,
        spec=SpecRecord.of(
            request,
            sequence=sequence.name,
            depth=setup.depth.label if used_depth and setup.depth else None,
            config=config_values(setup.config),
            camera_model=sequence.camera.to_dict(),
        ),
        method=MethodRecord(
            name=setup.spec.name,
            origin=setup.origin,
            contract=setup.spec.contract,
            licence=setup.spec.licence,
            citation=setup.spec.citation,
            needs=list(setup.spec.needs),
        ),
        protocol=PROTOCOL_VERSION,
        metric=bool(estimate.metric),
        gravity_aligned=bool(estimate.gravity_aligned),
        metrics=scores.metrics,
        notes=scores.notes,
        timing=timing,
        frames=FramesRecord(
            given=tracked.given,
            planned=len(sequence),
            tracked=len(estimate.trajectory),
            held_out=len([i for i in holdout if i < tracked.given]),
        ),
        keyframes=list(estimate.keyframes),
        depth=_depth_record(setup, estimate.depth),
        groundtruth=sequence.groundtruth is not None,
        groundtruth_scaled=sequence.groundtruth_scaled,
        truth=truth_record(sequence, offset),
        remarks=[*sequence.remarks(), *rig_remark(setup), *clock_remark(request.align_time, offset)],
        extra=dict(estimate.extra),
        provenance=replace(origin, dataset=sequence.provenance(), command=shlex.join(request.command())),
    )


def rig_remark(setup: RunSetup) -> list[str]:
    """A line where a method that takes one centre of projection gets the pictures of several lenses stitched."""
    rig = setup.sequence.rig
    if rig is None or setup.spec.rigs:
        return []
    return [
        f"{setup.spec.name} takes one centre of projection: the pictures of {len(rig)} lenses, "
        f"{1e3 * rig.baseline_m:.0f} mm apart, are stitched to a panorama for it"
    ]


def timing_record(tracked: Tracked, evaluation_s: float) -> TimingRecord:
    """Seconds and rates of the method alone; see docs/protocol.md. The resources it used are left open."""
    busy = sum(tracked.latency) + tracked.finish_s
    assert tracked.estimate is not None
    rows = tracked.estimate.frames
    own = [rows[i]["tracking_s"] for i in range(tracked.given) if "tracking_s" in rows.get(i, {})]
    # A method need not time the frames its map starts from; with fewer numbers than this, ours are fairer.
    tracking = own if len(own) >= 0.9 * tracked.given else tracked.latency
    p50, p95 = np.percentile(tracked.latency, [50, 95]) if tracked.latency else (None, None)
    return TimingRecord(
        fps=tracked.given / busy if tracked.given and busy > 0 else None,
        tracking_fps=len(tracking) / sum(tracking) if tracking and sum(tracking) > 0 else None,
        latency_p50_s=p50,
        latency_p95_s=p95,
        start_s=tracked.start_s,
        finish_s=tracked.finish_s,
        wall_s=tracked.wall_s,
        evaluation_s=evaluation_s,
    )


def _depth_record(setup: RunSetup, estimate: DepthEstimate | None) -> DepthRecord:
    """Where the map's first depth came from; a dataset's own depth is flagged."""
    choice = setup.depth
    needs_depth = "depth" in setup.spec.needs
    record = DepthRecord(
        source=choice.label if choice and choice.made else ("input" if needs_depth else None),
        oracle=bool(needs_depth or (choice and choice.made and choice.spec.needs_dataset_depth)),
        poses_given="poses" in setup.spec.needs,
    )
    if estimate is not None:
        record.frame, record.ok, record.message = estimate.frame_index, estimate.ok, estimate.message
        known = estimate.depth[np.isfinite(estimate.depth)]
        if len(known):
            low, high = np.percentile(known, [2, 98])
            record.range = [float(low), float(high)]
    return record


def save_map(folder: Path, method: OnlineMethod | BatchMethod, tracked: Tracked) -> str:
    """Save the method's map to ``folder`` if the run went well; returns what was done, in a line.

    A run that was lost or interrupted leaves the folder as it is.
    """
    from panobench.maps.store import write_map

    saved = method.saved_map() if isinstance(method, OnlineMethod) and tracked.status is RunStatus.OK else None
    if saved is None:
        return f"map: nothing saved to {folder}: {tracked.message or 'the method has no map'}"
    write_map(folder, saved)
    return f"map: {len(saved.keyframes)} keyframes and {len(saved.gaussians)} Gaussians saved to {folder}"


def write_run(folder: Path, record: RunRecord, setup: RunSetup, tracked: Tracked, holdout: list[int]) -> None:
    """Write everything but log.txt and renders below ``folder``; run.json last. Fills in ``record.map``."""
    from panobench.datasets.files.trajectory_io import write_tum

    estimate, sequence = tracked.estimate, setup.sequence
    assert estimate is not None
    write_tum(folder / TRAJECTORY, estimate.trajectory)
    truth = sequence.groundtruth
    if truth is not None:
        write_tum(folder / GROUNDTRUTH, truth)
    write_frames(folder / FRAMES, frame_rows(setup, tracked, frozenset(holdout)))
    if estimate.map is not None:
        try:
            estimate.map.write_ply(folder / MAP)
            record.map = MapRecord(MAP, len(estimate.map), (folder / MAP).stat().st_size)
        except PanobenchError as error:
            record.notes["map"] = str(error)
    if estimate.depth is not None:
        write_depth(folder / RENDERS, estimate.depth)
    record.moving = moving_record(sequence, estimate.moving)
    write_masks(folder, folder / RENDERS, sequence, estimate.moving)
    write_record(folder, record)


def frame_rows(setup: RunSetup, tracked: Tracked, holdout: frozenset[int]) -> list[dict[str, Any]]:
    """One row per frame given: index, time, name, tracked, mappable, keyframe, latency_s, memory_mib.

    The method's own numbers follow.
    """
    estimate, sequence = tracked.estimate, setup.sequence
    assert estimate is not None
    posed, keyframes = set(frame_indices(estimate, sequence)), set(estimate.keyframes)
    rows = []
    for i in range(tracked.given):
        own = estimate.frames.get(i, {})
        rows.append(
            {
                "index": i,
                "time": f"{sequence.times[i]:.9f}",
                "name": sequence.frame_name(i),
                "tracked": int(i in posed),
                "mappable": int(i not in holdout),
                "keyframe": int(i in keyframes),
                "latency_s": f"{tracked.latency[i]:.6f}" if i < len(tracked.latency) else None,
                "memory_mib": f"{tracked.memory[i] / 2**20:.1f}" if i < len(tracked.memory) else None,
                **{k: v for k, v in own.items() if k not in ("index", "time", "name")},
            }
        )
    return rows


def write_depth(folder: Path, estimate: DepthEstimate) -> None:
    """depth.jpg (near is warm, 2nd to 98th percentile of inverse depth) and depth_confidence.jpg."""
    import cv2

    from panobench.datasets.files.images import write_image

    folder.mkdir(exist_ok=True)
    inverse = 1.0 / np.where(estimate.depth > 0, estimate.depth, np.nan)
    known = np.isfinite(inverse)
    if known.any():
        low, high = np.percentile(inverse[known], [2, 98])
        level = np.clip((np.where(known, inverse, low) - low) / max(high - low, 1e-9), 0, 1)
        picture = cv2.applyColorMap(np.uint8(level * 255), cv2.COLORMAP_TURBO)
        picture[~known] = 0
        write_image(folder / "depth.jpg", picture[..., ::-1], quality=90)
    if estimate.confidence is not None:
        level = np.clip(np.nan_to_num(estimate.confidence), 0, 1)
        write_image(folder / "depth_confidence.jpg", np.uint8(level * 255), quality=90)
