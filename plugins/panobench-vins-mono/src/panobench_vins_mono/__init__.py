"""VINS-Mono: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "vins-mono",
    "VINS-Mono: monocular visual-inertial odometry, over a ROS bag",
    "panobench_vins_mono.method:VinsMono",
    cameras=("pinhole", "omni", "pal"),
    needs=("rgb", "imu"),
    colour=False,
    metric=True,
    licence="GPL-3.0",
    citation="Qin et al.: VINS-Mono (IEEE T-RO 2018)",
    install="a ROS 1 workspace with VINS-Mono; then "
    "export PANOBENCH_VINS_MONO_COMMAND=/path/to/roslaunch or PANOBENCH_VINS_MONO_RUN_IN=docker:IMAGE",
    probe="panobench_vins_mono.method:VinsMono.missing",
    config="panobench_vins_mono.method:VinsMonoConfig",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
