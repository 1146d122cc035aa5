"""Frames are brought to the map's exposure when theirs plainly differs, and are left alone otherwise."""

import numpy as np
import pytest

from panobench.bench.records.record import read_record
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.cameras.erp import ErpCamera
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.geometry import invert_pose
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import ExposureOptions
from panobench.methods.panogs.first_map.exposure_chain import ExposureChain
from panobench.methods.panogs.first_map.start import FirstMap
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.panogs.tracking.exposure import ExposureMatcher
from panobench.photometric.overlap import ViewWidth
from panobench.splat.loss import pixel_weights
from panobench.types import DepthEstimate, Frame

CAMERA = ErpCamera(128, 64)


def picture(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = rng.uniform(60, 150, size=(8, 16, 3))
    return np.kron(coarse, np.ones((8, 8, 1))).astype(np.uint8)


def matcher(width: ViewWidth = ViewWidth.WIDE) -> ExposureMatcher:
    made = ExposureMatcher(pixel_weights(CAMERA), width, ExposureOptions())
    made.start(picture())
    return made


def chain(first: np.ndarray | None = None, visible: np.ndarray | None = None) -> ExposureChain:
    made = ExposureChain(CAMERA, ExposureOptions())
    made.start(picture() if first is None else first, visible)
    return made


@pytest.mark.parametrize("gain", [0.6, 0.8, 1.3, 1.6])
def test_a_gain_is_taken_back(gain: float) -> None:
    changed = np.clip(picture() * gain, 0, 255).astype(np.uint8)
    back = matcher().before(changed)
    np.testing.assert_allclose(back.astype(float), picture().astype(float), atol=3)


def test_small_gains_and_narrow_views_are_left_alone() -> None:
    slightly = (picture() * 1.02).astype(np.uint8)
    assert matcher().before(slightly) is slightly
    much = (picture() * 1.4).astype(np.uint8)
    assert matcher(ViewWidth.NARROW).before(much) is much


def test_neither_a_rotation_nor_an_occluder_is_a_change_of_exposure() -> None:
    rotated = np.roll(picture(), 5, axis=1)
    covered = picture()
    covered[:, 20:52] = 70
    assert matcher().before(rotated) is rotated
    assert matcher().before(covered) is covered


def test_black_frames_have_no_gain() -> None:
    black = np.zeros_like(picture())
    assert matcher().before(black) is black


def test_what_comes_into_view_before_there_is_a_map_is_no_change_of_exposure() -> None:
    scene, followed = picture(), chain()
    for column in range(0, 128, 4):  # in the end nothing is left of what the first frame showed, and all is darker
        scene = scene.copy()
        scene[:, column : column + 4] //= 2
        assert followed.follow(scene) is scene


def test_nor_is_a_turn_where_a_mask_hides_part_of_the_picture() -> None:
    """What the picture shows falls in steps and rises slowly, so that most of its pixels darken as it turns."""
    ramp = np.tile(np.linspace(60, 200, 64), 2)[None, :, None] + np.linspace(-30, 30, 64)[:, None, None]
    scene = np.repeat(np.clip(ramp, 0, 255), 3, axis=2).astype(np.uint8)
    visible = np.ones((64, 128), dtype=bool)
    visible[:, 40:90] = False
    followed = chain(scene, visible)
    for turned in range(3, 60, 3):
        image = np.roll(scene, turned, axis=1)
        assert followed.follow(image, visible) is image


def test_an_exposure_that_swings_before_there_is_a_map_is_followed() -> None:
    m = chain()
    for gain in [*np.linspace(1.0, 0.6, 12), *np.linspace(0.6, 1.3, 20)]:
        back = m.follow(np.clip(picture() * gain, 0, 255).astype(np.uint8))
        np.testing.assert_allclose(back.astype(float), picture().astype(float), atol=8)


def test_the_first_frame_after_that_of_the_map_is_compared_with_it() -> None:
    """Not with the very first frame, which may have shown something else."""
    sequence = RoomsDataset().open("tiny", width=128)
    assert sequence.groundtruth is not None
    depth = sequence.depth(8)
    assert depth is not None
    m = PanogsMethod()
    m.start(sequence.camera, MethodContext(seed=0))
    m.exposure.start(sequence.image(0) // 2)
    frames = [Frame(k, k / 15, sequence.image(k)) for k in (8, 9, 10)]
    m._begin(FirstMap(DepthEstimate(depth, 8), frames[0], frames))
    assert m.tracker.image is not None
    assert abs(float(m.tracker.image.mean()) - float(frames[2].image.mean())) < 3
    true = invert_pose(sequence.groundtruth.T_wc[8]) @ sequence.groundtruth.T_wc[9]
    assert np.linalg.norm(m.trajectory[9][:3, 3] - true[:3, 3]) < 0.01


def test_what_waits_for_factors_has_the_exposure_that_is_mapped() -> None:
    sequence = RoomsDataset().open("tiny", width=128)
    depth = sequence.depth(0)
    assert depth is not None
    m = PanogsMethod()
    m.start(sequence.camera, MethodContext(seed=0))
    frames = [Frame(k, k / 15, sequence.image(k)) for k in (0, 1)]
    m._begin(FirstMap(DepthEstimate(depth, 0), frames[0], frames[:1]))
    m.exposure.start(sequence.image(0) // 2)  # wrong: the frame is tracked twice as dark as it is
    m.exposure.before = lambda image: image // 2  # type: ignore[method-assign]
    m.track(frames[1])
    assert np.nanmean(m.tracker.pyramid[0]) == pytest.approx(frames[1].image.mean() / 255, rel=0.1)


@pytest.mark.slow
def test_panogs_follows_a_swinging_exposure(tmp_path) -> None:  # type: ignore[no-untyped-def]
    errors = {}
    for match in (True, False):
        request = RunRequest(
            method="panogs", dataset="disturbed", sequence="rooms/tiny:rolling=0.3", width=128, max_frames=40,
            settings={"exposure.match": match},
        )  # fmt: skip
        run = read_record(execute(request, tmp_path / str(match)))
        errors[match] = run.number("ate_rmse_m") if run.number("tracked") == 1.0 else np.inf
    assert errors[True] < 0.03
    assert errors[True] < 0.5 * errors[False]


@pytest.mark.parametrize("width", [40, 96, 160])
def test_frames_of_every_size_have_an_exposure(width: int) -> None:
    """Not all are halved as often as those of 64 times a power of two."""
    scene = np.kron(np.random.default_rng(0).uniform(60, 150, (width // 8, width // 4, 3)), np.ones((4, 4, 1)))
    followed = ExposureChain(ErpCamera(width, width // 2), ExposureOptions())
    followed.start(scene.astype(np.uint8))
    darker = followed.follow((scene * 0.6).astype(np.uint8))
    assert darker.mean() == pytest.approx(scene.mean(), rel=0.03)
