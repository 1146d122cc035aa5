"""The camera's rotation against the gyroscope's: the clocks' offset, the gyroscope's bias, and whether they agree.

A rotation between two frames needs no scale, so this comes first. Where the two do not agree, the usual mistakes are
tried: degrees, an inverted mounting, exchanged or mirrored axes. What explains the motion is said; nothing is guessed
silently. Motion that the camera shows and the gyroscope does not, or the other way round, about one axis only, is what
levelled or stabilised video looks like.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import so3_exp, so3_log
from panobench.inertial.orientation import Orientation
from panobench.inertial.samples import ContradictionError, Samples, TooLittleMotionError
from panobench.inertial.visual import VisualPoses, overlapping_pairs, pairs

Array = NDArray[np.float64]

#: Pairs of frames are at least this far apart, s: a turn stands out from the noise of poses, and is still one turn.
SPAN_S = 0.1
#: For the estimates they are this far apart: a change of the angular rate, which tells the offset, takes its time.
LONG_SPAN_S = 0.5
#: Clocks are at most this far apart, s; steps in which the offset is looked for.
OFFSET_MAX_S, OFFSET_STEP_S = 0.5, 0.004
#: Least number of pairs, and least turning (deg/s, root mean square), by which the two can be compared.
PAIRS_MIN, TURNING_MIN_DEG_S = 10, 2.0
#: Share of the camera's turning that the gyroscope has to explain, in all and about each axis.
EXPLAINED_MIN, EXPLAINED_AXIS_MIN = 0.9, 0.7
#: The mounting is corrected if its rotation is off by more than this, and by more than four standard deviations.
MOUNTING_DEG = 1.0
#: It is said if the gyroscope turns by so much more or less than the camera.
GAIN_SAID = 0.015
#: What is expected of them before anything is known: rad/s and rad.
GYRO_BIAS_SIGMA, MOUNTING_SIGMA = 0.05, 0.05


@dataclass(frozen=True)
class RotationFit:
    """How gyroscope and camera go together.

    offset_s: to be added to the samples' times. bias (3,): of the gyroscope, rad/s. R_body_cam (3, 3): the camera's
    axes on the body. noise_rad: of the camera's turn between two frames, per axis. offset_sigma_s: standard deviation.
    gain: of the gyroscope, its turns over the camera's, where these tell it. remarks: what was corrected.
    """

    offset_s: float
    bias: Array
    R_body_cam: Array
    noise_rad: float
    offset_sigma_s: float
    gain: float = 1.0
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Turns:
    """Turns of the camera between pairs of frames: rotation vectors (P, 3) in camera axes, begin and end (P,) in s."""

    camera: Array
    begin: Array
    end: Array

    @property
    def seconds(self) -> Array:
        return np.asarray(self.end - self.begin)


def fit_rotation(visual: VisualPoses, samples: Samples) -> RotationFit:
    """Compare the two.

    Raises TooLittleMotionError if the camera hardly turned, ContradictionError if they contradict one another.
    """
    turns = _camera_turns(visual)
    R_cb = samples.T_body_cam[:3, :3].T
    offset = _search_offset(_covered(turns, samples, OFFSET_MAX_S), samples)
    _judge(_covered(turns, samples.shifted(offset)), samples, R_cb, offset)
    long_turns = _turns_of(visual, overlapping_pairs(visual, LONG_SPAN_S))
    return _refine(_covered(long_turns, samples.shifted(offset)), samples, R_cb, offset)


def _turns_of(visual: VisualPoses, chosen: NDArray[np.int64]) -> _Turns:
    i, j = chosen.T
    R = visual.T_wc[:, :3, :3]
    return _Turns(so3_log(np.swapaxes(R[i], 1, 2) @ R[j]), visual.times[i], visual.times[j])


def _camera_turns(visual: VisualPoses) -> _Turns:
    chosen = pairs(visual, SPAN_S)
    if len(chosen) < PAIRS_MIN:
        raise TooLittleMotionError(f"{len(chosen)} pairs of frames are too few to compare the camera with the IMU")
    turns = _turns_of(visual, chosen)
    size = np.degrees(np.sqrt(np.mean(np.sum((turns.camera / turns.seconds[:, None]) ** 2, axis=1))))
    if size < TURNING_MIN_DEG_S:
        raise TooLittleMotionError(f"the camera turns by {size:.1f} degrees/s, too little to compare it with the IMU")
    return turns


def _covered(turns: _Turns, samples: Samples, margin_s: float = 0.0) -> _Turns:
    """Those that the samples cover without a gap, and ``margin_s`` around them; all of them if these are too few."""
    kept = samples.covers(turns.begin - margin_s, turns.end + margin_s)
    if kept.sum() < PAIRS_MIN:
        return turns
    return _Turns(turns.camera[kept], turns.begin[kept], turns.end[kept])


class _Integral:
    """The integral of the angular rate: a turn between two frames is nearly its difference."""

    def __init__(self, samples: Samples) -> None:
        self.times = samples.times
        rate = (samples.gyro[1:] + samples.gyro[:-1]) / 2 * np.diff(samples.times)[:, None]
        self.sum = np.concatenate([np.zeros((1, 3)), np.cumsum(rate, axis=0)])

    def turns(self, turns: _Turns, offset: float) -> Array:
        """(P, 3) in body axes halfway through."""
        ends = [
            np.column_stack([np.interp(t - offset, self.times, s) for s in self.sum.T])
            for t in (turns.begin, turns.end)
        ]
        return np.asarray(ends[1] - ends[0])


def _aligned(camera: Array, body: Array) -> tuple[Array, float]:
    """The orthogonal matrix (3, 3), mirroring or not, that best takes body turns to camera turns; their correlation."""
    U, S, Vt = np.linalg.svd(camera.T @ body)
    return U @ Vt, float(S.sum() / max(np.linalg.norm(camera) * np.linalg.norm(body), 1e-12))


def _search_offset(turns: _Turns, samples: Samples) -> float:
    """The offset at which some mounting explains the turns best: it needs no mounting, unit or handedness."""
    integral = _Integral(samples)
    camera = _centred(turns.camera, turns)
    best, most = 0.0, -np.inf
    for offset in np.arange(-OFFSET_MAX_S, OFFSET_MAX_S + OFFSET_STEP_S / 2, OFFSET_STEP_S):
        _, likeness = _aligned(camera, _centred(integral.turns(turns, offset), turns))
        if likeness > most:
            best, most = float(offset), likeness
    return best


def _centred(values: Array, turns: _Turns) -> Array:
    """Without what a constant bias makes of them."""
    seconds = turns.seconds[:, None]
    return np.asarray(values - seconds * (values * seconds).sum(axis=0) / (seconds**2).sum())


def _judge(turns: _Turns, samples: Samples, R_cb: Array, offset: float) -> None:
    """Raises ContradictionError unless the gyroscope explains the camera's turns as it is mounted."""
    body = _centred(_Integral(samples).turns(turns, offset), turns)
    camera = _centred(turns.camera, turns)
    if _explains(camera, body @ R_cb.T, turns):
        return
    mistakes = {
        "the gyroscope seems to measure degrees/s, not rad/s": body @ R_cb.T * np.radians(1),
        "the camera's pose on the IMU seems to be given the wrong way round: give its inverse": body @ R_cb,
        "the mounting seems to be inverted, and the gyroscope in degrees/s": body @ R_cb * np.radians(1),
    }
    for axes in _axis_exchanges():
        name = ", ".join(f"{'-' if row.sum() < 0 else ''}{'xyz'[int(np.argmax(np.abs(row)))]}" for row in axes)
        text = f"the IMU's axes seem to be ({name}) of what the mounting says"
        mistakes[text + ("" if np.linalg.det(axes) > 0 else ", a left-handed system")] = body @ axes.T @ R_cb.T
    gain = float(np.sum(camera * (body @ R_cb.T)) / max(np.sum(body**2), 1e-12))
    if gain > 0:
        text = f"the gyroscope's rates seem to be {1 / gain:.3g} times too large (another unit)"
        mistakes[text] = gain * body @ R_cb.T
    for text, predicted in mistakes.items():
        if _explains(camera, predicted, turns):
            raise ContradictionError(f"the IMU contradicts the camera: {text}")
    free, likeness = _aligned(camera, body)
    if likeness > 0.95 and np.linalg.det(free) > 0 and _explains(camera, body @ free.T, turns):
        off = np.degrees(np.linalg.norm(so3_log(free @ R_cb.T)))
        raise ContradictionError(
            f"the IMU contradicts the camera: its mounting is off by {off:.0f} degrees from the calibration's"
        )
    share = _share(camera, body @ R_cb.T)
    raise ContradictionError(
        f"the IMU contradicts the camera: it explains {max(share, 0.0):.0%} of the turning (a levelled or stabilised "
        "video, another recording's IMU or a wrong mounting)"
    )


def _explains(camera: Array, predicted: Array, turns: _Turns) -> bool:
    """Whether enough of the turning agrees, in all and about each axis about which either turns."""
    if _share(camera, predicted) < EXPLAINED_MIN:
        return False
    _, axes = np.linalg.eigh(predicted.T @ predicted + camera.T @ camera)
    rate = np.radians(TURNING_MIN_DEG_S) * np.sqrt(np.mean(turns.seconds**2))
    for axis in axes.T:
        c, p = camera @ axis, predicted @ axis
        turning = max(np.mean(c**2), np.mean(p**2))
        if turning > rate**2 and 1 - _trimmed((c - p)[:, None]) / max(_trimmed(c[:, None]), 1e-12) < EXPLAINED_AXIS_MIN:
            return False
    return True


def _share(camera: Array, predicted: Array) -> float:
    return 1 - _trimmed(camera - predicted) / max(_trimmed(camera), 1e-12)


def _trimmed(values: Array) -> float:
    """Mean square of rows (P, d) without the largest twentieth: single wrong poses do not decide."""
    size = np.sort(np.sum(values**2, axis=1))
    return float(size[: max(int(0.95 * len(size)), 1)].mean())


def _axis_exchanges() -> list[Array]:
    """Signed permutation matrices (3, 3), proper ones first, without the identity."""
    found = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            M = np.zeros((3, 3))
            M[range(3), order] = signs
            if not np.allclose(M, np.eye(3)):
                found.append(M)
    return sorted(found, key=lambda M: -np.linalg.det(M))


def _refine(turns: _Turns, samples: Samples, R_cb: Array, offset: float) -> RotationFit:
    """Offset and bias; the mounting's rotation too where it is surely off."""
    free = _solve(turns, samples, R_cb, offset, mounting=True)
    turned = so3_log(free.R_cb @ R_cb.T)
    off = float(np.linalg.norm(turned))
    deviation = float(np.sqrt(np.trace(free.covariance[4:, 4:])))
    remarks: tuple[str, ...] = ()
    if off > np.radians(MOUNTING_DEG) and off > 4 * deviation:
        remarks = (f"the IMU's mounting is off by {np.degrees(off):.1f} degrees from the calibration's; corrected",)
        found = free
    else:
        found = _solve(turns, samples, R_cb, free.offset, mounting=False)
    body = _body_turns(turns, Orientation(samples, found.bias), found.offset)
    gain = _gain(turns.camera, so3_log(found.R_cb @ body @ found.R_cb.T))
    if abs(gain - 1) > GAIN_SAID:
        more = "more" if gain > 1 else "less"
        remarks += (f"the gyroscope turns by {abs(gain - 1):.1%} {more} than the camera; it is used as it is",)
    return RotationFit(
        found.offset, found.bias, found.R_cb.T, found.sigma, float(np.sqrt(found.covariance[0, 0])), gain, remarks
    )


def _gain(camera: Array, predicted: Array) -> float:
    """The gyroscope's turns (P, 3) over the camera's: the weighted median, in which a large turn says most."""
    squares = np.maximum(np.sum(camera**2, axis=1), 1e-12)
    ratios = np.sum(camera * predicted, axis=1) / squares
    order = np.argsort(ratios)
    return float(ratios[order][np.searchsorted(np.cumsum(squares[order]), 0.5 * squares.sum())])


@dataclass(frozen=True)
class _Solution:
    offset: float
    bias: Array
    R_cb: Array
    sigma: float
    covariance: Array


def _solve(turns: _Turns, samples: Samples, R_given: Array, offset: float, *, mounting: bool) -> _Solution:
    """Gauss-Newton on offset, bias and, if asked for, the mounting's rotation; robust by Huber weights.

    Residuals are log((R_cb dR_b R_bc)^T dR_c), and so are the perturbations, on the right.
    """
    R_cb, bias, h = R_given, np.zeros(3), 2e-4
    count = 7 if mounting else 4
    prior = np.array([0.0, *[GYRO_BIAS_SIGMA] * 3, *[MOUNTING_SIGMA] * 3])[:count]
    information = np.diag([1e-9, *(1 / prior[1:] ** 2)])
    R_camera = so3_exp(turns.camera)
    sigma, covariance = 0.0, np.eye(count)
    for _ in range(10):
        orientation = Orientation(samples, bias)
        body, later, earlier = (_body_turns(turns, orientation, o) for o in (offset, offset + h, offset - h))
        predicted = R_cb @ body @ R_cb.T
        back = np.swapaxes(predicted, 1, 2)
        residual = so3_log(back @ R_camera)
        J = np.zeros((len(residual), 3, 7))
        J[:, :, 0] = so3_log(np.swapaxes(earlier, 1, 2) @ later) @ R_cb.T / (2 * h)
        J[:, :, 1:4] = -turns.seconds[:, None, None] * (R_cb @ so3_exp(-so3_log(body) / 2))
        J[:, :, 4:7] = back - np.eye(3)
        sigma = max(float(np.median(np.abs(residual))) / 0.6745, 1e-6)
        size = np.linalg.norm(residual, axis=1) / sigma
        weight = np.sqrt(np.minimum(1.0, 3.0 / np.maximum(size, 1e-9))) / sigma
        A = (J[:, :, :count] * weight[:, None, None]).reshape(-1, count)
        b = (residual * weight[:, None]).reshape(-1)
        now = np.concatenate([[0.0], bias, so3_log(R_cb @ R_given.T)])[:count]
        covariance = np.linalg.inv(A.T @ A + information)
        step = covariance @ (A.T @ b - information @ now)
        offset, bias = offset + float(np.clip(step[0], -0.05, 0.05)), bias + step[1:4]
        if mounting:
            R_cb = so3_exp(step[4:]) @ R_cb
        if abs(step[0]) < 1e-6 and np.linalg.norm(step[1:]) < 1e-7:
            break
    return _Solution(offset, bias, R_cb, sigma, covariance)


def _body_turns(turns: _Turns, orientation: Orientation, offset: float) -> Array:
    """(P, 3, 3)"""
    R = [orientation.at(t - offset) for t in (turns.begin, turns.end)]
    return np.asarray(np.swapaxes(R[0], 1, 2) @ R[1])
