"""VINS-Mono: a ROS 1 bag and a launch file in, the estimator's CSV out.

One command does all: roslaunch starts the master, VINS-Mono's three nodes and ``rosbag play``, which is a required
node, so that roslaunch ends when the recording does. Poses are the body's; the camera's follow by the extrinsics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from panobench import Camera, FrameSequence, MethodContext, UnsupportedError
from panobench.external import (
    ExternalConfig,
    ExternalMethod,
    Job,
    TrajectoryFormat,
    opencv_pinhole,
    opencv_yaml,
    write_bag,
)

IMAGE_TOPIC, IMU_TOPIC = "/cam0/image_raw", "/imu0"


@dataclass(frozen=True)
class VinsMonoConfig(ExternalConfig):
    """The noise densities and settings of VINS-Mono's EuRoC configuration; set yours for your IMU.

    loop: take the pose graph's result (keyframes only) instead of the odometry's. extrinsic: 0 trust the given place
    of the camera, 1 refine it.
    """

    acc_n: float = 0.08
    gyr_n: float = 0.004
    acc_w: float = 0.00004
    gyr_w: float = 2.0e-6
    extrinsic: int = 0
    loop: bool = False
    max_cnt: int = 150
    min_dist: int = 30
    rate: float = 1.0


def camera_section(camera: Camera) -> dict[str, Any]:
    """camodocal's camera description. Raises UnsupportedError for a model VINS-Mono does not have."""
    size = {"camera_name": "camera", "image_width": camera.width, "image_height": camera.height}
    if camera.kind == "omni":
        v = camera.to_dict()
        k1, k2, p1, p2 = (float(x) for x in (*v.get("distortion", ()), 0.0, 0.0, 0.0, 0.0)[:4])
        return {
            "model_type": "MEI",
            **size,
            "mirror_parameters": {"xi": float(v["xi"])},
            "distortion_parameters": {"k1": k1, "k2": k2, "p1": p1, "p2": p2},
            "projection_parameters": {
                "gamma1": float(v["fx"]),
                "gamma2": float(v["fy"]),
                "u0": float(v["cx"]) - 0.5,
                "v0": float(v["cy"]) - 0.5,
            },
        }
    p = opencv_pinhole(camera, "VINS-Mono")
    if p.distortion[4]:
        raise UnsupportedError("VINS-Mono's pinhole model has no k3")
    return {
        "model_type": "PINHOLE",
        **size,
        "distortion_parameters": dict(zip(("k1", "k2", "p1", "p2"), p.distortion)),
        "projection_parameters": {"fx": float(p.fx), "fy": float(p.fy), "cx": float(p.cx), "cy": float(p.cy)},
    }


def estimator_section(config: VinsMonoConfig, T_body_cam: np.ndarray, output: str) -> dict[str, Any]:
    """Everything but the camera, in VINS-Mono's names."""
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
        "loop_closure": int(config.loop),
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


def launch_file(config: str, bag: str, rate: float, loop: bool) -> str:
    """A roslaunch file with the nodes and the recording; paths must need no XML escapes."""
    for path in (config, bag):
        if any(c in path for c in "<>&\"'$"):
            raise UnsupportedError(f"roslaunch cannot take the path {path}")
    folder = config.rsplit("/", 1)[0]
    nodes = ["feature_tracker", "vins_estimator"] + (["pose_graph"] if loop else [])
    lines = ["<launch>"]
    for node in nodes:
        lines.append(f'  <node name="{node}" pkg="{node}" type="{node}" output="screen">')
        lines.append(f'    <param name="config_file" type="string" value="{config}"/>')
        lines.append(f'    <param name="vins_folder" type="string" value="{folder}"/>')
        if node == "pose_graph":
            for name, kind in (("visualization_shift_x", "int"), ("visualization_shift_y", "int"), ("skip_cnt", "int")):
                lines.append(f'    <param name="{name}" type="{kind}" value="0"/>')
            lines.append('    <param name="skip_dis" type="double" value="0"/>')
        lines.append("  </node>")
    play = f"--delay=3 --rate={rate:g} {bag}"
    lines.append(f'  <node name="player" pkg="rosbag" type="play" args="{play}" required="true" output="screen"/>')
    return "\n".join([*lines, "</launch>", ""])


class VinsMono(ExternalMethod):
    """Monocular with IMU: the scale is metres."""

    title: ClassVar[str] = "VINS-Mono"
    program: ClassVar[str] = "roslaunch"
    variable: ClassVar[str] = "PANOBENCH_VINS_MONO"
    config_class: ClassVar[type[ExternalConfig]] = VinsMonoConfig
    metric: ClassVar[bool] = True
    config: VinsMonoConfig

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        if context.imu is None:
            raise UnsupportedError("VINS-Mono needs inertial samples; this sequence has none")
        T_body_cam = np.eye(4) if context.imu.T_body_cam is None else context.imu.T_body_cam
        output = work / "output"
        (output / "pose_graph").mkdir(parents=True)
        offset = write_bag(work / "recording.bag", sequence, context.imu, IMAGE_TOPIC, IMU_TOPIC)
        values = camera_section(sequence.camera) | estimator_section(self.config, T_body_cam, str(output))
        (work / "vins.yaml").write_text(opencv_yaml(values))
        launch = launch_file(str(work / "vins.yaml"), str(work / "recording.bag"), self.config.rate, self.config.loop)
        (work / "vins.launch").write_text(launch)
        return Job(
            [str(work / "vins.launch")],
            output / ("vins_result_loop.csv" if self.config.loop else "vins_result_no_loop.csv"),
            TrajectoryFormat("euroc", time_offset=offset, T_body_camera=T_body_cam),
            environment={"ROS_HOME": str(work / "ros"), "ROS_LOG_DIR": str(work / "ros" / "log")},
        )


def missing() -> str | None:
    """For the probe."""
    return VinsMono.missing()
