"""Visual poses and inertial samples to a trajectory in metres, z up: checks, initialisation, fit, all frames.

Whatever is wrong is a line in the result, and then nothing is claimed: there is no scale that might be wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import UnavailableError
from panobench.geometry import Sim3, make_pose, umeyama
from panobench.inertial.initialise import SCALE_SIGMA_MAX, Initial, initialise
from panobench.inertial.rotation import RotationFit, fit_rotation
from panobench.inertial.samples import ContradictionError, Samples, TooLittleMotionError, usable_samples
from panobench.inertial.visual import VisualPoses
from panobench.types import Imu

Array = NDArray[np.float64]

#: Residuals of the inertial factors, in standard deviations, from which the two contradict one another.
INERTIAL_RMS_MAX = 4.0
#: Errors of visual positions may go with the motion: a small motion is found a bit too small where images are coarse.
#: This share of them is taken to.
SYSTEMATIC = 0.5
#: Two scales contradict one another if they differ by more than so many standard deviations.
CONTRADICTION = 3.0
#: The first estimate of the scale and the fit's may differ by this, relative.
SCALES_APART = 0.1


@dataclass(frozen=True)
class Unit:
    """What else is known of the unit of the longest map, such as by a rig: metres, and their relative deviation."""

    metres: float
    sigma: float


@dataclass(frozen=True)
class Fusion:
    """T_wc (F, 4, 4): metres, z up, NaN for a frame without a pose. bridged (F,): by the IMU alone.

    scale: metres in a unit of the first map; scale_sigma: its relative standard deviation. offset_s: added to the IMU's
    times. gyro_bias, accel_bias (3,): medians. position_m, rotation_rad: noise of the visual poses.
    """

    T_wc: Array
    bridged: NDArray[np.bool_]
    scale: float
    scale_sigma: float
    offset_s: float
    gyro_bias: Array
    accel_bias: Array
    position_m: float
    rotation_rad: float
    remarks: tuple[str, ...] = field(default=())

    def numbers(self) -> dict[str, Any]:
        """For run.json."""
        return {
            "scale": self.scale,
            "scale_sigma": self.scale_sigma,
            "time_offset_s": self.offset_s,
            "gyro_bias_rad_s": self.gyro_bias.tolist(),
            "accel_bias_m_s2": self.accel_bias.tolist(),
            "visual_position_sigma_m": self.position_m,
            "visual_rotation_sigma_rad": self.rotation_rad,
            "bridged_frames": int(self.bridged.sum()),
        }

    def with_unit(self, unit: Unit) -> Fusion:
        """With the scale that both tell, weighted by their variances; a remark where they contradict one another."""
        own, other = 1 / self.scale_sigma**2, 1 / unit.sigma**2
        apart = float(np.log(unit.metres / self.scale))
        factor = float(np.exp(other / (own + other) * apart))
        T_wc, remarks = self.T_wc.copy(), self.remarks
        T_wc[:, :3, 3] *= factor
        if abs(apart) > CONTRADICTION * np.hypot(self.scale_sigma, unit.sigma):
            remarks += (f"the lenses' distance and the IMU tell scales that are {np.expm1(abs(apart)):.1%} apart",)
        sigma = float(1 / np.sqrt(own + other))
        return replace(self, T_wc=T_wc, scale=self.scale * factor, scale_sigma=sigma, remarks=remarks)

    def similarity(self, visual: VisualPoses) -> Sim3:
        """From the visual world to this one, by the poses of the map with most frames."""
        counts = np.bincount(visual.maps[visual.known])
        both = (visual.maps == int(np.argmax(counts))) & np.isfinite(self.T_wc[:, 0, 0])
        return umeyama(visual.T_wc[both, :3, 3], self.T_wc[both, :3, 3])


def missing_package() -> str | None:
    """Why the fit cannot run here, in one line; None if it can."""
    import importlib.util

    if importlib.util.find_spec("gtsam") is None:
        return "the visual-inertial fit needs the Python package gtsam: pip install 'panobench[inertial]'"
    return None


def fuse(visual: VisualPoses, imu: Imu) -> Fusion:
    """Of a whole recording.

    Raises TooLittleMotionError if the motion does not tell the scale, InertialError if the samples cannot be used or
    contradict the camera, UnavailableError without gtsam.
    """
    reason = missing_package()
    if reason:
        raise UnavailableError(reason)
    samples = usable_samples(imu, visual.times)
    rotation = fit_rotation(visual, samples)
    initials = initial_of_maps(visual, samples, rotation)
    return _fit(visual, samples, rotation, initials)


def initial_of_maps(visual: VisualPoses, samples: Samples, rotation: RotationFit) -> dict[int, Initial]:
    """Of every map whose motion tells its scale; raises what the longest one raises if none does."""
    counts = np.bincount(visual.maps[visual.known])
    found, failure = {}, None
    for m in np.argsort(-counts):
        if counts[m] == 0:
            continue
        own = VisualPoses(visual.times, visual.T_wc, np.where(visual.maps == m, 0, -1))
        try:
            found[int(m)] = initialise(own, samples, rotation)
        except TooLittleMotionError as error:
            failure = failure or error
    if not found:
        raise failure or TooLittleMotionError("no frame has a visual pose")
    return found


def _fit(visual: VisualPoses, samples: Samples, rotation: RotationFit, initials: dict[int, Initial]) -> Fusion:
    from panobench.inertial.fit import Noise, fit
    from panobench.inertial.nodes import at_all_frames, place

    samples = samples.shifted(rotation.offset_s)
    T_body_cam = make_pose(rotation.R_body_cam, samples.T_body_cam[:3, 3])
    placed = place(visual, samples, T_body_cam, rotation, initials)
    main = max(initials, key=lambda m: int((visual.maps == m).sum()))
    found = fit(placed.nodes, samples, T_body_cam, Noise(initials[main].noise_m, rotation.noise_rad / np.sqrt(2)))
    of_main = placed.nodes.maps == main
    scale = float(np.exp(np.mean(np.log(found.scale[of_main]))))
    if found.inertial_rms > INERTIAL_RMS_MAX:
        raise ContradictionError(
            f"the IMU contradicts the camera: its residuals are {found.inertial_rms:.1f} times what its noise explains"
        )
    if found.scale_sigma > SCALE_SIGMA_MAX:
        raise TooLittleMotionError(
            f"visual poses drift too much for metres: the scale is known to {found.scale_sigma:.0%}, "
            f"{SCALE_SIGMA_MAX:.0%} is needed"
        )
    if abs(np.log(scale / initials[main].scale)) > SCALES_APART:
        raise ContradictionError(
            f"no scale fits both camera and IMU: {initials[main].scale:.3g} m a unit at first, {scale:.3g} m in the fit"
        )
    T_wc = at_all_frames(visual, placed, found.T_wb, found.scale, T_body_cam)
    bridged = np.isfinite(T_wc[:, 0, 0]) & ~visual.known
    return Fusion(
        T_wc,
        bridged,
        scale,
        float(np.hypot(found.scale_sigma, SYSTEMATIC * found.noise.position_m / initials[main].signal_m)),
        rotation.offset_s,
        np.median(found.gyro_bias, axis=0),
        np.median(found.accel_bias, axis=0),
        found.noise.position_m,
        found.noise.rotation_rad,
        (*samples.remarks, *rotation.remarks),
    )
