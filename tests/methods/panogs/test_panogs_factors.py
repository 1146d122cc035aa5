"""Bundle-adjustment factors behind the tracker: which there are, what they mend, and how much is kept."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig_panorama import LensCentres
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.geometry import invert_pose, make_pose, se3_exp, umeyama
from panobench.methods.panogs.config import FactorOptions
from panobench.methods.panogs.factor_graph.depth import FactorDepth
from panobench.methods.panogs.factor_graph.factors import NEAREST, FactorGraph, bundle_options, softened
from panobench.methods.panogs.rigs.scale import RigScale
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pyramid import F32, luma_of_frame
from panobench.photometric.stereo import WorkingScale

Array = NDArray[np.float64]
FRAMES = 20


@lru_cache(maxsize=1)
def room() -> tuple[WorkingScale, list[F32], list[F32], Array]:
    """Working scale, luma, depth and poses of the first frames."""
    sequence = RoomsDataset().open("tiny", width=256)
    assert sequence.groundtruth is not None
    scale = WorkingScale.of(sequence.camera, 256)
    luma = [luma_of_frame(sequence.image(i), scale.valid) for i in range(FRAMES)]
    depth = [sequence.depth(i) for i in range(FRAMES)]
    T_wc = invert_pose(sequence.groundtruth.T_wc[0]) @ sequence.groundtruth.T_wc[:FRAMES]
    return scale, luma, [d for d in depth if d is not None], T_wc


def tracked(poses: list[Array]) -> AnchoredTrajectory:
    """Every frame with its pose; the first is the keyframe."""
    trajectory, first = AnchoredTrajectory(), View(0, np.zeros((1, 1, 3), np.uint8), poses[0])
    trajectory.add_keyframe(first, 0.0)
    for i, T in enumerate(poses[1:], 1):
        trajectory.add(i, i / 15, T, first)
    return trajectory


def graph(**options: float) -> FactorGraph:
    """A graph with short reach, for wide views."""
    chosen = {"reach": 8, "renew_after": 16, "every": 4, **options}
    return FactorGraph(room()[0], ViewWidth.WIDE, FactorOptions(**chosen))  # type: ignore[arg-type]


def run(poses: list[Array], g: FactorGraph | None = None, young: float = 1.0) -> FactorGraph:
    """young: the ratio by which depth is wrong when a factor is made for the first time."""
    _, luma, depth, _ = room()
    g, visited, trajectory = g or graph(), set(), tracked(poses)
    for i in range(FRAMES):
        g.add(i, luma[i])
        while (k := g.due(at_end=i == FRAMES - 1)) is not None:
            g.make_factor(k, trajectory, depth[k] * np.float32(1.0 if k in visited else young))
            visited.add(k)
    return g


def misfit(T: Array, truth: Array) -> float:
    s = umeyama(T[:, :3, 3], truth[:, :3, 3])
    return float(np.sqrt(((s.apply_points(T[:, :3, 3]) - truth[:, :3, 3]) ** 2).sum(axis=1).mean()))


def test_disturbed_poses_are_mended_and_the_first_stays() -> None:
    truth = room()[3]
    noise = np.random.default_rng(0).normal(0, 0.003, (FRAMES, 6))
    noise[0] = 0
    start = list(truth @ se3_exp(noise))
    fit = run(start).optimise(tracked(start), 2.0)
    after = np.stack([fit.poses[i] for i in range(FRAMES)])
    assert misfit(after, truth) < 0.4 * misfit(np.stack(start), truth)
    np.testing.assert_allclose(after[0], start[0], atol=1e-12)
    assert all(abs(factor - 1) < 0.02 for factor in fit.stretch.values())


def test_every_frame_is_in_a_factor() -> None:
    g = run(list(room()[3]))
    assert [f.reference for f in g.factors] == [0, 4, 8, 12, 16]
    assert set().union(*(set(f.frames.tolist()) for f in g.factors)) == set(range(FRAMES))


@pytest.mark.parametrize(("young", "twice"), [(1.0, False), (1.005, False), (1.05, True)])
def test_a_factor_is_made_again_if_its_depth_has_changed(
    young: float, twice: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    make = FactorGraph._make
    monkeypatch.setattr(FactorGraph, "_make", lambda self, k, *rest: (made.append(k), make(self, k, *rest)))
    g = run(list(room()[3]), young=young)
    assert sorted(made) == sorted([0, 4, 8, 12, 16] * (2 if twice else 1))
    assert sorted(f.reference for f in g.factors) == [0, 4, 8, 12, 16]


def test_images_of_a_few_pixels_are_no_mistake() -> None:
    scale = WorkingScale.of(ErpCamera(40, 20), 512)
    g, trajectory = FactorGraph(scale, ViewWidth.WIDE, FactorOptions(reach=2)), tracked([np.eye(4)] * 4)
    for i in range(4):
        g.add(i, np.zeros((20, 40), np.float32))
    while (k := g.due(at_end=True)) is not None:
        g.make_factor(k, trajectory, np.ones((20, 40), np.float32))
    assert g.factors == []


def test_without_the_option_there_are_no_factors() -> None:
    g = graph(enabled=False)
    g.add(0, room()[1][0])
    assert g.due(at_end=True) is None
    assert not g.overdue()


def test_images_and_factors_are_forgotten() -> None:
    truth = list(room()[3])
    g = run(truth, graph(reach=3, renew_after=6, every=2, late=1, free=6))
    assert sum(f.luma is not None for f in g.frames) <= (3 * 3 + 2 + 1 + 1) + (3 + 1)
    fit = g.optimise(tracked(truth), 2.0)
    assert len(g.factors) < 7
    assert min(fit.poses) > 0
    held = [i for i in fit.poses if i < FRAMES - 6]
    assert held
    assert set(fit.stretch) == set(range(FRAMES - 6, FRAMES))
    for i in held:
        np.testing.assert_allclose(fit.poses[i], truth[i], atol=1e-12)


def test_frames_tracked_backwards_and_those_after_them_share_factors() -> None:
    _, luma, depth, T_wc = room()
    noise = np.random.default_rng(0).normal(0, 0.003, (FRAMES, 6))
    noise[10] = 0
    start = list(T_wc @ se3_exp(noise))
    g, trajectory = graph(), tracked(start)

    def make_factors(at_end: bool) -> None:
        while (k := g.due(at_end=at_end)) is not None:
            g.make_factor(k, trajectory, depth[g.frames[k].index])

    for i in range(10, FRAMES):
        g.add(i, luma[i])
        make_factors(at_end=i == FRAMES - 1)
    g.reverse()
    for i in range(9, -1, -1):
        g.add(i, luma[i])
        make_factors(at_end=i == 0)
    assert [f.index for f in g.frames] == list(range(FRAMES))[::-1]
    assert [g.frames[f.reference].index for f in g.factors] == [14, 18, 10, 6, 2]
    assert {g.frames[n].index for n in g.factors[2].frames} == set(range(2, 19)) - {10}
    fit = g.optimise(trajectory, 2.0)
    after = np.stack([fit.poses[i] for i in range(FRAMES)])
    assert misfit(after, T_wc) < 0.4 * misfit(np.stack(start), T_wc)


def test_cells_are_smaller_where_a_mask_hides_part_of_a_wide_view() -> None:
    def cell(camera: ErpCamera, width: ViewWidth = ViewWidth.WIDE) -> int:
        return bundle_options(WorkingScale.of(camera, 128), width).cell_px

    whole, mask = ErpCamera(256, 128), np.ones((128, 256), bool)
    assert cell(whole) == cell(ErpCamera(256, 128, 140.0)) == 6  # the camera's own limit is no mask
    for rows, pixels in ((8, 5), (40, 4), (60, 3), (100, 3)):
        hiding = mask.copy()
        hiding[128 - rows :] = False
        assert cell(whole.with_mask(hiding)) == pixels
        assert cell(whole.with_mask(hiding), ViewWidth.NARROW) == 8


def test_images_are_softened_where_a_mask_hides_part_of_the_view() -> None:
    whole, mask = ErpCamera(128, 64), np.ones((64, 128), bool)
    mask[50:] = False
    luma = np.random.default_rng(0).uniform(size=(64, 128)).astype(np.float32)
    luma[~mask] = np.nan
    for camera, same in ((whole, True), (whole.with_mask(mask), False)):
        g = FactorGraph(WorkingScale.of(camera, 128), ViewWidth.WIDE, FactorOptions())
        g.add(0, luma)
        g.replace_luma(0, luma)
        assert (g.frames[0].luma is luma) == same
    soft = softened(luma)
    assert np.nanstd(soft) < 0.5 * np.nanstd(luma)
    assert np.isfinite(soft[:49]).all()
    assert not np.isfinite(soft[49:]).any()
    assert soft[10, 0] == pytest.approx(np.array([1, 2, 1]) @ luma[9:12, [-1, 0, 1]] @ np.array([1, 2, 1]) / 16)


def test_a_factor_does_not_keep_a_wrong_depth_where_a_mask_hides_part_of_the_view() -> None:
    """Its frames tell the depth; as of an estimate from few frames, what it is given is wrong by 10%, in patches."""
    scale, luma, depth, T_wc = room()
    mask = np.ones(scale.valid.shape, bool)
    mask[100:] = False
    masked = WorkingScale.of(scale.camera.with_mask(mask), 256)
    coarse = np.random.default_rng(0).normal(0, 0.1, (8, 16))
    wrong = depth[0] * np.exp(np.kron(coarse, np.ones((16, 16)))).astype(np.float32)
    error = {}
    for sweeps in (True, False):
        g = FactorGraph(masked, ViewWidth.WIDE, FactorOptions(reach=16))
        g.depth = g.depth if sweeps else None
        for i in range(FRAMES):
            g.add(i, np.where(mask, luma[i], np.nan).astype(np.float32))
        g.make_factor(0, tracked(list(T_wc)), wrong)
        found = invert_pose(g.factors[0].bundle.T_fr)[:, :3, 3]
        error[sweeps] = misfit(np.stack([make_pose(np.eye(3), p) for p in found]), T_wc[g.factors[0].frames])
    assert error[True] < 0.6 * error[False]
    known = np.ones(mask.shape, np.float32)
    assert FactorDepth(masked).sweep(luma[0], luma[1:4], T_wc[1:4], known) is known  # too few


def test_on_a_rig_far_frames_are_left_out() -> None:
    scale, luma, depth, T_wc = room()
    away = np.linalg.norm(T_wc[:, :3, 3], axis=1) / np.median(depth[0])
    lenses = LensCentres(np.zeros((2, 3)), np.array([[0.0, 0, 1], [0, 0, -1]]))
    options = FactorOptions(reach=12, every=4, rig_reach=1.01 * float(away[7]))
    g = FactorGraph(scale, ViewWidth.WIDE, options, rig_scale=RigScale(lenses, 6.0, lambda line: None))
    for i in range(FRAMES):
        g.add(i, luma[i])
    g.make_factor(0, tracked(list(T_wc)), depth[0])
    near = [i for i in range(1, 13) if i <= NEAREST or away[i] <= options.rig_reach]
    assert NEAREST < len(near) < 12
    assert g.factors[0].frames.tolist() == near
    assert g.bundle_options.trim == 0
