"""Which frames of a run have ground truth, and the clock it is on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from panobench.bench.records.record import TruthRecord
from panobench.bench.run.setup import RunSetup
from panobench.bench.run.tracking import Tracked
from panobench.bench.run.views import ChosenFrames
from panobench.datasets.files.truth import MAX_GAP_S, truth_at_frames
from panobench.metrics.clock import ClockOffset, find_offset
from panobench.types import Trajectory


def align_clocks(setup: RunSetup, tracked: Tracked, log: Callable[[str], None]) -> tuple[RunSetup, ClockOffset | None]:
    """The run with its ground truth moved by the constant offset that fits the estimate's motion best.

    As it was, and None, where there is no truth with stamps of its own or the motion shows no offset.
    """
    sequence = setup.sequence
    recorded = sequence.recorded_truth or sequence.groundtruth
    assert tracked.estimate is not None
    found = None if recorded is None else find_offset(tracked.estimate.trajectory, recorded, MAX_GAP_S)
    if recorded is None or found is None:
        log("clocks: no constant offset was found" if recorded is not None else "clocks: there is no ground truth")
        return setup, None
    log(
        f"clocks: {found.offset_s:+.6f} s are added to the ground truth's times, {found.cost:.4f} of the motion is left"
    )
    moved = Trajectory(recorded.times + found.offset_s, recorded.T_wc)
    return replace(setup, sequence=sequence.with_truth(truth_at_frames(moved, sequence.times), moved)), found


def truth_record(sequence: ChosenFrames, offset: ClockOffset | None = None) -> TruthRecord | None:
    """What run.json says of the ground truth; None if the dataset has none."""
    truth, recorded = sequence.groundtruth, sequence.recorded_truth
    if truth is None and recorded is None:
        return None
    up = sequence.world_up
    whole = recorded if recorded is not None and len(recorded) else truth
    return TruthRecord(
        frames=0 if truth is None else len(truth),
        span_s=None if whole is None else [float(whole.times[0]), float(whole.times[-1])],
        frames_span_s=[float(sequence.times[0]), float(np.asarray(sequence.times)[-1])],
        up=None if up is None else [float(v) for v in up],
        time_offset_s=None if offset is None else offset.offset_s,
        offset_within_s=None if offset is None else offset.within_s,
    )


def clock_remark(asked: bool, offset: ClockOffset | None) -> list[str]:
    """What is said of the clocks of a run for which they were to be aligned."""
    if not asked:
        return []
    if offset is None:
        return ["--align-time found no constant offset between the clocks of ground truth and frames"]
    vague = f", give or take {offset.within_s:.3g} s" if offset.within_s > 0.05 else ""
    return [f"{offset.offset_s:+.4f} s were added to the times of the ground truth (--align-time{vague})"]
