"""LF-VISLAM: VINS-Mono's family with Scaramuzza's camera model. A ROS 1 bag and a launch file in, text out.

The camera looks along its optical axis; features are searched in an annulus. The odometry file holds TUM rows; its name
is set in the source and differs between checkouts, so any of those seen in public ones is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from panobench import Camera, FrameSequence, MethodContext, UnsupportedError
from panobench.external import ExternalConfig, ExternalMethod, Job, TrajectoryFormat, opencv_yaml, write_bag

IMAGE_TOPIC, IMU_TOPIC = "/mindvision/mindvision/left/image_mono", "/mavros/imu/data"
INVERSE_TERMS = 20


@dataclass(frozen=True)
class LfVislamConfig(ExternalConfig):
    """result: the file the checkout's parameters.cpp writes, below its output folder. The noise densities are those
    published for PALVIO; set yours. extrinsic: 0 trust the camera's place in the body, 1 refine it.
    """

    result: str = "vins_result_no_loop.csv"
    result_format: str = "tum"
    acc_n: float = 0.02
    gyr_n: float = 0.02
    acc_w: float = 0.04
    gyr_w: float = 0.002
    extrinsic: int = 1
    max_cnt: int = 200
    min_dist: int = 20
    rate: float = 1.0


def camera_section(camera: Camera) -> dict[str, Any]:
    """OCamCalib's numbers under LF-VISLAM's names; first pixel's centre at 0. Raises UnsupportedError."""
    if camera.kind != "pal":
        raise UnsupportedError(f"LF-VISLAM takes panoramic annular images, not {camera.kind}; give --camera pal")
    v = camera.to_dict()
    if len(v["poly"]) != 5 or not 0 < len(v["inv_poly"]) <= INVERSE_TERMS:
        raise UnsupportedError(
            f"LF-VISLAM takes 5 direct and 1 to {INVERSE_TERMS} inverse coefficients, this camera has "
            f"{len(v['poly'])} and {len(v['inv_poly'])}"
        )
    inverse = [*v["inv_poly"], *([0.0] * (INVERSE_TERMS - len(v["inv_poly"])))]
    cx, cy = float(v["cx"]) - 0.5, float(v["cy"]) - 0.5
    outer = v.get("r_max") or max(cx, cy, camera.width - cx, camera.height - cy)
    return {
        "model_type": "scaramuzza",
        "camera_name": "pal",
        "image_width": camera.width,
        "image_height": camera.height,
        "poly_parameters": {f"p{i}": float(x) for i, x in enumerate(v["poly"])},
        "inv_poly_parameters": {f"p{i}": float(x) for i, x in enumerate(inverse)},
        "affine_parameters": {"ac": float(v["c"]), "ad": float(v["d"]), "ae": float(v["e"]), "cx": cx, "cy": cy},
        "center_x": cx,
        "center_y": cy,
        "max_r": round(outer),
        "min_r": round(v.get("r_min", 0.0)),
    }


def estimator_section(config: LfVislamConfig, T_body_cam: np.ndarray, output: str) -> dict[str, Any]:
    """Everything but the camera."""
    return {
        "imu_topic": IMU_TOPIC,
        "image_topic": IMAGE_TOPIC,
        "output_path": output,
        "estimate_extrinsic": config.extrinsic,
        "extrinsicRotation": T_body_cam[:3, :3],
        "extrinsicTranslation": T_body_cam[:3, 3:4],
        "max_cnt": config.max_cnt,
        "min_dist": config.min_dist,
        "freq": 0,
        "F_threshold": 1.0,
        "show_track": 0,
        "equalize": 1,
        "fisheye": 0,
        "max_solver_time": 0.04,
        "max_num_iterations": 8,
        "keyframe_parallax": 10.0,
        "acc_n": config.acc_n,
        "gyr_n": config.gyr_n,
        "acc_w": config.acc_w,
        "gyr_w": config.gyr_w,
        "g_norm": 9.81,
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


def launch_file(config: Path, bag: Path, rate: float) -> str:
    """Tracker, estimator and the recording, whose end ends roslaunch; paths must need no XML escapes."""
    if any(c in f"{config}{bag}" for c in "<>&\"'$"):
        raise UnsupportedError(f"roslaunch cannot take the path {config}")
    lines = ["<launch>"]
    for node in ("feature_tracker", "vins_estimator"):
        lines.append(f'  <node name="{node}" pkg="{node}" type="{node}" output="screen">')
        lines.append(f'    <param name="config_file" type="string" value="{config}"/>')
        lines.append(f'    <param name="vins_folder" type="string" value="{config.parent}"/>')
        lines.append("  </node>")
    play = f"--delay=3 --rate={rate:g} {bag}"
    lines.append(f'  <node name="player" pkg="rosbag" type="play" args="{play}" required="true" output="screen"/>')
    return "\n".join([*lines, "</launch>", ""])


class LfVislam(ExternalMethod):
    """Panoramic annular images with IMU: the scale is metres."""

    title: ClassVar[str] = "LF-VISLAM"
    program: ClassVar[str] = "roslaunch"
    variable: ClassVar[str] = "PANOBENCH_LF_VISLAM"
    config_class: ClassVar[type[ExternalConfig]] = LfVislamConfig
    metric: ClassVar[bool] = True
    config: LfVislamConfig

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        if context.imu is None:
            raise UnsupportedError("LF-VISLAM needs inertial samples; this sequence has none")
        if self.config.result_format not in ("tum", "euroc"):
            raise UnsupportedError(f"result_format '{self.config.result_format}': tum or euroc")
        T_body_cam = np.eye(4) if context.imu.T_body_cam is None else context.imu.T_body_cam
        camera = camera_section(sequence.camera)
        output = work / "output"
        (output / "pose_graph").mkdir(parents=True)
        offset = write_bag(work / "recording.bag", sequence, context.imu, IMAGE_TOPIC, IMU_TOPIC)
        values = camera | estimator_section(self.config, T_body_cam, str(output))
        (work / "lf.yaml").write_text(opencv_yaml(values))
        (work / "lf.launch").write_text(launch_file(work / "lf.yaml", work / "recording.bag", self.config.rate))
        kind: Any = self.config.result_format
        return Job(
            [str(work / "lf.launch")],
            output / Path(self.config.result).name,
            TrajectoryFormat(kind, time_offset=offset, T_body_camera=T_body_cam),
            environment={"ROS_HOME": str(work / "ros"), "ROS_LOG_DIR": str(work / "ros" / "log")},
        )


def missing() -> str | None:
    """For the probe."""
    return LfVislam.missing()
