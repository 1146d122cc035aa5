"""Scale, gravity and the accelerometer's bias from visual poses, in closed form.

In the axes and unit of the visual map, the position of the camera is that of the body and the lever arm, divided by the
scale s:

    p_c(t) = a + b t + lambda (P(t) + l(t)) + (lambda g) t^2 / 2 - B(t) (lambda b_a),       lambda = 1 / s

where P is the specific force, turned into the map's axes, integrated twice, l the lever arm R_wb t_bc and B the
rotation R_wb integrated twice. It is linear in lambda, lambda g and lambda b_a. Positions are compared over windows,
and a and b (a start and a velocity) are eliminated from each. Noise of the visual poses is on the left, so that the
scale is not biased by it. The gravity's size, which is known, then constrains the solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import so3_exp
from panobench.inertial.orientation import Orientation
from panobench.inertial.rotation import RotationFit
from panobench.inertial.samples import ContradictionError, Samples, TooLittleMotionError, white_noise
from panobench.inertial.visual import VisualPoses

Array = NDArray[np.float64]

#: Length of a window, s. A stride lasts about one, and noise of the accelerometer grows with its third power.
WINDOW_S = 2.0
#: Fewest frames in a window.
FRAMES_MIN = 6
#: Standard deviation of the accelerometer's bias before anything is known, m/s^2.
ACCEL_BIAS_SIGMA = 0.15
#: Largest standard deviation of the scale, relative, that counts as initialised.
SCALE_SIGMA_MAX = 0.03
#: Neighbouring residuals are correlated, which a covariance of independent ones does not know.
CORRELATION = 4.0
#: Scales by the accelerations and by gravity's size differ by at most this, and by five deviations: an accelerometer
#: that measures so much too much makes a scale of twice that error.
GAIN_MAX = 0.05
#: Residuals of so many times what noise explains are no noise.
UNEXPLAINED = 5.0


@dataclass(frozen=True)
class Initial:
    """scale: metres in a unit of the map. scale_sigma: its standard deviation, relative. gravity (3,): m/s^2 in the
    map's axes. accel_bias (3,): m/s^2. noise_m: of a visual position, per axis, m. windows: how many were used.
    signal_m: root mean square of what positions in a window are off a parabola by, which is what tells the scale.
    """

    scale: float
    scale_sigma: float
    gravity: Array
    accel_bias: Array
    noise_m: float
    windows: int
    signal_m: float


@dataclass(frozen=True)
class _System:
    """Rows of all windows, start and velocity eliminated: y (3K,) = A (3K, 7) (lambda, lambda g, lambda b_a).

    signal: see ``Initial``, in units of the map.
    """

    A: Array
    y: Array
    windows: int
    signal: float


def initialise(visual: VisualPoses, samples: Samples, rotation: RotationFit) -> Initial:
    """Of one map's poses.

    Raises TooLittleMotionError if the motion does not determine the scale, ContradictionError if no scale fits both.
    """
    system = _windows(visual, samples, rotation)
    free, sigma_free = _solve_free(system, samples.gravity)
    _judge(free, sigma_free, samples.gravity)
    unit = samples.gravity / max(float(np.linalg.norm(free[1:4])), 1e-12)
    return _solve_constrained(system, free, samples.gravity, _expected_noise(visual, samples, unit))


class DoubleIntegral:
    """Specific force and rotation of the body in the map's axes, integrated once and twice over the samples' times."""

    def __init__(self, visual: VisualPoses, samples: Samples, rotation: RotationFit) -> None:
        known = visual.select(visual.known)
        self.times = samples.times + rotation.offset_s
        self.orientation = orientation = Orientation(samples.shifted(rotation.offset_s), rotation.bias)
        # From the last frame before each sample on: the gyroscope's drift never adds up.
        k = np.clip(np.searchsorted(known.times, self.times, side="right") - 1, 0, len(known) - 1)
        R_wb = known.T_wc[:, :3, :3] @ rotation.R_body_cam.T
        start = R_wb @ np.swapaxes(orientation.at(known.times), 1, 2)
        R = start[k] @ orientation.at(self.times)
        force = (R @ samples.accel[..., None])[..., 0]
        columns = np.concatenate([force, R.reshape(-1, 9)], axis=1)
        self.columns = columns
        seconds = np.diff(self.times)[:, None]
        self.once = _cumulative((columns[1:] + columns[:-1]) / 2 * seconds)
        # Exact for what is linear between two samples.
        self.twice = _cumulative(self.once[:-1] * seconds + (2 * columns[:-1] + columns[1:]) / 6 * seconds**2)

    def at(self, times: Array) -> tuple[Array, Array]:
        """The force integrated twice (M, 3), and the rotation (M, 3, 3), since the first sample."""
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        since = (times - self.times[k])[:, None]
        share = since / (self.times[k + 1] - self.times[k])[:, None]
        slope = (self.columns[k + 1] - self.columns[k]) * share
        value = self.twice[k] + self.once[k] * since + (self.columns[k] / 2 + slope / 6) * since**2
        return value[:, :3], value[:, 3:].reshape(-1, 3, 3)

    def turn(self, begin: float, end: float) -> Array:
        """(3, 3) the body's axes at ``end`` in those at ``begin``, by the gyroscope."""
        R = self.orientation.at(np.array([begin, end]))
        return np.asarray(R[0].T @ R[1])


def _cumulative(steps: Array) -> Array:
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


def _windows(visual: VisualPoses, samples: Samples, rotation: RotationFit) -> _System:
    known = visual.select(visual.known)
    integral = DoubleIntegral(visual, samples, rotation)
    force, turned = integral.at(known.times)
    lever = known.T_wc[:, :3, :3] @ rotation.R_body_cam.T @ samples.T_body_cam[:3, 3]
    rows, rights, curved, count = [], [], [], 0
    moved = samples.shifted(rotation.offset_s)
    begin = 0
    while begin < len(known):  # windows do not overlap; the next one after a gap begins with the first frame behind it
        end = int(np.searchsorted(known.times, known.times[begin] + WINDOW_S, side="right"))
        t = known.times[begin:end]
        if len(t) >= FRAMES_MIN and t[-1] - t[0] > WINDOW_S / 2 and bool(moved.covers(t[:1], t[-1:])[0]):
            t = t - t.mean()
            basis = np.linalg.qr(np.column_stack([np.ones_like(t), t]))[0]
            A = np.zeros((len(t), 3, 7))
            A[:, :, 0] = force[begin:end] + lever[begin:end]
            A[:, :, 1:4] = (t**2 / 2)[:, None, None] * np.eye(3)
            A[:, :, 4:7] = -turned[begin:end]
            flat = A.reshape(len(t), -1)
            rows.append((flat - basis @ (basis.T @ flat)).reshape(-1, 7))
            p = known.T_wc[begin:end, :3, 3]
            rights.append((p - basis @ (basis.T @ p)).reshape(-1))
            parabola = np.linalg.qr(np.column_stack([basis, t**2]))[0]
            curved.append(np.sum((p - parabola @ (parabola.T @ p)) ** 2, axis=1))
            count += 1
            begin = end
        else:
            begin += 1
    if not rows:
        raise TooLittleMotionError(f"no {WINDOW_S:g} s of poses and inertial samples without a gap, which metres need")
    signal = float(np.sqrt(np.mean(np.concatenate(curved))))
    return _System(np.concatenate(rows), np.concatenate(rights), count, signal)


def _weights(residual: Array) -> tuple[Array, float]:
    """Huber weights of residuals (3K,) by their robust deviation, and that deviation."""
    sigma = max(float(np.median(np.abs(residual))) / 0.6745, 1e-9)
    return np.minimum(1.0, 2.0 / np.maximum(np.abs(residual) / sigma, 1e-9)), sigma


def _solve_free(system: _System, gravity: float) -> tuple[Array, Array]:
    """(lambda, lambda g, lambda b_a) without the gravity's size, but with the bias' prior; their covariance."""
    A, y = system.A, system.y
    weight, x, covariance = np.ones(len(y)), np.zeros(7), np.eye(7)
    lam = 0.0
    for _ in range(6):
        prior = np.zeros(7)
        if lam > 0:
            prior[4:] = 1 / (lam * ACCEL_BIAS_SIGMA) ** 2
        sigma = 1.0 if not x.any() else _weights(y - A @ x)[1] * CORRELATION
        H = (A * weight[:, None]).T @ A / sigma**2 + np.diag(prior) + 1e-12 * np.eye(7)
        covariance = np.linalg.pinv(H)
        x = covariance @ (A.T @ (weight * y) / sigma**2)
        weight = _weights(y - A @ x)[0]
        lam = float(np.linalg.norm(x[1:4])) / gravity
    return x, covariance


def _judge(x: Array, covariance: Array, gravity: float) -> None:
    """The scale by the accelerations and the scale by the gravity's size must be the same, and positive."""
    by_motion, by_gravity = float(x[0]), float(np.linalg.norm(x[1:4])) / gravity
    deviation = float(np.sqrt(covariance[0, 0]))
    if by_motion < -4 * deviation:
        raise ContradictionError(
            "the IMU contradicts the camera: accelerations have the wrong sign (the accelerometer measures gravity and "
            "not the force against it, or the mounting of its axes is wrong)"
        )
    direction = x[1:4] / max(by_gravity * gravity, 1e-12)
    difference = np.concatenate([[1.0], -direction / gravity])
    apart, uncertain = abs(by_motion - by_gravity), float(np.sqrt(difference @ covariance[:4, :4] @ difference))
    if apart > 5 * uncertain and apart > GAIN_MAX * max(by_gravity, abs(by_motion)):
        gain = by_gravity / max(by_motion, 1e-12) - 1
        cause = "a wrong mounting of the accelerometer, or stabilised video"
        if abs(gain) < 0.2:
            cause = f"the accelerometer seems to measure {abs(gain):.0%} too {'much' if gain > 0 else 'little'}"
        raise ContradictionError(
            f"the IMU contradicts the camera: by accelerations a unit of the map is {_metres(by_motion)} m, by gravity "
            f"{_metres(by_gravity)} m ({cause})"
        )


def _metres(inverse: float) -> str:
    return f"{1 / inverse:.3g}" if abs(inverse) > 1e-9 else "infinitely many"


def _expected_noise(visual: VisualPoses, samples: Samples, unit: float) -> float:
    """Deviation, in units of the map, of residuals that are noise of visual positions and of the accelerometer."""
    known = visual.select(visual.known)
    step = float(np.median(np.diff(known.times)))
    jitter = white_noise(known.T_wc[:, :3, 3], step) / np.sqrt(step)
    return float(np.hypot(jitter, samples.noise.accel * np.sqrt(WINDOW_S**3 / 3) / unit))


def _solve_constrained(system: _System, free: Array, size: float, expected: float) -> Initial:
    """Gauss-Newton on log lambda, the gravity's direction and the bias, with the gravity's size given.

    expected: the residuals' deviation if all is well.
    """
    A, y = system.A, system.y
    lam, direction, bias = float(np.linalg.norm(free[1:4])) / size, free[1:4] / np.linalg.norm(free[1:4]), np.zeros(3)
    sigma, covariance = 1.0, np.eye(6)
    for _ in range(10):
        across = np.linalg.svd(direction[None])[2][1:]
        x = lam * np.concatenate([[1.0], size * direction, bias])
        residual = y - A @ x
        weight, sigma = _weights(residual)
        J = np.zeros((7, 6))
        J[:, 0] = x
        J[1:4, 1:3] = lam * size * across.T
        J[4:7, 3:6] = lam * np.eye(3)
        AJ = A @ J
        scaled = (sigma * CORRELATION) ** 2
        H = (AJ * weight[:, None]).T @ AJ / scaled + np.diag([1e-6] * 3 + [1 / ACCEL_BIAS_SIGMA**2] * 3)
        covariance = np.linalg.inv(H)
        pull = np.concatenate([np.zeros(3), -bias / ACCEL_BIAS_SIGMA**2])
        step = covariance @ (AJ.T @ (weight * residual) / scaled + pull)
        lam *= float(np.exp(np.clip(step[0], -0.5, 0.5)))
        direction = so3_exp(np.cross(direction, across.T @ step[1:3])) @ direction
        bias = bias + step[3:6]
        if np.linalg.norm(step) < 1e-8:
            break
    relative = float(np.sqrt(covariance[0, 0]))
    if relative > SCALE_SIGMA_MAX:
        if sigma > UNEXPLAINED * expected:
            raise ContradictionError(
                "the IMU contradicts the camera: no scale and no gravity explain its accelerations (a wrong mounting "
                "of the accelerometer, stabilised video or another recording's IMU)"
            )
        raise TooLittleMotionError(
            f"the camera accelerates too little for metres: the scale is known to {relative:.0%}, "
            f"{SCALE_SIGMA_MAX:.0%} is needed"
        )
    return Initial(1 / lam, relative, size * direction, bias, sigma / lam, system.windows, system.signal / lam)
