"""Where panogs puts its Gaussians: seeds follow the image's detail, discs too coarse for what is seen are split."""

import numpy as np
import pytest
from panogs_options import configured

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.geometry import invert_pose, make_pose, matrix_from_quaternion
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapping.map_optimiser import LEFT_OUT
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.mapping.seed_pattern import EVEN, LEVELS, SeedPattern
from panobench.methods.panogs.mapping.split import SplitRule, halves, too_coarse
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer

CAMERA = ErpCamera(128, 64)


def half_striped() -> np.ndarray:
    """Fine stripes on the right half, one grey on the left."""
    image = np.full((64, 128, 3), 128, np.uint8)
    image[:, 64::4] = 20
    image[:, 65::4] = 20
    return image


def test_levels_keep_the_number_of_seeds() -> None:
    assert sum(level.share for level in LEVELS) == pytest.approx(1)
    assert sum(level.share * level.density for level in LEVELS) == pytest.approx(1, abs=0.01)


def test_detail_gets_more_seeds_than_a_plain_wall() -> None:
    pattern = SeedPattern(CAMERA, 1000)
    pixels, spacing = pattern.seeds(half_striped(), None, np.random.default_rng(0))
    right = pixels[:, 0] > 64
    assert 700 < len(pixels) < 1300
    assert np.count_nonzero(right) > 2 * np.count_nonzero(~right)
    assert spacing[right].mean() < 0.75 * spacing[~right].mean()


def test_a_plain_image_gets_few_and_an_even_pattern_ignores_detail() -> None:
    plain = np.full((64, 128, 3), 90, np.uint8)
    assert len(SeedPattern(CAMERA, 1000).seeds(plain, None, np.random.default_rng(0))[0]) < 500
    pixels, _ = SeedPattern(CAMERA, 1000, EVEN).seeds(half_striped(), None, np.random.default_rng(0))
    right = np.count_nonzero(pixels[:, 0] > 64)
    assert right == pytest.approx(len(pixels) / 2, rel=0.1)


def test_seeds_stay_where_they_are_wanted() -> None:
    wanted = np.zeros((64, 128), bool)
    wanted[20:30, 100:120] = True
    pixels, spacing = SeedPattern(CAMERA, 2000).seeds(half_striped(), wanted, np.random.default_rng(0))
    assert len(pixels) == len(spacing) > 5
    x, y = pixels.astype(int).T
    assert wanted[y, x].all()
    none, _ = SeedPattern(CAMERA, 2000).seeds(half_striped(), np.zeros_like(wanted), np.random.default_rng(0))
    assert len(none) == 0


def test_pinholes_have_seeds_too() -> None:
    camera = PinholeCamera(96, 64, fx=40.0, fy=40.0, cx=48.0, cy=32.0)
    pixels, _ = SeedPattern(camera, 500).seeds(half_striped()[:, 16:112], None, np.random.default_rng(0))
    assert 300 < len(pixels) < 700


def disc(sigma: float = 0.2) -> GaussianMap:
    q = np.array([[0.9, 0.1, 0.3, 0.2]])
    return GaussianMap(
        np.array([[0.0, 0.0, 2.0]]), np.log([[sigma, 0.5 * sigma, 0.01]]), q / np.linalg.norm(q), np.array([2.0]),
        np.array([[0.2, 0.4, 0.6]]),
    )  # fmt: skip


def test_halves_have_the_moments_of_the_whole_and_lie_in_its_plane() -> None:
    whole, two = disc(), halves(disc(), np.array([0]))
    assert len(two) == 2
    R = matrix_from_quaternion(whole.quats)[0]
    offsets = (two.means - whole.means) @ R
    np.testing.assert_allclose(two.means.mean(axis=0), whole.means[0], atol=1e-6)
    np.testing.assert_allclose(offsets[:, 1:], 0, atol=1e-6)
    s = np.exp(two.log_scales[0])
    variance = s[0] ** 2 + offsets[0, 0] ** 2
    assert variance == pytest.approx(np.exp(whole.log_scales[0, 0]) ** 2, rel=0.03)
    np.testing.assert_array_equal(two.log_scales[:, 1:], np.repeat(whole.log_scales[:, 1:], 2, axis=0))


def test_only_what_is_large_and_wrong_is_split() -> None:
    renderer = Renderer(CAMERA, "sphere")
    g = disc().concat(disc(0.02))
    g.means[1] = [2.0, 0.0, 0.0]
    render = renderer.forward(g, np.eye(4))
    right = np.full((64, 128), 0.01, np.float32)
    wrong = np.full((64, 128), 0.3, np.float32)
    rule = SplitRule(error=0.06, size_px=1.0, share=1.0)
    assert len(too_coarse(render, g, np.zeros(3), right, rule)) == 0
    np.testing.assert_array_equal(too_coarse(render, g, np.zeros(3), wrong, rule), [0])
    assert len(too_coarse(render, g, np.zeros(3), wrong, SplitRule(share=0.0))) == 0


def test_a_mapper_that_splits_keeps_its_books() -> None:
    config = PanogsConfig()
    renderer = Renderer(CAMERA, "sphere", config.rendering.low_pass)
    mapper = Mapper(CAMERA, renderer, config, AnchoredTrajectory(), seed=0)
    view = View(0, half_striped(), np.eye(4))
    mapper.initialise(view, 0.0, np.full((64, 128), 2.0, np.float32))
    assert view.seen is not None

    def count() -> int:
        assert view.seen is not None
        return int(np.count_nonzero(view.seen.seen[mapper.map.ids]))

    n, seen = len(mapper.map), count()
    near = View(1, view.image, make_pose(np.eye(3), [0.7, 0.0, 0.0]))
    render = renderer.forward(mapper.map.gaussians, near.T_wc)
    split = mapper.split(near, render)
    assert split > 0
    m = mapper.map
    assert len(m) == n + split == len(m.adam.steps) == len(m.anchors) == len(m.ids)
    assert count() >= seen
    assert mapper.optimiser.optimise(2) > 0


def test_the_last_steps_better_the_map_and_leave_the_poses() -> None:
    sequence = RoomsDataset().open("tiny", width=128)
    depth, groundtruth = sequence.depth(0), sequence.groundtruth
    assert depth is not None
    assert groundtruth is not None
    T_wc = invert_pose(groundtruth.T_wc[0]) @ groundtruth.T_wc
    mapper = Mapper(
        sequence.camera, Renderer(sequence.camera), configured(start__iterations=0), AnchoredTrajectory(), 0
    )
    views = [View(i, sequence.image(i), T_wc[i].copy()) for i in range(12)]
    mapper.initialise(views[0], 0.0, depth)
    for view in views[1:]:
        mapper.add_keyframe(view, [view, *mapper.window], 0.0)
    mapper.optimiser.optimise(60, poses=False)

    def error() -> float:
        renders = [mapper.renderer.forward(mapper.map.gaussians, v.T_wc).colour for v in views]
        return float(np.mean([np.square(r - v.image / np.float32(255)).mean() for r, v in zip(renders, views)]))

    before = error()
    mapper.optimiser.polish(60)
    assert error() < 0.9 * before
    assert all(np.array_equal(v.T_wc, T_wc[v.index]) for v in views)
    mapper.optimiser.polish(0)


@pytest.mark.slow
def test_last_steps_go_on_while_views_that_were_left_out_gain() -> None:
    """Rounds double, never train on the views that judge them, and leave those better."""
    sequence = RoomsDataset().open("tiny", width=128)
    depth, groundtruth = sequence.depth(0), sequence.groundtruth
    assert depth is not None
    assert groundtruth is not None
    T_wc = invert_pose(groundtruth.T_wc[0]) @ groundtruth.T_wc
    config = configured(start__iterations=0, mapping__final_iterations=3, mapping__final_rounds=5)
    mapper = Mapper(sequence.camera, Renderer(sequence.camera), config, AnchoredTrajectory(), 0)
    views = [View(i, sequence.image(i), T_wc[i].copy()) for i in range(12)]
    mapper.initialise(views[0], 0.0, depth)
    for view in views[1:]:
        mapper.add_keyframe(view, [view, *mapper.window], 0.0)
    optimiser, rounds = mapper.optimiser, list[int]()
    unseen = views[LEFT_OUT // 2 :: LEFT_OUT]
    before, polish = optimiser._psnr(unseen), optimiser.polish

    def counted(iterations: int, of: list[View] | None = None) -> None:
        assert of is not None
        assert not {id(v) for v in of} & {id(v) for v in unseen}
        rounds.append(iterations)
        polish(iterations, of)

    optimiser.polish = counted  # type: ignore[method-assign]
    optimiser.finish()
    assert rounds == [36 << k for k in range(len(rounds))]
    assert len(rounds) >= 2
    assert optimiser._psnr(unseen) > before + 1.0
