"""Photo-SLAM: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "photo-slam",
    "the original Photo-SLAM: ORB-SLAM3 with a Gaussian mapper (CUDA)",
    "panobench_photo_slam.method:PhotoSlam",
    cameras=("pinhole",),
    needs=("rgb",),
    colour=True,
    metric=False,
    licence="GPL-3.0",
    citation="Huang et al.: Photo-SLAM (CVPR 2024)",
    install="build Photo-SLAM, then export PANOBENCH_PHOTO_SLAM_COMMAND=/path/to/bin/tum_mono",
    probe="panobench_photo_slam.method:PhotoSlam.missing",
    config="panobench_photo_slam.method:PhotoSlamConfig",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
