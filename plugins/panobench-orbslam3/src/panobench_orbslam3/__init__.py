"""ORB-SLAM3: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

_CITATION = "Campos et al.: ORB-SLAM3 (IEEE T-RO 2021)"

PYTHON = MethodSpec(
    "orbslam3",
    "the genuine ORB-SLAM3, monocular, through pyorbslam3",
    "panobench_orbslam3.bindings:OrbSlam3",
    cameras=("pinhole", "fisheye"),
    colour=False,
    licence="GPL-3.0",
    citation=_CITATION,
    install='pip install "pyorbslam3==0.1.1"; apt install libgl1 libegl1 libopengl0 libsm6 libice6 libx11-6 libxext6',
    probe="panobench_orbslam3.bindings:OrbSlam3.missing",
    config="panobench_orbslam3.bindings:OrbSlam3Config",
    deterministic=False,
)
INERTIAL = MethodSpec(
    "orbslam3-inertial",
    "the genuine ORB-SLAM3, monocular with IMU, through pyorbslam3",
    "panobench_orbslam3.bindings:OrbSlam3Inertial",
    cameras=("pinhole", "fisheye"),
    needs=("rgb", "imu"),
    colour=False,
    metric=True,
    licence="GPL-3.0",
    citation=_CITATION,
    install=PYTHON.install,
    probe="panobench_orbslam3.bindings:OrbSlam3Inertial.missing",
    config="panobench_orbslam3.bindings:OrbSlam3InertialConfig",
    deterministic=False,
)
BINARY = MethodSpec(
    "orbslam3-binary",
    "the genuine ORB-SLAM3, monocular, through its own mono_euroc program",
    "panobench_orbslam3.binary:OrbSlam3Binary",
    cameras=("pinhole", "fisheye"),
    colour=False,
    licence="GPL-3.0",
    citation=_CITATION,
    install="build ORB-SLAM3, then export PANOBENCH_ORBSLAM3_BINARY_COMMAND=/path/to/mono_euroc",
    probe="panobench_orbslam3.binary:OrbSlam3Binary.missing",
    config="panobench.external:OrbSlamConfig",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [PYTHON, INERTIAL, BINARY]
