"""ATE, RPE and rotation error by evo; definitions in docs/protocol.md."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, umeyama
from panobench.metrics.alignment import SAME_TIME_S, Matched, match, moves, world_alignment
from panobench.metrics.base import MetricInput
from panobench.types import Trajectory

Alignment = Literal["sim3", "se3", "none"]


def trajectory_metrics(data: MetricInput) -> dict[str, float | None]:
    """Errors in metres, in percent of the path and in degrees. None, with a note, where an error is not defined.

    Against a ground truth without scale there are no lengths; of a trajectory of keyframes there is their ATE alone.
    """
    estimate = data.estimate
    matched = match(estimate.trajectory, data.sequence.groundtruth)
    if matched is None:
        data.notes["ate_rmse_m"] = "no ground truth" if data.sequence.groundtruth is None else "no tracked frame"
        return {}
    path = matched.truth.path_length()
    scaled = data.sequence.groundtruth_scaled
    values: dict[str, float | None] = {"path_length_m": path if scaled else None}
    how = chosen_alignment(data.alignment)
    aligned = align(matched, how)
    if aligned is None:
        data.notes["ate_rmse_m"] = "fewer than three poses, or a camera that does not move: alignment is undefined"
        return values
    ate = _ape(aligned, "translation_part")
    values["ate_percent"] = 100 * ate / path if path > 0 else None
    values["ate_rotation_rmse_deg"] = _ape(aligned, "rotation_angle_deg")
    explained = _explained_rotation(matched, aligned, ate)
    if explained:
        data.notes["ate_rotation_rmse_deg"] = explained
    segments = consecutive(matched.truth.times, np.asarray(data.sequence.times))
    if not segments:
        data.notes["rpe_trans_rmse_m"] = "no two consecutive frames have both a pose and ground truth"
    values["scale"] = aligned.transform.scale
    if data.keyframes_only:
        values["ate_keyframes_rmse_m"] = ate if scaled else None
        data.notes["ate_rmse_m"] = "the trajectory has keyframes alone: ate_keyframes_rmse_m is their error"
        return values
    values["rpe_rotation_rmse_deg"] = _rpe(aligned, segments, "rotation_angle_deg")
    if not scaled:
        data.notes["ate_rmse_m"] = "the ground truth has no scale: ate_percent is the error in percent of its path"
        return values
    if estimate.gravity_aligned:
        values["gravity_error_deg"] = _gravity_error(matched, data)
    values["ate_rmse_m"] = ate
    values["rpe_trans_rmse_m"] = _rpe(aligned, segments, "translation_part")
    if estimate.metric and how == "sim3" and (rigid := align(matched, "se3")) is not None:
        values["ate_se3_rmse_m"] = _ape(rigid, "translation_part")
        values["scale_error_percent"] = 100 * abs(1 / aligned.transform.scale - 1)
    keyframes = _keyframes(matched, data)
    aligned_keyframes = align(keyframes, how) if keyframes is not None else None
    if aligned_keyframes is not None:
        values["ate_keyframes_rmse_m"] = _ape(aligned_keyframes, "translation_part")
    return values


def chosen_alignment(alignment: Literal["auto", "sim3", "se3", "none"]) -> Alignment:
    """The alignment before ATE that a protocol's choice stands for."""
    return "sim3" if alignment == "auto" else alignment


@dataclass(frozen=True)
class Aligned:
    """evo trajectories of the same frames: the truth, and the estimate moved onto it by ``transform``."""

    truth: Any
    estimate: Any
    transform: Sim3

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) of the moved estimate, in the truth's world."""
        return np.asarray(self.estimate.positions_xyz)

    def errors(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(N,) translation in the truth's unit and (N,) rotation in degrees, of each frame; ATE is their RMS."""
        translation, rotation = _errors(self, "translation_part"), _errors(self, "rotation_angle_deg")
        return np.asarray(translation.error), np.asarray(rotation.error)


def align(matched: Matched, how: Alignment) -> Aligned | None:
    """Umeyama alignment by evo. None under three poses or when either camera stays put."""
    if len(matched) < 3 or not moves(matched.truth.positions) or not moves(matched.estimate.positions):
        return None
    from evo.core.geometry import GeometryException

    truth, estimate = _evo(matched.truth), _evo(matched.estimate)
    if how == "none":
        return Aligned(truth, estimate, Sim3(1.0, np.eye(3), np.zeros(3)))
    with_scale = how == "sim3"
    try:
        R, t, scale = estimate.align(truth, correct_scale=with_scale)
        return Aligned(truth, estimate, Sim3(float(scale) if with_scale else 1.0, R, t))
    except GeometryException:
        # Poses on one line leave a rotation about it free. Positions, and so the errors, do not depend on it.
        sim3 = umeyama(matched.estimate.positions, matched.truth.positions, with_scale)
        moved = Trajectory(matched.estimate.times, sim3.apply_poses(matched.estimate.T_wc))
        return Aligned(truth, _evo(moved), sim3)


def _gravity_error(matched: Matched, data: MetricInput) -> float | None:
    """Degrees between the estimated world's z axis, rotated into the true world, and the true up direction.

    The rotation is the mean one of the frames: that from positions alone is undefined on a straight path.
    """
    up = data.sequence.world_up
    if up is None:
        data.notes["gravity_error_deg"] = "the data set does not say which way is up in its ground truth"
        return None
    z = world_alignment(matched).R[:, 2]
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(z, up)), z @ up)))


def _evo(trajectory: Trajectory) -> Any:
    from evo.core.trajectory import PoseTrajectory3D

    return PoseTrajectory3D(poses_se3=list(trajectory.T_wc.copy()), timestamps=trajectory.times.copy())


def _errors(aligned: Aligned, relation: str) -> Any:
    """evo's absolute pose error."""
    from evo.core import metrics

    ape = metrics.APE(metrics.PoseRelation[relation])
    ape.process_data((aligned.truth, aligned.estimate))
    return ape


def _ape(aligned: Aligned, relation: str) -> float:
    from evo.core import metrics

    return float(_errors(aligned, relation).get_statistic(metrics.StatisticsType.rmse))


def _rpe(aligned: Aligned, segments: list[NDArray[np.intp]], relation: str) -> float | None:
    """evo's relative error from each frame to the next, over stretches of consecutive frames; None without a pair."""
    from evo.core import metrics

    errors = []
    for segment in segments:
        truth, estimate = deepcopy(aligned.truth), deepcopy(aligned.estimate)
        truth.reduce_to_ids(segment)
        estimate.reduce_to_ids(segment)
        rpe = metrics.RPE(metrics.PoseRelation[relation], delta=1, delta_unit=metrics.Unit.frames, all_pairs=True)
        rpe.process_data((truth, estimate))
        errors.append(np.asarray(rpe.error))
    return float(np.sqrt((np.concatenate(errors) ** 2).mean())) if errors else None


def consecutive(times: NDArray[np.float64], frame_times: NDArray[np.float64]) -> list[NDArray[np.intp]]:
    """Indices into ``times`` (N,), each that of a frame, as stretches of two and more frames that follow each other."""
    frames = np.searchsorted(frame_times, times - SAME_TIME_S)
    parts = np.split(np.arange(len(times)), np.flatnonzero(np.diff(frames) != 1) + 1)
    return [part for part in parts if len(part) > 1]


def _explained_rotation(matched: Matched, aligned: Aligned, ate: float) -> str | None:
    """Why orientations are far off where positions are right, that is within a tenth of the path's extent.

    Poses near one line are left alone: their alignment is free about it.
    """
    from panobench.metrics.orientation import explain_rotation

    positions = matched.truth.positions
    spread = np.linalg.svd(positions - positions.mean(axis=0), compute_uv=False)
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    if ate > 0.1 * extent or spread[1] < 0.05 * spread[0]:
        return None
    found = matched.estimate.T_wc[:, :3, :3]
    return explain_rotation(matched.truth.T_wc[:, :3, :3], found, aligned.transform.R)


def _keyframes(matched: Matched, data: MetricInput) -> Matched | None:
    times = np.asarray(data.sequence.times)[data.estimate.keyframes]
    chosen = np.flatnonzero(np.isin(matched.estimate.times, times))
    return Matched(matched.estimate.select(chosen), matched.truth.select(chosen)) if len(chosen) else None
