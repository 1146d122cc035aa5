"""stella_vslam: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "stella-vslam",
    "stella_vslam (OpenVSLAM's successor): feature-based SLAM, natively on panoramas",
    "panobench_stella_vslam.method:StellaVslam",
    cameras=("erp", "pinhole", "fisheye"),
    needs=("rgb",),
    colour=False,
    metric=False,
    licence="BSD-2-Clause",
    citation="Sumikura et al.: OpenVSLAM (ACM MM 2019)",
    install="build stella_vslam_examples, then export PANOBENCH_STELLA_VSLAM_COMMAND=/path/to/run_image_slam",
    probe="panobench_stella_vslam.method:StellaVslam.missing",
    config="panobench_stella_vslam.method:StellaVslamConfig",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
