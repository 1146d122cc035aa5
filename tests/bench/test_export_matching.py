"""A plane for each pixel by PatchMatch, and what other views confirm: on a box with a ball in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from panoramas_of_a_box import BOX, cast, points, posed_views, with_bulges

from panobench.bench.export import patchmatch
from panobench.bench.export.confirmation import confirmed
from panobench.bench.export.frame_depth import depths_by_frames
from panobench.bench.export.fusion import fuse
from panobench.bench.export.plane_matching import COARSE, FINE, SIGMA, TRUNCATION, PlaneField, matched_depth, pyramid_of
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.cameras.erp import ErpCamera
from panobench.geometry import invert_pose
from panobench.photometric.stereo import WorkingScale
from panobench.photometric.sweep import padded

Array = NDArray[np.float64]


def bilinear(image: Array, u: Array, v: Array) -> Array:
    """(N,) at pixels u, v of a panorama, in float64."""
    h, w = image.shape
    x, y = np.floor(u - 0.5).astype(int), np.floor(v - 0.5).astype(int)
    a, b = u - 0.5 - x, v - 0.5 - y
    at = [[image[np.clip(y + j, 0, h - 1), (x + i) % w] for i in (0, 1)] for j in (0, 1)]
    return (1 - b) * ((1 - a) * at[0][0] + a * at[0][1]) + b * ((1 - a) * at[1][0] + a * at[1][1])


def reference_cost(views: PosedPanoramas, k: int, others: list[int], plane: Array, row: int, column: int) -> float:
    """Of one plane at one pixel, in float64: the mean over the best half of the others."""
    h, w = views.luma.shape[1:]
    samples = patchmatch.window(2)
    stretch = 1 / max(np.cos((0.5 - (row + 0.5) / h) * np.pi), 0.15)
    rows = np.clip(row + samples[:, 0].astype(int), 0, h - 1)
    columns = (column + np.rint(stretch * samples[:, 1]).astype(int)) % w
    luma, rays = views.luma[k].astype(np.float64), views.scale.camera.rays()[rows, columns]
    weight = np.exp(-np.abs(luma[rows, columns] - luma[row, column]) / SIGMA - samples[:, 2])
    costs = []
    for j in others:
        T = invert_pose(views.T_wc[j]) @ views.T_wc[k]
        X = rays / (rays @ plane)[:, None] @ T[:3, :3].T + T[:3, 3]
        pixels, _ = views.scale.camera.project(X)
        seen = bilinear(views.luma[j].astype(np.float64), pixels[:, 0], pixels[:, 1])
        costs.append(weight @ np.minimum(np.abs(seen - luma[rows, columns]), TRUNCATION) / weight.sum())
    return float(np.sort(costs)[: len(others) // 2].mean())


def test_the_cost_of_a_plane_is_that_of_a_reference_in_float64(truth: PosedPanoramas) -> None:
    k, others = 3, [0, 1, 5, 6]
    rng = np.random.default_rng(2)
    rays = truth.scale.rays
    n = rays + 0.3 * rng.normal(size=rays.shape)
    depth = truth.depth[k] * rng.uniform(0.9, 1.1, truth.depth[k].shape)
    planes = (n / (depth * (n * rays).sum(axis=-1))[..., None]).astype(np.float32)
    found, cost = np.zeros_like(planes), np.full(depth.shape, 9.0, np.float32)
    T = np.stack([invert_pose(truth.T_wc[j]) @ truth.T_wc[k] for j in others]).astype(np.float32)
    patchmatch.try_planes(
        planes, truth.luma[k], rays, padded(truth.luma[others], True), np.ascontiguousarray(T[:, :3, :3]),
        np.ascontiguousarray(T[:, :3, 3]), 2, patchmatch.window(2),
        np.array([TRUNCATION, 1 / SIGMA, 0, 0], np.float32), found, cost,
    )  # fmt: skip
    assert np.array_equal(found[24:104], planes[24:104])
    places = [(int(rng.integers(24, 104)), int(rng.integers(256))) for _ in range(60)] + [(0, 4), (127, 200), (64, 0)]
    expected = [reference_cost(truth, k, others, planes[y, x].astype(np.float64), y, x) for y, x in places]
    assert np.std(expected) > 1e-3
    assert [cost[y, x] for y, x in places] == pytest.approx(expected, abs=2e-5)
    assert (found[0, 4:8] == planes[0, 4]).all(), "at the poles, pixels are narrow"
    assert (cost[0, 4:8] == cost[0, 4]).all()


def test_what_costs_more_or_lies_behind_is_not_taken(truth: PosedPanoramas) -> None:
    field = PlaneField(truth, 3, [0, 1, 5, 6])
    field.offer_depth(truth.depth[3])
    before = field.planes.copy()
    field.offer(-before)
    field.offer(np.full_like(before, np.nan))
    assert np.array_equal(field.planes, before, equal_nan=True)
    field.offer(before / np.float32(1.1))
    assert (field.planes == before).all(axis=-1).mean() > 0.7, "where there is texture"


def test_planes_spread_from_where_they_are_right(truth: PosedPanoramas) -> None:
    """Depth that is 15% too large all over, but for a pixel in 400, becomes right nearly everywhere."""
    k, rng = 3, np.random.default_rng(0)
    exact = truth.depth[k]
    start = np.where(rng.random(exact.shape) < 1 / 400, exact, 1.15 * exact)
    field = PlaneField(truth, k, [0, 1, 5, 6])
    field.offer(truth.scale.rays / start[..., None])
    field.improve((*COARSE, *FINE))
    wall = (points(truth, k)[..., 0] < BOX[0] - 0.01) & ~cast(truth.rays(k), truth.T_wc[k, :3, 3])[1]
    error = np.abs(field.depth(truth.scale.rays) / exact - 1)
    assert np.median(error[wall]) < 0.006
    assert (error[wall] < 0.02).mean() > 0.85


def test_one_seed_one_answer(truth: PosedPanoramas) -> None:
    found = []
    for seed in (1, 1, 2):
        field = PlaneField(truth, 3, [0, 1, 5, 6], seed)
        field.offer(truth.scale.rays / (1.05 * truth.depth[3])[..., None])
        field.improve(FINE)
        found.append(field.planes)
    assert np.array_equal(found[0], found[1])
    assert not np.array_equal(found[0], found[2])


def test_a_finer_panorama_sees_the_same_planes(truth: PosedPanoramas) -> None:
    field = PlaneField(truth, 3, [0, 1, 5, 6])
    field.planes = truth.scale.rays / truth.depth[3][..., None]
    wall = np.array([1 / 3, 0, 0], np.float32)  # x = 3
    field.planes[:, 128:] = wall
    rays = ErpCamera(512, 256).rays().astype(np.float32)
    depth = field.depth(rays)
    right = rays[:, 256:, 0] > 0.1
    assert depth[:, 256:][right] == pytest.approx((3 / rays[:, 256:, 0])[right], rel=1e-5)
    behind = rays[:, 256:, 0] < -0.1
    assert np.isnan(depth[:, 256:][behind]).all()


def test_windows_are_compared_in_larger_views(truth: PosedPanoramas) -> None:
    """A pixel's plane costs what it costs the first of the pixels that the larger view has there."""
    larger, others = posed_views(512), [0, 1, 5, 6]
    planes = truth.scale.rays / (1.02 * truth.depth[3])[..., None]
    field, whole = PlaneField(truth, 3, others, finer=larger), PlaneField(larger, 3, others)
    field.offer(planes)
    whole.offer(planes.repeat(2, axis=0).repeat(2, axis=1))
    assert np.array_equal(field.cost[48:80], whole.cost[96:160:2, ::2])
    assert np.array_equal(field.planes[48:80], planes[48:80])


def test_larger_views_tell_depth_better(truth: PosedPanoramas, bulging: PosedPanoramas) -> None:
    errors = []
    for views in (bulging, with_bulges(posed_views(512))):
        made = matched_depth(pyramid_of(views), 3, truth.scale.rays)
        assert made.shape == truth.depth[3].shape
        errors.append(float(np.nanmedian(np.abs(made / truth.depth[3] - 1))))
    assert errors[1] < 0.6 * errors[0]


def test_bulges_go_and_the_ball_stays_round(truth: PosedPanoramas, bulging: PosedPanoramas) -> None:
    made = depths_by_frames(bulging, bulging.depth)
    known = np.isfinite(made)
    error, before = np.abs(made - truth.depth), np.abs(bulging.depth - truth.depth)
    ball = np.stack([cast(truth.rays(k), truth.T_wc[k, :3, 3])[1] for k in range(len(truth))])
    assert known.mean() > 0.85
    assert known[ball].mean() > 0.4, "it is small, and its outline differs from view to view"
    assert np.median(error[known]) < 0.2 * np.median(before)
    assert np.median(error[ball & known]) < 0.3 * np.median(before[ball])
    assert (error[known] > 0.05).mean() < 0.05


def test_without_parallax_the_depth_is_the_maps(truth: PosedPanoramas) -> None:
    still = replace(truth, T_wc=np.repeat(truth.T_wc[:1], len(truth), axis=0), depth=truth.depth[:1].repeat(7, axis=0))
    assert (depths_by_frames(still, still.depth) == still.depth).all()


def test_what_the_frames_do_not_show_keeps_the_maps_depth(bulging: PosedPanoramas) -> None:
    seen = np.arange(128)[:, None].repeat(256, axis=1) < 90
    scale = WorkingScale.of(ErpCamera(256, 128).with_mask(seen), 256)
    luma = np.where(seen, bulging.luma, np.float32(np.nan))
    made = depths_by_frames(replace(bulging, luma=luma, scale=scale), bulging.depth)
    assert np.array_equal(made[:, ~seen], bulging.depth[:, ~seen])
    assert np.isfinite(made[:, seen]).mean() > 0.8


def test_an_odd_size_is_matched_at_once(bulging: PosedPanoramas) -> None:
    half = bulging.halved()
    assert half is not None
    odd = replace(
        half,
        luma=half.luma[:, :63, :126].copy(),
        depth=half.depth[:, :63, :126].copy(),
        scale=WorkingScale.of(ErpCamera(126, 63), 126),  # the size alone counts here
    )
    assert odd.halved() is None
    assert len(pyramid_of(odd)) == 1
    assert np.isfinite(matched_depth(pyramid_of(odd), 3, odd.scale.rays)).all()


@pytest.mark.parametrize(("width", "widths"), [(256, [128, 256]), (1024, [512, 1024]), (2048, [512, 1024, 2048])])
def test_large_views_are_matched_at_small_sizes_first(width: int, widths: list[int]) -> None:
    still = np.zeros((1, width // 2, width), np.float32)
    views = PosedPanoramas(still, still, np.eye(4)[None], WorkingScale.of(ErpCamera(width, width // 2), width))
    assert [level.luma.shape[2] for level in pyramid_of(views)] == widths


def test_only_what_others_see_too_is_confirmed(truth: PosedPanoramas) -> None:
    rays = truth.scale.rays
    depths = truth.depth.copy()
    depths[3, 40:60, 30:60] *= 0.8  # floats before the wall
    depths[3, 70:80, 100:120] *= 1.002
    depths[3, :5] = np.nan
    kept = np.isfinite(confirmed(depths, truth.T_wc, rays, 0.008))
    assert not kept[3, 40:60, 30:60].any()
    assert not kept[3, :5].any()
    assert kept[3, 70:80, 100:120].mean() > 0.9
    assert kept[[0, 1, 2, 4, 5, 6]].mean() > 0.93
    assert np.array_equal(confirmed(depths[:1], truth.T_wc[:1], rays, 0.008), depths[:1], equal_nan=True)


def test_fusion_is_that_of_a_reference_in_float64(truth: PosedPanoramas) -> None:
    depths = truth.depth.copy()
    depths[2, 20:60] = np.nan
    low, shape, size, reach = np.array([-2.331, -1.429, -1.783]), (24, 15, 19), 0.2, 0.5
    grid = low + size * np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    total, weight = np.zeros(shape), np.zeros(shape)
    for depth, T in zip(depths, truth.T_wc):
        local = (grid - T[:3, 3]) @ T[:3, :3]
        pixels, _ = truth.scale.camera.project(local.reshape(-1, 3))
        column, row = (np.floor(pixels.reshape(*shape, 2)).astype(int) % [256, 128]).transpose(3, 0, 1, 2)
        far = np.linalg.norm(local, axis=-1)
        ahead = depth[row, column] - far
        w = np.where(ahead > -reach, 1 / far, 0)
        total += np.where(w > 0, w * np.minimum(1, ahead / reach), 0)
        weight += w
    distance, found = fuse(depths, truth.T_wc, low, shape, size, reach)
    # a voxel whose centre falls between two pixels may take either
    assert (np.abs(found - weight) < 1e-4 * weight.max()).mean() > 0.999
    expected = np.where(weight > 0, total / np.maximum(weight, 1e-12), 1.0)
    assert (np.abs(distance - expected) < 1e-4).mean() > 0.999
