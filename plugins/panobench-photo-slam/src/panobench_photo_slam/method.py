"""Photo-SLAM through its program tum_mono: a TUM RGB-D folder in, TUM trajectories and a Gaussian map out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from panobench import Camera, Estimate, FrameSequence, MethodContext, UnsupportedError, option
from panobench.external import (
    ExternalConfig,
    Job,
    OrbSlamConfig,
    OrbSlamMethod,
    TrajectoryFormat,
    find_vocabulary,
    frame_rate,
    opencv_yaml,
    read_stored_map,
    write_images,
)

#: The mapper's settings: the numbers of the published monocular configuration for TUM RGB-D.
MAPPER: dict[str, Any] = {
    "Model.sh_degree": 3,
    "Model.resolution": -1.0,
    "Model.white_background": 0,
    "Model.eval": 0,
    "Camera.z_near": 0.01,
    "Camera.z_far": 100.0,
    "Monocular.inactive_geo_densify_max_pixel_dist": 1.0,
    "Stereo.min_disparity": 8,
    "Stereo.num_disparity": 128,
    "RGBD.min_depth": 1e-10,
    "RGBD.max_depth": 40.0,
    "Mapper.inactive_geo_densify": 1,
    "Mapper.depth_cache": 10,
    "Mapper.min_num_initial_map_kfs": 20,
    "Mapper.new_keyframe_times_of_use": 2,
    "Mapper.local_BA_increased_times_of_use": 0,
    "Mapper.loop_closure_increased_times_of_use_": 2,
    "Mapper.cull_keyframes": 0,
    "Mapper.large_rotation_threshold": 30.0,
    "Mapper.large_translation_threshold": 1.0,
    "Mapper.stable_num_iter_existence": 1,
    "GausPyramid.do": 1,
    "GausPyramid.num_sub_levels": 2,
    "GausPyramid.sub_level_times_of_use": 8,
    "Pipeline.convert_SHs": 0,
    "Pipeline.compute_cov3D": 0,
    "Record.keyframe_record_interval": 0,
    "Record.all_keyframes_record_interval": 0,
    "Record.record_rendered_image": 0,
    "Record.record_ground_truth_image": 0,
    "Record.record_loss_image": 0,
    "Record.training_report_interval": 0,
    "Record.record_loop_ply": 0,
    "Optimization.max_num_iterations": 30100,
    "Optimization.position_lr_init": 0.00032,
    "Optimization.position_lr_final": 0.00032,
    "Optimization.position_lr_delay_mult": 0.01,
    "Optimization.position_lr_max_steps": 24,
    "Optimization.feature_lr": 0.0025,
    "Optimization.opacity_lr": 0.05,
    "Optimization.scaling_lr": 0.005,
    "Optimization.rotation_lr": 0.001,
    "Optimization.percent_dense": 0.01,
    "Optimization.lambda_dssim": 0.2,
    "Optimization.densification_interval": 100,
    "Optimization.opacity_reset_interval": 0,
    "Optimization.prune_big_point_after_iter": 30000,
    "Optimization.densify_min_opacity": 0.1,
    "Optimization.densify_from_iter": 800,
    "Optimization.densify_until_iter": 30000,
    "Optimization.densify_grad_threshold": 0.001,
    "GaussianViewer.glfw_window_width": 1400,
    "GaussianViewer.glfw_window_height": 1050,
    "GaussianViewer.image_scale": 0.5,
    "GaussianViewer.image_scale_main": 1.0,
    "GaussianViewer.camera_watch_dist": 1e-6,
}


@dataclass(frozen=True)
class PhotoSlamConfig(OrbSlamConfig):
    """Mapper."""

    iterations: int = option(30100, "mapping steps, at most", above=0)


class PhotoSlam(OrbSlamMethod):
    """``tum_mono VOCABULARY ORB_SETTINGS MAPPER_SETTINGS SEQUENCE OUTPUT no_viewer``. It needs a CUDA GPU.

    Its map is stored, and not rendered for scoring: the program's world moves after a loop closure.
    """

    title: ClassVar[str] = "Photo-SLAM"
    program: ClassVar[str] = "tum_mono"
    variable: ClassVar[str] = "PANOBENCH_PHOTO_SLAM"
    config_class: ClassVar[type[ExternalConfig]] = PhotoSlamConfig
    config: PhotoSlamConfig

    def camera_settings(self, camera: Camera) -> dict[str, Any]:
        if camera.kind != "pinhole":
            raise UnsupportedError(f"Photo-SLAM takes pinhole images, not {camera.kind}; give --camera pinhole")
        # written even if they are zero, as in the program's own settings files
        return {f"Camera1.{key}": 0.0 for key in ("k1", "k2", "p1", "p2")} | super().camera_settings(camera)

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        orb = self.settings(sequence.camera, frame_rate(sequence.times))
        (work / "orb.yaml").write_text(opencv_yaml(orb))
        mapper = MAPPER | {"Optimization.max_num_iterations": self.config.iterations}
        (work / "mapper.yaml").write_text(opencv_yaml(mapper))
        vocabulary = find_vocabulary(self.config.vocabulary, sequence)
        names = write_images(sequence, work / "sequence" / "rgb").names
        lines = ["# color images", "# written by panobench", "# timestamp filename"]
        lines += [f"{t:.9f} rgb/{name}" for t, name in zip(sequence.times, names)]
        (work / "sequence" / "rgb.txt").write_text("\n".join(lines) + "\n")
        output = work / "output"
        output.mkdir()
        arguments = [vocabulary, work / "orb.yaml", work / "mapper.yaml", work / "sequence", output, "no_viewer"]
        return Job(
            [str(a) for a in arguments],
            output / "CameraTrajectory_TUM.txt",
            TrajectoryFormat("tum"),
            reads=(vocabulary,),
            keyframes=output / "KeyFrameTrajectory_TUM.txt",
        )

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """As the base class, with the last map that the program stored."""
        estimate = super().run(sequence, context)
        stored = sorted((context.work / "output").rglob("point_cloud.ply"), key=lambda p: p.stat().st_mtime)
        if stored:
            estimate.map = read_stored_map(stored[-1])
        return estimate
