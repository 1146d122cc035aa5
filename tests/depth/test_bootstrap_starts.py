"""Starts that are hard: fast turns, no motion at first, long steps, narrow views, and none of it possible."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import parse_camera_option
from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.base import FrameSequence
from panobench.datasets.synthetic.disturb import roll_columns
from panobench.datasets.synthetic.disturbed import DisturbedDataset
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.datasets.writing.converted import ConvertedSequence
from panobench.depth.bootstrap import BootstrapDepth, BootstrapOptions
from panobench.depth.bootstrap_solve import spread_over_path
from panobench.photometric.overlap import ViewShare
from panobench.photometric.pyramid import luma_of_frame, pyramid
from panobench.photometric.rotation_only import RotationOnlyAligner
from panobench.types import DepthEstimate, Frame


def turned(image: NDArray[np.uint8], degrees: float) -> NDArray[np.uint8]:
    """A panorama after the camera turned to the right."""
    columns = degrees / 360 * image.shape[1]
    return np.clip(np.round(roll_columns(image.astype(float), columns)), 0, 255).astype(np.uint8)


def answer(sequence: FrameSequence, images: list[NDArray[np.uint8]]) -> DepthEstimate:
    estimator = BootstrapDepth()
    estimator.start(sequence.camera)
    for k, image in enumerate(images):
        estimate = estimator.add(Frame(k, k / 15, image))
        if estimate is not None:
            return estimate
    estimate = estimator.finish()
    assert estimate is not None
    return estimate


def median_error(depth: NDArray[np.float32], truth: NDArray[np.float32] | None) -> float:
    """Relative, after the median ratio is taken out."""
    assert truth is not None
    ratio = depth / truth
    ratio /= np.nanmedian(ratio)
    return float(np.nanmedian(np.abs(ratio - 1)))


def tiny() -> FrameSequence:
    return RoomsDataset().open("tiny", width=256)


@pytest.mark.slow
def test_six_degrees_of_yaw_a_frame() -> None:
    sequence = DisturbedDataset().open("rooms/tiny:yaw=6", width=256)
    estimate = answer(sequence, [sequence.image(k) for k in range(20)])
    assert estimate.ok
    assert median_error(estimate.depth, sequence.depth(0)) < 0.03


@pytest.mark.slow
def test_twenty_degrees_of_yaw_from_the_second_frame_on() -> None:
    """Constant velocity knows nothing of it, and alignment alone does not reach that far."""
    sequence = tiny()
    images = [turned(sequence.image(k), 20 * max(k - 1, 0)) for k in range(20)]
    estimate = answer(sequence, images)
    assert estimate.ok
    assert median_error(estimate.depth, sequence.depth(0)) < 0.03


@pytest.mark.slow
def test_long_steps() -> None:
    sequence = tiny()
    truth = sequence.groundtruth
    assert truth is not None
    assert np.linalg.norm(truth.positions[3] - truth.positions[0]) > 0.1
    estimate = answer(sequence, [sequence.image(k) for k in range(0, 40, 3)])
    assert estimate.ok
    assert median_error(estimate.depth, sequence.depth(0)) < 0.03


@pytest.mark.slow
def test_a_pure_rotation_is_waited_out_and_said() -> None:
    sequence = tiny()
    images = [turned(sequence.image(0), 3 * k) for k in range(12)]
    images += [turned(sequence.image(k), 36) for k in range(1, 25)]
    estimate = answer(sequence, images)
    assert estimate.ok
    assert "of them without parallax" in estimate.message
    assert median_error(estimate.depth, sequence.depth(0)) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(("option", "width", "fov"), [("pinhole:front", 288, None), ("erp", 512, "120x120")])
def test_a_narrow_view_finds_depth_and_poses(option: str, width: int, fov: str | None) -> None:
    source = RoomsDataset().open("tiny")
    choice = parse_camera_option(option, source.camera, width, fov)
    sequence = ConvertedSequence(source, choice.camera, choice.R_target_source)
    estimate = answer(sequence, [sequence.image(k) for k in range(30)])
    assert estimate.ok
    assert "feature tracks" in estimate.message
    assert median_error(estimate.depth, sequence.depth(estimate.frame_index)) < 0.05
    truth = sequence.groundtruth
    assert truth is not None
    index = sorted(estimate.T_wc)
    T = np.linalg.inv(truth.T_wc[estimate.frame_index]) @ truth.T_wc[index]
    found = np.stack([estimate.T_wc[k][:3, 3] for k in index])
    scale = (found * T[:, :3, 3]).sum() / (found * found).sum()
    assert np.sqrt(((scale * found - T[:, :3, 3]) ** 2).sum(axis=1).mean()) < 0.02


def test_a_camera_that_only_turns_gets_a_constant_and_is_told_why() -> None:
    image = RoomsDataset().open("tiny", width=128).image(0)
    estimator = BootstrapDepth(options=BootstrapOptions(max_frames_still=8))
    estimator.start(ErpCamera(128, 64))
    estimates = [estimator.add(Frame(k, k / 15, turned(image, 5 * k))) for k in range(8)]
    assert estimates[:7] == [None] * 7
    assert estimates[7] is not None
    assert not estimates[7].ok
    assert "no parallax" in estimates[7].message
    assert np.ptp(estimates[7].depth) == 0


def test_images_that_have_nothing_in_common_are_not_believed() -> None:
    """It begins at a later frame as often as it may, and says in the end that nothing passed the check."""
    rng = np.random.default_rng(0)
    estimator = BootstrapDepth(options=BootstrapOptions(max_frames=8, max_frames_still=8, restarts=1))
    estimator.start(ErpCamera(128, 64))
    estimate, k = None, 0
    while estimate is None and k < 20:
        image = np.repeat(np.repeat(rng.integers(0, 255, (16, 32, 3), dtype=np.uint8), 4, axis=0), 4, axis=1)
        estimate = estimator.add(Frame(k, k / 15, image))
        k += 1
    assert estimator.restarts == 1
    assert estimate is not None
    assert not estimate.ok
    assert "attempts failed" in estimate.message


@pytest.mark.parametrize("degrees", [-25.0, 4.0, 18.0])
def test_turn_finder_measures_a_turn(degrees: float) -> None:
    camera = ErpCamera(256, 128)
    image = RoomsDataset().open("tiny", width=256).image(0)
    a, b = (pyramid(luma_of_frame(i, camera.valid_mask())) for i in (image, turned(image, degrees)))
    T = RotationOnlyAligner(camera, len(a)).rotation(a, b)
    assert T is not None
    forward = T[:3, :3] @ [0, 0, 1]
    assert np.rad2deg(np.arctan2(-forward[0], forward[2])) == pytest.approx(degrees, abs=0.3)
    assert np.allclose(T[:3, 3], 0)


def test_view_share_falls_as_a_narrow_view_turns_away() -> None:
    share = ViewShare(PinholeCamera.from_fov(128, 90, 60))
    assert share.of(np.eye(4), 2.0) == 1.0
    T = np.eye(4)
    seen = []
    for angle in np.deg2rad([20.0, 45.0, 100.0]):
        T[0, 0], T[0, 2], T[2, 0], T[2, 2] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
        seen.append(share.of(T, 2.0))
    assert 0.65 < seen[0] < 0.9
    assert 0.3 < seen[1] < 0.6
    assert seen[2] == 0.0
    assert ViewShare(ErpCamera(64, 32)).of(T, 2.0) == 1.0


def test_frames_are_spread_over_the_path_not_over_time() -> None:
    poses = [np.eye(4) for _ in range(40)]
    for k in range(30, 40):
        poses[k][0, 3] = 0.1 * (k - 29)
    used = spread_over_path(poses, 5)
    assert list(used) == [31, 33, 35, 37, 39]
