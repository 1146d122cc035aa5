"""Where the camera is expected at the next frame: by the gyroscope, and in metres once scale and gravity are known.

Until the gyroscope's turns have been found to agree with the camera's, nothing is expected. Then rotations come from
the gyroscope and positions from a constant velocity. Once the motion has told scale and gravity, positions come from
the accelerometer too, so that a blackout of seconds can be bridged in the map's own unit.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import make_pose, renormalise, so3_log
from panobench.inertial.initialise import DoubleIntegral, Initial, initialise
from panobench.inertial.rotation import RotationFit, fit_rotation
from panobench.inertial.samples import InertialError, Samples
from panobench.inertial.visual import VisualPoses

Array = NDArray[np.float64]

#: Of which past the calibration is made, s.
PAST_S = 20.0
#: How often it is tried: after the first second until it tells the rotations, until it tells scale and gravity, and
#: once it has, s.
TRY_AGAIN_S, TRY_EVERY_S, RENEW_EVERY_S = 0.1, 1.0, 5.0
#: Of which past the velocity at the last frame with a pose is, s.
VELOCITY_S = 0.6
#: The camera is expected by the accelerometer for so long without a visual pose, by the gyroscope alone for so long, s.
RECKON_S, TURN_S = 6.0, 0.5
#: The way a lost camera looks is known for so long; it is taken to go on at its last velocity for so long, s.
HEADING_S, GLIDE_S = 20.0, 3.0
#: How well a turn by the gyroscope is known: at best, what is left of its bias, and of its scale and mounting; its
#: noise and the clock's uncertainty come on top. Degrees, degrees/s, and a share of the turn.
TURN_SIGMA_DEG, DRIFT_DEG_S, TURN_SHARE = 0.02, 0.02, 0.003
#: A camera looks at most so far from where it is expected to.
HEADING_DEG = 5.0
#: Fewest samples that a calibration looks at.
SAMPLES_MIN = 20
#: Most frames that a calibration looks at.
FRAMES_MAX = 300


def looks_elsewhere(T_wc: Array, expected: Array | None) -> bool:
    """Whether a pose (4, 4) looks another way than the gyroscope says; expected (4, 4): None if it says nothing."""
    if expected is None:
        return False
    turned = so3_log(expected[:3, :3].T @ T_wc[:3, :3])
    return float(np.degrees(np.linalg.norm(turned))) > HEADING_DEG


@dataclass
class _Frame:
    index: int
    time: float


class Predictor:
    """pose_of: the present pose T_wc (4, 4) of a frame in the present map; None if it has none there."""

    def __init__(self, samples: Samples, pose_of: Callable[[int], Array | None]) -> None:
        self.samples, self.pose_of = samples, pose_of
        self.rotation: RotationFit | None = None
        self.initial: Initial | None = None
        self.tracked: list[_Frame] = []
        self._next_try: float | None = None

    def record(self, index: int, time: float) -> None:
        """The frame has a visual pose; from time to time the calibration is made again. Not for frames back in time."""
        if self.tracked and time <= self.tracked[-1].time:
            return
        self.tracked.append(_Frame(index, time))
        if self._next_try is None:
            self._next_try = time + TRY_EVERY_S
        if time >= self._next_try:
            self._calibrate(time)
            wait = TRY_AGAIN_S if self.rotation is None else TRY_EVERY_S if self.initial is None else RENEW_EVERY_S
            self._next_try = time + wait

    def expect(self, time: float) -> Array | None:
        """T_wc (4, 4) of the next frame in the present map; None if nothing is known about it."""
        covered = self._covered(time, TURN_S if self.initial is None else RECKON_S)
        return None if covered is None else self._reckon(*covered, time)

    def turn_sigma(self, time: float) -> float:
        """Standard deviation per axis, rad, of the turn from the last frame with a pose until ``time``."""
        rotation, last = self._known_rotation, self.tracked[-1].time
        first, stop = np.searchsorted(self.samples.times, [last - rotation.offset_s, time - rotation.offset_s])
        rates = np.linalg.norm(self.samples.gyro[max(first - 1, 0) : stop + 1] - rotation.bias, axis=1)
        fastest, since = float(rates.max(initial=0.0)), time - last
        parts = (
            np.radians(TURN_SIGMA_DEG),
            np.radians(DRIFT_DEG_S) * since,
            self.samples.noise.gyro * np.sqrt(since),
            max(TURN_SHARE, abs(rotation.gain - 1)) * float(rates.mean() if len(rates) else 0.0) * since,
            rotation.offset_sigma_s * fastest,
        )
        return float(np.linalg.norm(parts))

    def heading(self, time: float) -> Array | None:
        """T_wc (4, 4) of a camera that has been lost for a while; None if nothing is known about it.

        It looks the way that the gyroscope says, and is roughly where its last velocity takes it.
        """
        covered = self._covered(time, HEADING_S)
        if covered is None:
            return None
        recent, near = covered
        since, p = recent.times - recent.times[-1], recent.T_wc[:, :3, 3]
        velocity = np.polyfit(since, p, 1)[0] if len(recent) > 2 else np.zeros(3)
        R = self._turned(recent, DoubleIntegral(recent, near, self._known_rotation), time)
        return renormalise(make_pose(R, p[-1] + velocity * min(time - recent.times[-1], GLIDE_S)))

    def _covered(self, time: float, most_s: float) -> tuple[VisualPoses, Samples] | None:
        """The last frames with a pose, and the samples from the first of them until ``time``.

        None if there are gaps, or if the last frame is longer ago than ``most_s``.
        """
        if self.rotation is None or not self.tracked:
            return None
        last = self.tracked[-1]
        if not 0 < time - last.time <= most_s:
            return None
        recent = self._poses(last.time - VELOCITY_S)
        if not len(recent) or recent.times[-1] != last.time:
            return None
        offset = self.rotation.offset_s
        begin, end = recent.times[0] - offset - 0.1, time - offset + 0.1
        first, stop = np.searchsorted(self.samples.times, [begin, end])
        near = _slice(self.samples, int(first), int(stop))
        if len(near) < 4 or not near.shifted(offset).covers(recent.times[:1], np.array([time]))[0]:
            return None
        return recent, near

    @property
    def _known_rotation(self) -> RotationFit:
        assert self.rotation is not None
        return self.rotation

    def _turned(self, recent: VisualPoses, integral: DoubleIntegral, time: float) -> Array:
        """(3, 3) the camera's axes at ``time``, in the map's."""
        R_cb = self._known_rotation.R_body_cam.T
        return np.asarray(recent.T_wc[-1, :3, :3] @ R_cb @ integral.turn(recent.times[-1], time) @ R_cb.T)

    def _reckon(self, recent: VisualPoses, near: Samples, time: float) -> Array:
        """By the samples from the first of the recent frames on."""
        integral = DoubleIntegral(recent, near, self._known_rotation)
        times = np.append(recent.times, time)
        R_cb = self._known_rotation.R_body_cam.T
        R = self._turned(recent, integral, time)
        p = recent.T_wc[:, :3, 3]
        if self.initial is None:
            if len(recent) < 2:
                return make_pose(R, p[-1])
            velocity = (p[-1] - p[-2]) / (times[-2] - times[-3])
            return renormalise(make_pose(R, p[-1] + velocity * (time - times[-2])))
        force, turned = integral.at(times)
        lever = np.concatenate([recent.T_wc[:, :3, :3], R[None]]) @ (R_cb @ near.T_body_cam[:3, 3])
        t = (times - recent.times[-1])[:, None]
        known = force + lever + self.initial.gravity * t**2 / 2 - turned @ self.initial.accel_bias
        known /= self.initial.scale
        # What is left is a start and a velocity; a single frame has no velocity.
        basis = np.concatenate([np.ones_like(t), t], axis=1)[:, : min(len(recent), 2)]
        start = np.linalg.lstsq(basis[:-1], p - known[:-1], rcond=None)[0]
        return renormalise(make_pose(R, basis[-1] @ start + known[-1]))

    def _poses(self, since: float) -> VisualPoses:
        """Of the frames since then that have a pose in the present map."""
        first = bisect_left(self.tracked, since, key=lambda frame: frame.time)
        frames = self.tracked[first:]
        frames = frames[:: max(-(-len(frames) // FRAMES_MAX), 1)] if len(frames) > FRAMES_MAX else frames
        found = [(frame.time, T) for frame in frames if (T := self.pose_of(frame.index)) is not None]
        times = np.array([time for time, _ in found])
        return VisualPoses.of_one_map(times, np.array([T for _, T in found]).reshape(-1, 4, 4))

    def _calibrate(self, time: float) -> None:
        """What cannot be found stays as it was; the whole recording is judged at its end."""
        past = self._poses(time - PAST_S)
        if len(past) < 2:
            return
        first, stop = np.searchsorted(self.samples.times, [past.times[0] - 0.6, time + 0.6])
        near = _slice(self.samples, int(first), int(stop))
        if len(near) < SAMPLES_MIN:  # clocks that are apart; it is said at the end
            return
        try:
            self.rotation = fit_rotation(past, near)
            self.initial = initialise(past, near, self.rotation)
        except InertialError:
            return


def _slice(samples: Samples, first: int, stop: int) -> Samples:
    chosen, between = slice(first, stop), slice(first, max(stop - 1, first))
    return replace(
        samples,
        times=samples.times[chosen],
        gyro=samples.gyro[chosen],
        accel=samples.accel[chosen],
        usable=samples.usable[between],
    )
