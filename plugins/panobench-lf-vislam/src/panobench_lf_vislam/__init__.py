"""LF-VISLAM: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "lf-vislam",
    "LF-VISLAM: visual-inertial SLAM for panoramic annular lenses, over a ROS bag",
    "panobench_lf_vislam.method:LfVislam",
    cameras=("pal",),
    needs=("rgb", "imu"),
    colour=False,
    metric=True,
    licence="GPL-3.0",
    citation="Wang et al.: LF-VISLAM (IEEE T-ASE 2023)",
    install="a ROS 1 workspace with LF-VISLAM; then "
    "export PANOBENCH_LF_VISLAM_COMMAND=/path/to/roslaunch or PANOBENCH_LF_VISLAM_RUN_IN=docker:IMAGE",
    probe="panobench_lf_vislam.method:LfVislam.missing",
    config="panobench_lf_vislam.method:LfVislamConfig",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
