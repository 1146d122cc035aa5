"""VINS-Mono and its descendants: configuration, camera models, masks and IMU noise (Qin et al., T-RO 2018).

A ROS 1 bag and a launch file go in, the estimator's file of body poses comes out; the camera's poses follow from the
extrinsics. The configuration's keys are those of VINS-Mono's ``config`` folder.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.images import write_image
from panobench.errors import UnsupportedError
from panobench.external import ros
from panobench.external.adapter import PROGRAM_LOG, ExternalConfig, ExternalMethod, Job
from panobench.external.bag import write_bag
from panobench.external.findings import Finding
from panobench.external.imu_noise import sample_noise
from panobench.external.inputs import intrinsics, opencv_pinhole, opencv_yaml
from panobench.external.trajectory import TrajectoryFormat
from panobench.methods.base import MethodContext
from panobench.options import option
from panobench.types import Estimate, Imu

IMAGE_TOPIC, IMU_TOPIC = "/cam0/image_raw", "/imu0"
#: Where the trackers look for a mask, below the folder that the launch file names. OpenCV goes by a file's content, so
#: the mask is a PNG: JPEG would blur its edge.
MASK_FILE = "config/fisheye_mask.jpg"
INVERSE_TERMS = 20
GRAVITY = 9.81
#: The estimators answer at most 10 times a second; frames between two answers this close get an interpolated pose.
INTERPOLATE_GAP_S = 0.2
#: What the estimators print when an attempt to start fails.
FAILED_STARTS = (
    "Not enough features or parallax",
    "unstable features tracking",
    "vision only BA not converge",
    "misalign visual structure with IMU",
)


@dataclass(frozen=True)
class VinsConfig(ExternalConfig):
    """Estimator and feature tracker."""

    acc_n: float | None = option(
        None, "noise of one accelerometer sample; none: estimated from the samples", unit="m/s^2", above=0
    )
    gyr_n: float | None = option(
        None, "noise of one gyroscope sample; none: estimated from the samples", unit="rad/s", above=0
    )
    acc_w: float = option(0.00004, "random walk of the accelerometer's bias, per sample", unit="m/s^2")
    gyr_w: float = option(2.0e-6, "random walk of the gyroscope's bias, per sample", unit="rad/s")
    g_norm: float | None = option(None, "gravity; none: the data's, else 9.81", unit="m/s^2", above=0)
    extrinsic: int = option(0, "0 trusts the given pose of the camera on the body, 1 refines it", maximum=1)
    freq: int = option(10, "frames the tracker passes on to the estimator", unit="Hz", above=0)
    max_cnt: int = option(150, "features per image", above=0)
    min_dist: int = option(30, "distance between two features", unit="px", above=0)
    rate: float = option(1.0, "speed at which the recording is played, 1 as recorded", above=0)


def camodocal_camera(camera: Camera, program: str) -> dict[str, Any]:
    """camodocal's description of a pinhole, omni (Mei) or pal (Scaramuzza) camera; the first pixel's centre is at 0.

    Raises UnsupportedError for other cameras.
    """
    size = {"camera_name": "camera", "image_width": camera.width, "image_height": camera.height}
    v = camera.to_dict()
    if camera.kind == "pal":
        return {"model_type": "scaramuzza", **size, **_scaramuzza(v, program)}
    if camera.kind == "omni":
        k1, k2, p1, p2 = (float(x) for x in (*v.get("distortion", ()), 0.0, 0.0, 0.0, 0.0)[:4])
        centre = {"u0": float(v["cx"]) - 0.5, "v0": float(v["cy"]) - 0.5}
        return {
            "model_type": "MEI",
            **size,
            "mirror_parameters": {"xi": float(v["xi"])},
            "distortion_parameters": {"k1": k1, "k2": k2, "p1": p1, "p2": p2},
            "projection_parameters": {"gamma1": float(v["fx"]), "gamma2": float(v["fy"]), **centre},
        }
    p = opencv_pinhole(camera, program)
    if p.distortion[4]:
        raise UnsupportedError(f"{program}'s pinhole model has no k3")
    return {
        "model_type": "PINHOLE",
        **size,
        "distortion_parameters": dict(zip(("k1", "k2", "p1", "p2"), p.distortion)),
        "projection_parameters": intrinsics(p),
    }


def _scaramuzza(v: dict[str, Any], program: str) -> dict[str, Any]:
    if len(v["poly"]) != 5 or not 0 < len(v["inv_poly"]) <= INVERSE_TERMS:
        raise UnsupportedError(
            f"{program} takes 5 direct and 1 to {INVERSE_TERMS} inverse coefficients, this camera has "
            f"{len(v['poly'])} and {len(v['inv_poly'])}"
        )
    inverse = [*v["inv_poly"], *([0.0] * (INVERSE_TERMS - len(v["inv_poly"])))]
    affine = {"ac": float(v["c"]), "ad": float(v["d"]), "ae": float(v["e"])}
    return {
        "poly_parameters": {f"p{i}": float(x) for i, x in enumerate(v["poly"])},
        "inv_poly_parameters": {f"p{i}": float(x) for i, x in enumerate(inverse)},
        "affine_parameters": {**affine, "cx": float(v["cx"]) - 0.5, "cy": float(v["cy"]) - 0.5},
    }


def vins_settings(config: VinsConfig, imu: Imu, output: Path) -> dict[str, Any]:
    """Everything but the camera.

    VINS-Mono's noise parameters are standard deviations per sample, not densities. Its time offset is 0: ``imu`` is on
    the camera's clock.
    """
    T_body_cam = np.eye(4) if imu.T_body_cam is None else imu.T_body_cam
    return {
        "imu_topic": IMU_TOPIC,
        "image_topic": IMAGE_TOPIC,
        "output_path": str(output),
        "estimate_extrinsic": config.extrinsic,
        "extrinsicRotation": T_body_cam[:3, :3],
        "extrinsicTranslation": T_body_cam[:3, 3:4],
        "max_cnt": config.max_cnt,
        "min_dist": config.min_dist,
        "freq": config.freq,
        "F_threshold": 1.0,
        "show_track": 0,
        "equalize": 1,
        "fisheye": 0,
        "max_solver_time": 0.04,
        "max_num_iterations": 8,
        "keyframe_parallax": 10.0,
        "acc_n": config.acc_n or sample_noise(imu.accel, floor=1e-3),
        "gyr_n": config.gyr_n or sample_noise(imu.gyro, floor=1e-4),
        "acc_w": config.acc_w,
        "gyr_w": config.gyr_w,
        "g_norm": config.g_norm or imu.gravity or GRAVITY,
        "loop_closure": 0,
        "load_previous_pose_graph": 0,
        "fast_relocalization": 0,
        "pose_graph_save_path": f"{output}/pose_graph/",
        "estimate_td": 0,
        "td": 0.0,
        "rolling_shutter": 0,
        "rolling_shutter_tr": 0,
        "save_image": 0,
        "visualize_imu_forward": 0,
        "visualize_camera_size": 0.4,
    }


def write_tracker_mask(keep: NDArray[np.bool_], folder: Path) -> None:
    """Write the mask, 255 where features are allowed, where the trackers look for it below ``folder``."""
    path = folder / MASK_FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    write_image(path.with_suffix(".png"), keep)
    path.with_suffix(".png").replace(path)


class VinsMethod(ExternalMethod):
    """Base class: monocular with IMU, metric scale, run by roslaunch in a sourced workspace or a container."""

    program: ClassVar[str] = "roslaunch"
    metric: ClassVar[bool] = True
    config_class: ClassVar[type[ExternalConfig]] = VinsConfig
    config: VinsConfig

    @abstractmethod
    def settings(self, camera: Camera, imu: Imu, folder: Path, output: Path) -> dict[str, Any]:
        """The configuration file. Files it needs (a mask) are written to ``folder``. Raises UnsupportedError."""

    @abstractmethod
    def result(self) -> tuple[str, Literal["tum", "euroc"]]:
        """The name of the file with the result, below the output folder, and its format."""

    def packages(self) -> tuple[str, ...]:
        """The ROS packages that are run. Each has one node, of the same name."""
        return ("feature_tracker", "vins_estimator")

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        """As the base class; the program is not roslaunch but the nodes in the workspace."""
        reason = super().missing(config)
        if reason is None:
            reason = next((f"{f.detail}; {f.fix}" for f in cls(config)._node_findings() if not f.ok), None)
        return reason

    @classmethod
    def diagnose(cls) -> list[Finding]:
        found = super().diagnose()
        return [*found, *cls()._node_findings()] if all(f.ok for f in found) else found

    def files(self) -> list[Path]:
        """roslaunch and the nodes."""
        nodes = (ros.find_node(p, p) for p in self.packages()) if self._sees_nodes() else ()
        return [*super().files(), *(n for n in nodes if n is not None)]

    def _sees_nodes(self) -> bool:
        return self.place().kind in ("local", "venv")

    def _node_findings(self) -> list[Finding]:
        """Whether all nodes are there and one writes the result. Descendants keep the names of the packages."""
        if not self._sees_nodes():
            return []
        source = f"source devel/setup.bash of a workspace with {self.title}"
        nodes = {package: ros.find_node(package, package) for package in self.packages()}
        found = [
            Finding(node is not None, "node", str(node or f"no package '{p}' in CMAKE_PREFIX_PATH"), source)
            for p, node in nodes.items()
        ]
        name = self.result()[0]
        writes = any(name.encode() in node.read_bytes() for node in nodes.values() if node is not None)
        if all(f.ok for f in found):
            detail = f"'{name}'" if writes else f"the workspace's nodes do not write {self.title}'s '{name}'"
            found.append(Finding(writes, "result", detail, source))
        return found

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """As the base class. If the estimator never started, the run's log says what it printed at its attempts."""
        estimate = super().run(sequence, context)
        if not len(estimate.trajectory):
            text = (context.work / PROGRAM_LOG).read_text(errors="replace")
            counts = {words: text.count(words) for words in FAILED_STARTS}
            said = ", ".join(f"'{words}' ({n} times)" for words, n in counts.items() if n) or "its log does not say why"
            context.log(f"{self.title} never started: {said}")
        return estimate

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work, imu = context.work, context.imu
        if imu is None:
            raise UnsupportedError(f"{self.title} needs inertial samples; this sequence has none")
        output = work / "output"
        values = self.settings(sequence.camera, imu, work, output)
        (output / "pose_graph").mkdir(parents=True)
        used = ", ".join(f"{key} {values[key]:.4g}" for key in ("acc_n", "gyr_n", "g_norm", "freq"))
        context.log(f"{self.title}: {used}")
        offset = write_bag(work / "recording.bag", sequence, imu, IMAGE_TOPIC, IMU_TOPIC)
        (work / "vins.yaml").write_text(opencv_yaml(values))
        script = ros.write_player_script(work)
        # the trackers join this folder and a file's name without a slash between them
        parameters: dict[str, str | int | float] = {"config_file": str(work / "vins.yaml"), "vins_folder": f"{work}/"}
        nodes = [ros.Node(p, p, parameters | self.node_parameters(p)) for p in self.packages()]
        launch = ros.launch_file(nodes, work / "recording.bag", self.config.rate, script, output)
        (work / "vins.launch").write_text(launch)
        port = ros.free_port()
        name, kind = self.result()
        return Job(
            ["-p", str(port), str(work / "vins.launch")],
            output / name,
            TrajectoryFormat(kind, time_offset=offset, T_body_camera=imu.T_body_cam),
            environment=ros.ros_environment(work, port, inherit=self._sees_nodes()),
            interpolate_gap_s=INTERPOLATE_GAP_S,
        )

    def node_parameters(self, package: str) -> dict[str, str | int | float]:
        """Further parameters of a package's node, by default none."""
        return {}
