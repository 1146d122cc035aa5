"""Give a method its frames, time it, and check every answer. Nothing here sees ground truth."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from panobench.bench.run.interrupts import InterruptRequest
from panobench.bench.run.memory import tree_resident_bytes
from panobench.bench.run.observer import Observer
from panobench.bench.run.views import FrameReader, MethodSequence
from panobench.datasets.base import FrameSequence
from panobench.errors import MethodError, PanobenchError
from panobench.methods.base import BatchMethod, MethodContext, OnlineMethod
from panobench.types import Estimate, Frame, RunStatus, Trajectory
from panobench.writing import is_disk_full

Pose = NDArray[np.float64]
FrameDone = Callable[[Frame, "Pose | None", float], None]
#: Largest |R^T R - I| of a pose that still counts as rigid: float32 poses pass, drifted ones do not.
RIGID_TOLERANCE = 1e-3


@dataclass
class Tracked:
    """What a method returned. Status OK means that it went through; whether it tracked enough is judged later.

    given: frames handed over. latency: seconds per frame given (batch: the whole run divided by the frames).
    memory: resident bytes of the process tree after each frame (online methods).
    live: poses as ``track`` returned them. warm_up_s, start_s, finish_s: seconds in the methods of these names.
    wall_s: seconds from before ``start`` to after ``finish``, with reading images.
    """

    status: RunStatus = RunStatus.OK
    message: str = ""
    failure: str = ""
    estimate: Estimate | None = None
    given: int = 0
    latency: list[float] = field(default_factory=list)
    memory: list[int] = field(default_factory=list)
    live: dict[int, Pose] = field(default_factory=dict)
    warm_up_s: float = 0.0
    start_s: float = 0.0
    finish_s: float = 0.0
    wall_s: float = 0.0


def track_online(
    method: OnlineMethod,
    sequence: FrameSequence,
    holdout: frozenset[int],
    context: MethodContext,
    first_depth: Callable[[int], NDArray[np.float32] | None],
    observer: Observer,
    frame_done: FrameDone,
) -> Tracked:
    """Run an online method. Errors of data or user are raised; those of the method become the result's status."""
    result = Tracked()
    read = FrameReader(sequence, lenses=context.rig is not None)
    begin = time.perf_counter()
    where = "warm_up()"
    with InterruptRequest(tell=observer.interrupted) as stop:
        try:
            method.warm_up(sequence.camera)
            result.warm_up_s = time.perf_counter() - begin
            begin = time.perf_counter()
            where = "start()"
            method.start(sequence.camera, context)
            result.start_s = time.perf_counter() - begin
            for index in range(len(sequence)):
                if stop.requested:
                    break
                frame = read(index, index not in holdout, first_depth(index))
                where = f"frame {index}"
                clock = time.perf_counter()
                pose = method.track(frame)
                latency = time.perf_counter() - clock
                result.latency.append(latency)
                result.memory.append(tree_resident_bytes())
                result.given += 1
                if pose is not None:
                    result.live[index] = check_pose(pose, f"frame {index}: track()")
                frame_done(frame, result.live.get(index), latency)
                observer.frame(index, frame.time, result.live.get(index), latency)
            observer.stage("finishing")
            where = "finish()"
            clock = time.perf_counter()
            result.estimate = check_estimate(method.finish(), sequence, result.given)
            result.finish_s = time.perf_counter() - clock
        except KeyboardInterrupt:
            stop.requested = True
        except Exception as error:
            _blame(error, result, where)
    if stop.requested:
        when = f"after frame {result.given - 1}" if result.given else "before the first frame"
        result.status, result.message = RunStatus.INTERRUPTED, f"interrupted {when}"
    result.wall_s = time.perf_counter() - begin
    if result.estimate is None:
        known = _known_poses(method, result.given) if stop.requested else None
        result.estimate = Estimate(_trajectory(known or result.live, sequence))
    return result


def _known_poses(method: OnlineMethod, given: int) -> dict[int, Pose] | None:
    """What the method knows of the frames given, stopped in the middle of something; None where that makes no sense."""
    try:
        found = method.known_poses()
        return None if found is None else {i: check_pose(T, f"frame {i}") for i, T in found.items() if 0 <= i < given}
    except Exception:  # it was interrupted anywhere; what track() gave is there
        return None


def track_batch(
    method: BatchMethod, sequence: FrameSequence, holdout: frozenset[int], context: MethodContext, observer: Observer
) -> Tracked:
    """Run a batch method. Errors are treated as in ``track_online``."""
    result = Tracked()
    blind = MethodSequence(sequence, holdout, context.imu, context.rig)
    where, busy = "warm_up()", 0.0
    begin = time.perf_counter()
    with InterruptRequest(at_once=True):
        try:
            method.warm_up(sequence.camera)
            result.warm_up_s = time.perf_counter() - begin
            begin = time.perf_counter()
            where = "set_up()"
            method.set_up(blind, context)
            result.start_s = time.perf_counter() - begin
            where = "run()"
            answer = method.run(blind, context)
            busy = time.perf_counter() - begin - result.start_s
            result.given = len(sequence)
            result.estimate = check_estimate(answer, sequence, result.given)
            result.live = dict(zip(frame_indices(result.estimate, sequence), result.estimate.trajectory.T_wc))
        except KeyboardInterrupt:
            result.status, result.message = RunStatus.INTERRUPTED, "interrupted"
        except Exception as error:
            _blame(error, result, where)
    result.wall_s = time.perf_counter() - begin
    result.latency = [busy / len(sequence)] * result.given
    if result.estimate is None:
        result.estimate = Estimate(_trajectory({}, sequence))
    return result


def _blame(error: Exception, result: Tracked, where: str) -> None:
    """Record the method's failure, or raise what the user can mend (data, options, software, a full disk)."""
    if is_disk_full(error) or (isinstance(error, PanobenchError) and not isinstance(error, MethodError)):
        raise error
    # torch's error of a full GPU; torch may not be loaded here
    if isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError":
        result.status = RunStatus.OUT_OF_MEMORY
    else:
        result.status = RunStatus(getattr(error, "run_status", RunStatus.CRASHED.value))
    what = str(error) if isinstance(error, MethodError) else f"{where}: {type(error).__name__}: {error}"
    result.message = " ".join(what.split())
    result.failure = "".join(traceback.format_exception(error))


def check_pose(pose: object, what: str) -> Pose:
    """A (4, 4) float64 copy. Raises MethodError unless it is finite and rigid."""
    try:
        T = np.array(pose, dtype=np.float64)
    except (TypeError, ValueError):
        raise MethodError(f"{what} returned {type(pose).__name__}, expected a 4x4 pose or None") from None
    if T.shape != (4, 4):
        raise MethodError(f"{what} returned shape {T.shape}, expected a 4x4 pose or None")
    if not np.isfinite(T).all():
        raise MethodError(f"{what} returned a pose that is not finite")
    R = T[:3, :3]
    if np.abs(R.T @ R - np.eye(3)).max() > RIGID_TOLERANCE or np.linalg.det(R) < 0:
        raise MethodError(f"{what} returned a pose that is not rigid: its rotation is not orthonormal")
    if np.abs(T[3] - [0, 0, 0, 1]).max() > RIGID_TOLERANCE:
        raise MethodError(f"{what} returned a pose whose last row is {T[3].tolist()}, expected 0 0 0 1")
    return T


def check_estimate(estimate: object, sequence: FrameSequence, given: int) -> Estimate:
    """The estimate with its times snapped to the sequence's. Raises MethodError where it breaks the contract."""
    if not isinstance(estimate, Estimate):
        raise MethodError(f"the method returned {type(estimate).__name__}, expected an Estimate")
    times = np.asarray(estimate.trajectory.times, dtype=np.float64)
    poses = np.asarray(estimate.trajectory.T_wc, dtype=np.float64)
    if times.ndim != 1 or poses.shape != (len(times), 4, 4):
        raise MethodError(
            f"the trajectory has times {times.shape} and poses {poses.shape}, expected (N,) and (N, 4, 4)"
        )
    if len(times) and not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise MethodError("the trajectory's times are not finite and increasing")
    index = np.clip(np.searchsorted(sequence.times, times - _slack(sequence)), 0, len(sequence) - 1)
    wrong = np.flatnonzero(np.abs(sequence.times[index] - times) > _slack(sequence))
    if len(wrong):
        raise MethodError(f"the trajectory has a pose at {times[wrong[0]]:.9g} s, where there is no frame")
    for i, T in zip(index, poses):
        check_pose(T, f"the trajectory's frame {int(i)}")
    bad = [k for k in estimate.keyframes if not 0 <= int(k) < given]
    if bad:
        raise MethodError(f"keyframe {bad[0]} is not one of the {given} frames given")
    estimate.keyframes = sorted({int(k) for k in estimate.keyframes})
    estimate.trajectory = Trajectory(np.asarray(sequence.times)[index], poses.copy())
    return estimate


def frame_indices(estimate: Estimate, sequence: FrameSequence) -> list[int]:
    """Indices of the frames that have a pose in the estimate."""
    return [int(i) for i in np.searchsorted(sequence.times, estimate.trajectory.times)]


def _slack(sequence: FrameSequence) -> float:
    """The tolerance between times of the same frame: a microsecond, or less where frames are closer."""
    step = float(np.diff(sequence.times).min()) if len(sequence) > 1 else 1.0
    return min(1e-6, step / 4)


def _trajectory(live: dict[int, Pose], sequence: FrameSequence) -> Trajectory:
    index = sorted(live)
    return Trajectory(np.asarray(sequence.times)[index], np.array([live[i] for i in index]).reshape(-1, 4, 4))
