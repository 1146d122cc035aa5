"""PanoGS in narrow views: what enters them, and starts that come late."""

from __future__ import annotations

import numpy as np
import pytest
from panogs_options import configured

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import parse_camera_option
from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.datasets.writing.converted import ConvertedSequence
from panobench.depth.base import DepthEstimator
from panobench.depth.bootstrap import BootstrapDepth
from panobench.depth.simple import OracleDepth
from panobench.geometry import umeyama
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.fixed_lag.frame_buffer import BufferedFrame
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.splatting.views import View
from panobench.testing.sequences import TinySequence, rotating_pose, smooth_pose
from panobench.types import DepthEstimate, Frame


@pytest.mark.slow
def test_tracks_a_pinhole_view_of_a_room() -> None:
    source = RoomsDataset().open("tiny")
    choice = parse_camera_option("pinhole:front", source.camera, 288)
    sequence = ConvertedSequence(source, choice.camera, choice.R_target_source)
    method = PanogsMethod(PanogsConfig())
    method.start(sequence.camera, MethodContext(make_depth=BootstrapDepth))
    for frame in sequence.frames():
        method.track(frame)
    estimate = method.finish()
    assert len(estimate.trajectory) == len(sequence)
    truth = sequence.groundtruth
    assert truth is not None
    fit = umeyama(estimate.trajectory.positions, truth.positions)
    error = np.linalg.norm(fit.apply_points(estimate.trajectory.positions) - truth.positions, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.025


@pytest.mark.slow
def test_a_panorama_of_a_limited_field_of_view_is_not_lost_as_the_map_grows_beyond_it() -> None:
    """The map outgrows the view; what lies outside of it says nothing about the frame."""
    camera = ErpCamera(128, 64, hfov_deg=120.0)
    sequence = TinySequence(camera, 40, pose=lambda t: smooth_pose(0.5 * t) @ rotating_pose(t))
    method = PanogsMethod(configured(mapping__iterations=4, mapping__final_iterations=0))
    method.start(camera, MethodContext(make_depth=OracleDepth))
    for i in range(len(sequence)):
        frame = Frame(i, float(sequence.times[i]), sequence.image(i), depth=sequence.depth(i))
        assert method.track(frame) is not None
    assert method.tracker.reference is not None
    render = method.mapper.renderer.forward(method.mapper.map.gaussians, method.trajectory[39])
    level = method.tracker.make_reference(render, 3).levels[0]
    x, z = level.points[0], level.points[2]
    assert np.abs(np.rad2deg(np.arctan2(x, z))).max() < 60


def _lag_rotating(camera: Camera, degrees: float) -> int:
    """The lag of a camera that rotates by so much a frame."""
    method = PanogsMethod()
    method.start(camera, MethodContext())
    empty = np.zeros((0, 0), np.float32)
    for k in range(13):
        a = np.deg2rad(degrees * k)
        T = np.eye(4)
        T[0, 0], T[0, 2], T[2, 0], T[2, 2] = np.cos(a), np.sin(a), -np.sin(a), np.cos(a)
        view = View(k, np.zeros((1, 1, 3), np.uint8), T)
        method.trajectory.add_keyframe(view, k / 15)
        method.lag.buffer._frames.append(BufferedFrame(k, view.image, empty, empty))
    return method.lag._lag(2.0)


def test_a_narrow_view_that_rotates_has_a_shorter_lag() -> None:
    pinhole, config = PinholeCamera.from_fov(96, 120, 60), PanogsConfig().fixed_lag
    assert _lag_rotating(pinhole, 0.0) == config.lag
    assert config.lag_min < _lag_rotating(pinhole, 4.0) < config.lag
    assert _lag_rotating(pinhole, 15.0) == config.lag_min
    assert _lag_rotating(ErpCamera(96, 48), 15.0) == config.lag


class LateDepth(DepthEstimator):
    """Knows the depth of its third frame only, and where the first two were."""

    def start(self, camera: Camera, seed: int = 0) -> None:
        self.shape, self.seen = (camera.height, camera.width), 0

    def add(self, frame: Frame) -> DepthEstimate | None:
        self.seen += 1
        if self.seen < 4:
            return None
        poses = {k: np.eye(4) for k in range(4)}
        poses[0][0, 3], poses[1][0, 3], poses[3][0, 3] = -0.02, -0.01, 0.01
        return DepthEstimate(np.full(self.shape, 2.0, np.float32), 2, T_wc=poses)


def test_frames_that_the_map_does_not_show_keep_the_estimators_poses() -> None:
    method = PanogsMethod(configured(mapping__iterations=2, start__iterations=2))
    method.start(ErpCamera(64, 32), MethodContext(make_depth=LateDepth))
    rng = np.random.default_rng(0)
    shown = np.kron(rng.integers(0, 255, (4, 8, 3), dtype=np.uint8), np.ones((8, 8, 1), np.uint8))
    for k in range(4):
        method.track(Frame(k, k / 15, shown if k > 1 else rng.integers(0, 255, shown.shape, dtype=np.uint8)))
    estimate = method.finish()
    assert len(estimate.trajectory) == 4
    assert estimate.trajectory.positions[:3, 0] == pytest.approx([-0.02, -0.01, 0.0])


class DepthOfTheMiddle(DepthEstimator):
    """Knows the depth of frame 10 once it has seen frame 12, and no poses."""

    def start(self, camera: Camera, seed: int = 0) -> None:
        self.frames: list[int] = []

    def add(self, frame: Frame) -> DepthEstimate | None:
        self.frames.append(frame.index)
        depth = RoomsDataset().open("tiny", width=128).depth(10)
        assert depth is not None
        return DepthEstimate(depth, 10) if len(self.frames) == 13 else None


def test_frames_before_the_first_with_depth_are_tracked_backwards() -> None:
    sequence = RoomsDataset().open("tiny", width=128)
    method = PanogsMethod(configured(mapping__iterations=4))
    method.start(sequence.camera, MethodContext(make_depth=DepthOfTheMiddle))
    for k in range(16):
        method.track(Frame(k, k / 15, sequence.image(k)))
    estimate = method.finish()
    assert len(estimate.trajectory) == 16
    assert sequence.groundtruth is not None
    truth = sequence.groundtruth.T_wc[:16, :3, 3]
    s = umeyama(estimate.trajectory.positions, truth)
    assert np.linalg.norm(s.apply_points(estimate.trajectory.positions) - truth, axis=1).max() < 0.015
    assert s.scale == pytest.approx(1, abs=0.05)
