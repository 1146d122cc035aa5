"""LF-VISLAM: VINS-Mono's family with points on the sphere, for panoramic annular lenses. A ROS 1 bag in, text out.

Features are searched in a ring between two circles, or where a mask allows it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from panobench import Camera, Imu, UnsupportedError, option
from panobench.external import (
    ExternalConfig,
    VinsConfig,
    VinsMethod,
    camodocal_camera,
    fit_annulus,
    vins_settings,
    write_tracker_mask,
)

#: A ring that differs from the camera's mask in a larger share of the image is replaced by the mask itself.
MAX_MISMATCH = 0.005


@dataclass(frozen=True)
class LfVislamConfig(VinsConfig):
    """Result, and values published for PALVIO."""

    result: str = option("stamped_traj_estimate.txt", "the estimator's file; its name is set in the program's source")
    result_format: Literal["tum", "euroc"] = option("tum", "rows of time, position, quaternion; or VINS-Mono's CSV")
    acc_w: float = option(0.04, "random walk of the accelerometer's bias, per sample", unit="m/s^2")
    gyr_w: float = option(0.002, "random walk of the gyroscope's bias, per sample", unit="rad/s")
    extrinsic: int = option(1, "0 trusts the given pose of the camera on the body, 1 refines it", maximum=1)
    max_cnt: int = option(200, "features per image", above=0)
    min_dist: int = option(20, "distance between two features", unit="px", above=0)


def ring_section(camera: Camera, folder: Path) -> dict[str, Any]:
    """The two circles about one centre between which features are searched. They are fitted to the valid pixels.

    If a ring cannot describe these (an operator hides a part), the mask is written and used instead.
    """
    v, valid = camera.to_dict(), camera.valid_mask()
    ring = fit_annulus(valid, float(v["cx"]) - 0.5, float(v["cy"]) - 0.5)
    # the program cuts the centre to whole pixels
    circles = {"center_x": float(round(ring.x)), "center_y": float(round(ring.y))}
    values: dict[str, Any] = {**circles, "max_r": round(ring.outer), "min_r": round(ring.inner)}
    if ring.mismatch > MAX_MISMATCH:
        write_tracker_mask(valid, folder)
        values["fisheye"] = 1
    return values


class LfVislam(VinsMethod):
    """Panoramic annular images with IMU."""

    title: ClassVar[str] = "LF-VISLAM"
    variable: ClassVar[str] = "PANOBENCH_LF_VISLAM"
    config_class: ClassVar[type[ExternalConfig]] = LfVislamConfig
    config: LfVislamConfig

    def result(self) -> tuple[str, Literal["tum", "euroc"]]:
        return Path(self.config.result).name, self.config.result_format

    def settings(self, camera: Camera, imu: Imu, folder: Path, output: Path) -> dict[str, Any]:
        if camera.kind != "pal":
            raise UnsupportedError(f"LF-VISLAM takes panoramic annular images, not {camera.kind}; give --camera pal")
        values = camodocal_camera(camera, self.title) | vins_settings(self.config, imu, output)
        return values | ring_section(camera, folder)
