"""Run one method on one sequence in this process, as the runner does, but without a run folder."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.bench.run.blas import one_blas_thread
from panobench.datasets.base import FrameSequence
from panobench.methods.base import BatchMethod, MethodContext, OnlineMethod
from panobench.specs import load_object
from panobench.testing.sequences import BlindSequence
from panobench.types import Estimate, Frame

if TYPE_CHECKING:
    from collections.abc import Callable

    from panobench.depth.base import DepthEstimator
    from panobench.specs import MethodSpec


@dataclass
class MethodRun:
    """live: pose or None per frame, as ``track`` returned it. latency: seconds per frame (batch: the whole / N)."""

    estimate: Estimate
    live: list[NDArray[np.float64] | None] = field(default_factory=list)
    latency: list[float] = field(default_factory=list)
    log: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    idle_cpu_s: float = 0.0


def make_method(spec: MethodSpec, preset: str | None = None, **options: Any) -> OnlineMethod | BatchMethod:
    """The method of a spec with its preset's and the given options. Raises UnavailableError like ``Spec.load``."""
    cls = spec.load()
    if spec.config is None:
        return cls()  # type: ignore[no-any-return]
    config = load_object(spec.config, f"config of method '{spec.name}'")
    return cls(config(**{**(spec.presets[preset] if preset else {}), **options}))  # type: ignore[no-any-return]


@one_blas_thread()
def run_method(
    method: OnlineMethod | BatchMethod,
    sequence: FrameSequence,
    *,
    seed: int = 0,
    work: Path | None = None,
    make_depth: Callable[[], DepthEstimator] | None = None,
    needs: tuple[str, ...] = ("rgb",),
    idle_s: float = 0.0,
    rigs: bool = False,
) -> MethodRun:
    """Feed a sequence to a method and return what it answered. What the method raises is not caught.

    work: its work folder (default: one that is removed afterwards). needs: as in its spec; "imu", "poses" and
    "depth" are handed over from the sequence. idle_s: pause after each frame; ``idle_cpu_s`` of the result is the
    processor time used in those pauses, which a timing of ``track`` alone would miss. rigs: as in its spec; the
    sequence's rig and the pictures of its lenses are handed over.
    """
    if work is None:
        with tempfile.TemporaryDirectory(prefix="panobench-") as folder:
            return run_method(
                method,
                sequence,
                seed=seed,
                work=Path(folder),
                make_depth=make_depth,
                needs=needs,
                idle_s=idle_s,
                rigs=rigs,
            )
    log: list[str] = []
    truth = sequence.groundtruth if "poses" in needs else None
    poses = None if truth is None else dict(enumerate(truth.T_wc))
    imu = sequence.imu if "imu" in needs else None
    context = MethodContext(seed=seed, work=work, make_depth=make_depth, imu=imu, poses=poses, log=log.append)
    context.rig = sequence.rig if rigs else None
    if isinstance(method, BatchMethod):
        blind = BlindSequence(sequence, imu="imu" in needs)
        method.set_up(blind, context)
        begin = time.perf_counter()
        estimate = method.run(blind, context)
        mean = (time.perf_counter() - begin) / max(1, len(sequence))
        return MethodRun(estimate, latency=[mean] * len(sequence), log=log, asked=blind.asked)
    run = MethodRun(Estimate(_nothing()), log=log)
    method.start(sequence.camera, context)
    for index, t in enumerate(sequence.times):
        depth = sequence.depth(index) if "depth" in needs else None
        lenses = sequence.lens_images(index) if context.rig is not None else ()
        frame = Frame(
            index, float(t), sequence.image(index), depth=depth, name=sequence.frame_name(index), lenses=lenses
        )
        begin = time.perf_counter()
        pose = method.track(frame)
        run.latency.append(time.perf_counter() - begin)
        run.live.append(pose)
        if idle_s:
            cpu = time.process_time()
            time.sleep(idle_s)
            run.idle_cpu_s += time.process_time() - cpu
    run.estimate = method.finish()
    return run


def _nothing() -> Any:
    from panobench.types import Trajectory

    return Trajectory(np.zeros(0), np.zeros((0, 4, 4)))


def ate_rmse(run: MethodRun, sequence: FrameSequence) -> float:
    """ATE in metres, the RMSE of positions after alignment by Sim(3), or by SE(3) for a metric estimate.

    Raises ValueError without ground truth, or where the alignment is not defined.
    """
    from panobench.metrics.alignment import match
    from panobench.metrics.trajectory import align

    matched = match(run.estimate.trajectory, sequence.groundtruth)
    aligned = align(matched, "se3" if run.estimate.metric else "sim3") if matched is not None else None
    if aligned is None:
        raise ValueError("no ground truth, fewer than three tracked frames, or a camera that does not move")
    translation, _ = aligned.errors()
    return float(np.sqrt(np.mean(translation**2)))


def rotation_error_deg(run: MethodRun, sequence: FrameSequence) -> float:
    """Largest angle between estimated and true rotation, both relative to the first tracked frame, degrees."""
    truth = sequence.groundtruth
    if truth is None:
        raise ValueError("the sequence has no ground truth")
    estimate = run.estimate.trajectory
    true = truth.T_wc[np.searchsorted(truth.times, estimate.times - 1e-6)][:, :3, :3]
    R = estimate.T_wc[:, :3, :3]
    relative = (R[0].T @ R).transpose(0, 2, 1) @ (true[0].T @ true)
    cosine = (np.trace(relative, axis1=1, axis2=2) - 1) / 2
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1)).max()))
