"""Inertial samples made ready: sorted, in SI units, with their noise, and what was found wrong with them.

What cannot be mended is said in one line, and the samples are not used. Axes, signs and the mounting cannot be judged
here; ``rotation`` and ``initialise`` do that with the camera's motion.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from panobench.types import Imu

Array = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
#: What an accelerometer measures at rest, by the name of its unit if that is not m/s^2.
GRAVITY_UNITS = {STANDARD_GRAVITY: "", 1.0: "g", 1000.0: "milli-g", 100 * STANDARD_GRAVITY: "cm/s^2"}
#: Slowest rate that can follow a walk, Hz.
RATE_MIN = 45.0
#: Longest interval between samples that is interpolated, in usual intervals and in seconds.
GAP_INTERVALS, GAP_S = 4.0, 0.03
#: As many samples in a row at the largest value that was ever measured are saturated.
SATURATED_RUN = 3
#: No sensor's range ends below this: rad/s, m/s^2. Values that end below it all the same were cut off later: so many of
#: them are at the very end, and so many times as many as at the next value, while a sensor's steps thin out.
GYRO_RANGE, ACCEL_RANGE = 1.5, 1.8 * STANDARD_GRAVITY
CUT_LEAST, CUT_TIMES = 30, 10
#: Share of the frames' time that samples have to cover, and share below which it is said.
COVERED_MIN, COVERED_ALL = 0.5, 0.95
#: A sample that is so many deviations and at least so much (rad/s, m/s^2) off the mean of its neighbours is a spike.
SPIKE_SIGMAS, GYRO_SPIKE, ACCEL_SPIKE = 40.0, 5.0, 3 * STANDARD_GRAVITY
#: Share of saturated samples from which the samples are not used.
SATURATED_MAX = 0.02
#: White noise is taken for at least this: rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).
GYRO_FLOOR, ACCEL_FLOOR = 1e-4, 1e-3


class InertialError(Exception):
    """The samples cannot be used; the message says why in one line. Never leaves this package's callers."""


class TooLittleMotionError(InertialError):
    """Nothing is wrong, and nothing can be said yet."""


class ContradictionError(InertialError):
    """Camera and IMU cannot both be right."""


@dataclass(frozen=True)
class ImuNoise:
    """Densities: gyro rad/s/sqrt(Hz), accel m/s^2/sqrt(Hz), and of the biases' random walks, per s and sqrt(Hz)."""

    gyro: float
    accel: float
    gyro_walk: float = 2e-4
    accel_walk: float = 1e-3


@dataclass(frozen=True)
class Samples:
    """Samples that can be used.

    times (N,): s, increasing, on the camera's clock. gyro, accel (N, 3): rad/s and m/s^2 in body axes. T_body_cam
    (4, 4): pose of the camera on the body. gravity: its magnitude, m/s^2. usable (N - 1,): intervals between two
    samples that may be integrated, the others are gaps. remarks: what was found and mended.
    """

    times: Array
    gyro: Array
    accel: Array
    T_body_cam: Array
    gravity: float
    noise: ImuNoise
    usable: NDArray[np.bool_]
    remarks: tuple[str, ...] = field(default=())

    def __len__(self) -> int:
        return len(self.times)

    def shifted(self, seconds: float) -> Samples:
        """With every time later by ``seconds``."""
        return replace(self, times=self.times + seconds)

    def covers(self, begin: Array, end: Array) -> NDArray[np.bool_]:
        """(M,) whether the samples cover the time from each ``begin`` (M,) to ``end`` (M,) without a gap."""
        gaps = np.concatenate([[0], np.cumsum(~self.usable)])
        first = np.searchsorted(self.times, begin, side="right") - 1
        last = np.searchsorted(self.times, end, side="left")
        inside = (first >= 0) & (last < len(self.times))
        first, last = np.clip(first, 0, len(gaps) - 1), np.clip(last, 0, len(gaps) - 1)
        return np.asarray(inside & (gaps[last] == gaps[first]))

    def between(self, begin: float, end: float) -> tuple[Array, Array, Array]:
        """Means over the pieces that the samples' times cut [begin, end] into, and the pieces' lengths.

        Returns accel (P, 3), gyro (P, 3), seconds (P,). The values are linear between two samples.
        """
        inside = self.times[np.searchsorted(self.times, begin, "right") : np.searchsorted(self.times, end, "left")]
        times = np.concatenate([[begin], inside, [end]])
        k = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, len(self.times) - 2)
        share = ((times - self.times[k]) / (self.times[k + 1] - self.times[k]))[:, None]
        accel = (1 - share) * self.accel[k] + share * self.accel[k + 1]
        gyro = (1 - share) * self.gyro[k] + share * self.gyro[k + 1]
        seconds = np.diff(times)
        keep = seconds > 1e-9
        return ((accel[1:] + accel[:-1]) / 2)[keep], ((gyro[1:] + gyro[:-1]) / 2)[keep], seconds[keep]


def usable_samples(imu: Imu, frame_times: Array | None = None) -> Samples:
    """The samples, ready for use with frames at ``frame_times`` (F,) in s, if these are known yet.

    Raises InertialError if there are too few or too slow, if they do not overlap the frames, are no numbers, are
    saturated for long, or if their unit is not known.
    """
    remarks: list[str] = []
    times, gyro, accel = _sorted(imu, remarks)
    step = float(np.median(np.diff(times)))
    if step > 1 / RATE_MIN:
        raise InertialError(f"the IMU has {1 / step:.0f} samples a second; {RATE_MIN:.0f} are the least that help")
    if frame_times is not None:
        _check_overlap(times, frame_times, remarks)
    accel = _in_si(accel, step, remarks)
    spikes = _spikes(gyro, GYRO_SPIKE) | _spikes(accel, ACCEL_SPIKE)
    if spikes.any():
        remarks.append(f"{int(spikes.sum())} samples of the IMU are spikes and left out")
        times, gyro, accel = times[~spikes], gyro[~spikes], accel[~spikes]
    saturated = _saturated(gyro, GYRO_RANGE) | _saturated(accel, ACCEL_RANGE)
    if saturated.mean() > SATURATED_MAX:
        raise InertialError(f"{saturated.mean():.0%} of the IMU's samples are saturated")
    if saturated.any():
        remarks.append(f"{int(saturated.sum())} samples of the IMU are saturated and left out")
    usable = np.diff(times) <= max(GAP_INTERVALS * step, GAP_S)
    if not usable.all():
        longest = float(np.diff(times).max())
        remarks.append(f"the IMU has {int((~usable).sum())} gaps, the longest {longest:.2f} s")
    usable &= ~(saturated[1:] | saturated[:-1])
    T_body_cam = np.eye(4) if imu.T_body_cam is None else np.asarray(imu.T_body_cam, np.float64)
    noise = ImuNoise(max(white_noise(gyro, step), GYRO_FLOOR), max(white_noise(accel, step), ACCEL_FLOOR))
    gravity = imu.gravity or STANDARD_GRAVITY
    return Samples(times, gyro, accel, T_body_cam, gravity, noise, usable, tuple(remarks))


def _check_overlap(times: Array, frame_times: Array, remarks: list[str]) -> None:
    overlap = min(times[-1], frame_times[-1]) - max(times[0], frame_times[0])
    span = frame_times[-1] - frame_times[0]
    if COVERED_MIN * span <= overlap < COVERED_ALL * span:
        remarks.append(f"the IMU's samples cover {overlap / span:.0%} of the time of the frames")
    if overlap < COVERED_MIN * span:
        raise InertialError(
            f"the IMU's samples are from {times[0]:.2f} to {times[-1]:.2f} s, the frames from {frame_times[0]:.2f} to "
            f"{frame_times[-1]:.2f} s: less than half is covered"
        )


def white_noise(values: Array, step: float) -> float:
    """Density of the white noise in samples (N, 3) that are ``step`` s apart, in their unit/sqrt(Hz).

    By the third differences, in which motion that is slow against the rate cancels; their variance is 20 times that of
    the noise. The median makes it robust.
    """
    third = np.diff(values, 3, axis=0)
    sigma = np.median(np.abs(third), axis=0) / 0.6745 / np.sqrt(20.0) if len(third) else np.zeros(3)
    return float(np.sqrt(np.mean(sigma**2) * step))


def _sorted(imu: Imu, remarks: list[str]) -> tuple[Array, Array, Array]:
    times = np.asarray(imu.times, np.float64)
    gyro, accel = np.asarray(imu.gyro, np.float64), np.asarray(imu.accel, np.float64)
    finite = np.isfinite(times) & np.isfinite(gyro).all(axis=1) & np.isfinite(accel).all(axis=1)
    if not finite.all():
        remarks.append(f"{int((~finite).sum())} samples of the IMU are no numbers and left out")
    times, gyro, accel = times[finite], gyro[finite], accel[finite]
    if (np.diff(times) <= 0).any():
        times, first = np.unique(times, return_index=True)
        remarks.append("the IMU's samples are not in the order of time, or repeat; they were sorted")
        gyro, accel = gyro[first], accel[first]
    if len(times) < 20:
        raise InertialError(f"the IMU has {len(times)} usable samples")
    return times, gyro, accel


def _in_si(accel: Array, step: float, remarks: list[str]) -> Array:
    """Specific force in m/s^2; it is in g if it is about one, by the median of the samples or of means over a second.

    The samples of a fast walk are too large by half, but their means are not. Means that are much smaller than the
    samples have no gravity in them.
    """
    n = max(1, min(len(accel), round(1 / step)))
    seconds = accel[: len(accel) // n * n].reshape(-1, n, 3).mean(axis=1)
    size, mean = (float(np.median(np.linalg.norm(v, axis=1))) for v in (accel, seconds))
    at_rest = (size, mean) if mean > 0.6 * size else (size,)
    for unit, name in sorted(GRAVITY_UNITS.items(), key=lambda each: abs(np.log(each[0] / max(mean, 1e-12)))):
        if not any(0.75 * unit < s < 1.3 * unit for s in at_rest):
            continue
        if name:
            taken = f"it is taken to be in {name}, not m/s^2"
            remarks.append(f"the accelerometer measures {size:.{0 if unit > 1 else 2}f} at rest: {taken}")
        return accel * (STANDARD_GRAVITY / unit) if name else accel
    hint = "; gravity seems to have been taken out of it" if size < 0.6 * STANDARD_GRAVITY else ""
    raise InertialError(f"the accelerometer measures {size:.3g} at rest, neither 9.8 m/s^2 nor 1 g{hint}")


def _spikes(values: Array, least: float) -> NDArray[np.bool_]:
    """(N,) single samples of (N, 3) that are far off both neighbours."""
    out = np.zeros(len(values), bool)
    apart = np.pad(np.linalg.norm(values[1:-1] - (values[:-2] + values[2:]) / 2, axis=1), 1)
    largest = (apart[1:-1] >= apart[:-2]) & (apart[1:-1] >= apart[2:])
    out[1:-1] = largest & (apart[1:-1] > max(least, SPIKE_SIGMAS * float(np.median(apart)) / 0.6745))
    return out


def _cut_off(size: Array) -> bool:
    """Whether values (N,) end as if they had been cut off, and not as a motion or a sensor's noise ends."""
    levels, counts = np.unique(size, return_counts=True)
    return len(levels) > CUT_TIMES and counts[-1] >= CUT_LEAST and counts[-1] > CUT_TIMES * counts[-2]


def _saturated(values: Array, least: float) -> NDArray[np.bool_]:
    """(N,) samples in a run of equal values at the end of an axis' range, which is from ``least`` on or cut off."""
    out = np.zeros(len(values), bool)
    for size in np.abs(values).T:
        if size.max() < least and not _cut_off(size):
            continue
        at = size >= size.max() * (1 - 1e-6)
        run = np.convolve(at, np.ones(SATURATED_RUN, np.int64))[: len(at)] >= SATURATED_RUN
        for back in range(SATURATED_RUN):
            out[: len(out) - back] |= run[back:]
    return out
