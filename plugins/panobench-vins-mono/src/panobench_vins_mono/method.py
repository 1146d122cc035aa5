"""VINS-Mono: a ROS 1 bag and a launch file in, the estimator's CSV out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from panobench import Camera, Imu, option
from panobench.external import (
    ExternalConfig,
    VinsConfig,
    VinsMethod,
    camodocal_camera,
    pixels_ahead,
    vins_settings,
    write_tracker_mask,
)


@dataclass(frozen=True)
class VinsMonoConfig(VinsConfig):
    """Pose graph."""

    loop: bool = option(False, "take the result of the pose graph, which holds keyframes only")


class VinsMono(VinsMethod):
    """Monocular with IMU. Features are searched where the camera's mask allows it, and ahead of the camera."""

    title: ClassVar[str] = "VINS-Mono"
    variable: ClassVar[str] = "PANOBENCH_VINS_MONO"
    config_class: ClassVar[type[ExternalConfig]] = VinsMonoConfig
    config: VinsMonoConfig

    def packages(self) -> tuple[str, ...]:
        return (*super().packages(), *(("pose_graph",) if self.config.loop else ()))

    def node_parameters(self, package: str) -> dict[str, str | int | float]:
        if package != "pose_graph":
            return {}
        return {"visualization_shift_x": 0, "visualization_shift_y": 0, "skip_cnt": 0, "skip_dis": 0.0}

    def result(self) -> tuple[str, Literal["euroc"]]:
        return ("vins_result_loop.csv" if self.config.loop else "vins_result_no_loop.csv"), "euroc"

    def settings(self, camera: Camera, imu: Imu, folder: Path, output: Path) -> dict[str, Any]:
        values = camodocal_camera(camera, self.title) | vins_settings(self.config, imu, output)
        values["loop_closure"] = int(self.config.loop)
        # it carries points to the plane z = 1: rays beyond 90 degrees would come back from the other side
        keep = camera.valid_mask() if camera.kind == "pinhole" else pixels_ahead(camera)
        if not keep.all():
            write_tracker_mask(keep, folder)
            values["fisheye"] = 1
        return values
