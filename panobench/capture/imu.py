"""What an inertial sensor measures on a smooth motion: the ideal samples, white noise and biases that walk.

Used by every synthesiser, so that their IMUs are alike. Noise as in Kalibr's model: a density in units per root hertz
gives each sample the deviation density * sqrt(rate); a bias gains density / sqrt(rate) per sample (Furgale, Rehder &
Siegwart, "Unified temporal and spatial calibration for multi-sensor systems", IROS 2013).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.constants import g as STANDARD_GRAVITY
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from panobench.geometry import make_pose
from panobench.types import Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ImuNoise:
    """gyro, accel: noise densities, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz). gyro_walk, accel_walk: densities of the biases'
    walks, rad/s^2/sqrt(Hz) and m/s^3/sqrt(Hz). gyro_bias, accel_bias: deviations of the first biases, rad/s and m/s^2.
    """

    gyro: float = 0.0
    accel: float = 0.0
    gyro_walk: float = 0.0
    accel_walk: float = 0.0
    gyro_bias: float = 0.0
    accel_bias: float = 0.0


@dataclass(frozen=True)
class ImuSamples:
    """times (N,) s; gyro (N, 3) rad/s; accel, the specific force (N, 3) m/s^2, in body axes; and the biases in them."""

    times: Array
    gyro: Array
    accel: Array
    gyro_bias: Array = field(default_factory=lambda: np.zeros((0, 3)))
    accel_bias: Array = field(default_factory=lambda: np.zeros((0, 3)))


class BodyMotion:
    """Smooth body motion through poses (N, 4, 4) at times (N,): cubic splines of position and rotation."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.times = trajectory.times
        self._position = CubicSpline(trajectory.times, trajectory.positions)
        self._rotation = RotationSpline(trajectory.times, Rotation.from_matrix(trajectory.T_wc[:, :3, :3]))

    def poses(self, times: Array) -> Array:
        """Body-to-world poses (M, 4, 4)."""
        return make_pose(self._rotation(times).as_matrix(), self._position(times))

    def rates(self, times: Array) -> Array:
        """Angular rates (M, 3) in body axes, rad/s."""
        return np.asarray(self._rotation(times, 1))

    def imu(self, times: Array, up: Array, gravity: float = STANDARD_GRAVITY) -> tuple[Array, Array]:
        """Angular rate (M, 3) rad/s and specific force (M, 3) m/s^2 in body axes; ``up`` is against gravity."""
        R = self._rotation(times).as_matrix()
        force = self._position(times, 2) + gravity * up
        return self.rates(times), np.einsum("nji,nj->ni", R, force)


def sample_times(begin: float, end: float, rate_hz: float) -> Array:
    """Times at a rate from ``begin`` on; the last one is ``end``, so that every image lies between two."""
    n = int(np.ceil((end - begin) * rate_hz - 1e-6)) + 1
    return np.minimum(begin + np.arange(n) / rate_hz, end)


def simulate_imu(
    motion: BodyMotion,
    times: Array,
    rate_hz: float,
    up: Array,
    noise: ImuNoise,
    rng: np.random.Generator,
    gravity: float = STANDARD_GRAVITY,
) -> ImuSamples:
    """Samples at ``times`` (N,), about ``rate_hz`` of them a second; ``up`` (3,) is against gravity in the world."""
    gyro, accel = motion.imu(times, up, gravity)
    root = np.sqrt(rate_hz)
    gyro = gyro + rng.normal(0, noise.gyro * root, gyro.shape)
    accel = accel + rng.normal(0, noise.accel * root, accel.shape)
    gyro_bias = _bias(noise.gyro_bias, noise.gyro_walk / root, len(times), rng)
    accel_bias = _bias(noise.accel_bias, noise.accel_walk / root, len(times), rng)
    return ImuSamples(times, gyro + gyro_bias, accel + accel_bias, gyro_bias, accel_bias)


def _bias(first: float, step: float, count: int, rng: np.random.Generator) -> Array:
    begin = rng.normal(0, first, 3)
    return np.asarray(begin + np.cumsum(rng.normal(0, step, (count, 3)), axis=0))
