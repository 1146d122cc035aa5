"""P2U-SLAM: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "p2u-slam",
    "P2U-SLAM: wide field of view SLAM with point and pose uncertainty (no public code yet)",
    "panobench_p2u_slam.method:P2uSlam",
    cameras=("pal", "fisheye", "pinhole"),
    needs=("rgb",),
    colour=False,
    metric=False,
    licence="not released",
    citation="Zhang et al.: P2U-SLAM (arXiv 2409.10143, 2024)",
    install="when its code is public: export PANOBENCH_P2U_SLAM_COMMAND=/path/to/its/program",
    probe="panobench_p2u_slam.method:P2uSlam.missing",
    config="panobench_p2u_slam.method:P2uSlamConfig",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
