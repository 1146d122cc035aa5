"""Depth that is made flat where planes explain the frames: a box with patterned walls, a plain one, and a ball."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.bench.export.plane_alignment import align
from panobench.bench.export.plane_depth import corrected_depths
from panobench.bench.export.planes import Plane, find_planes
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.cameras.erp import ErpCamera
from panobench.geometry import make_pose, so3_exp
from panobench.photometric.stereo import WorkingScale

Array = NDArray[np.float64]

#: Half the edges of the box, metres; the ball's centre and radius.
BOX = np.array([2.0, 1.2, 1.6])
BALL, RADIUS = np.array([0.9, 0.5, 0.3]), 0.35


def cast(rays: Array, centre: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Distance (...) to the box or the ball along unit rays (..., 3), and where it is the ball."""
    with np.errstate(divide="ignore"):
        wall = np.min((np.sign(rays) * BOX - centre) / rays, axis=-1)
    b = rays @ (centre - BALL)
    inside = b**2 - ((centre - BALL) ** 2).sum() + RADIUS**2
    ball = np.where(inside > 0, -b - np.sqrt(np.maximum(inside, 0)), np.inf)
    return np.minimum(wall, ball), ball < wall


def painted(X: Array, ball: NDArray[np.bool_]) -> Array:
    """Luma (...) of points (..., 3): waves on the walls, hardly any on the one at +x, others on the ball."""
    waves = sum(np.sin(X @ np.array(k) + j) for j, k in enumerate([(5, 3, -4), (-4, 6, 3), (3, -5, 7), (9, 2, 5)]))
    plain = X[..., 0] > BOX[0] - 1e-6
    return np.where(ball, 0.25 + 0.02 * waves, np.where(plain, 0.8 + 0.008 * waves, 0.55 + 0.06 * waves))


def points(views: PosedPanoramas, k: int) -> Array:
    """(H, W, 3) in the world, by the depth of view ``k``."""
    return np.asarray(views.T_wc[k, :3, 3] + views.depth[k][..., None] * views.rays(k))


@pytest.fixture(scope="module")
def truth() -> PosedPanoramas:
    camera = ErpCamera(256, 128)
    t = np.linspace(0, 1, 7)
    positions = np.stack([0.5 * np.sin(5 * t), 0.3 * np.cos(3 * t), 0.6 * t - 0.5], axis=1)
    T_wc = make_pose(so3_exp(np.stack([0.1 * t, t, 0 * t], axis=1)), positions)
    cases = [(camera.rays() @ T[:3, :3].T, T[:3, 3]) for T in T_wc]
    depths, balls = zip(*(cast(rays, centre) for rays, centre in cases))
    luma = [painted(c + d[..., None] * r, b) for (r, c), d, b in zip(cases, depths, balls)]
    scale = WorkingScale.of(camera, 256)
    return PosedPanoramas(np.stack(luma).astype(np.float32), np.stack(depths).astype(np.float32), T_wc, scale)


@pytest.fixture(scope="module")
def bulging(truth: PosedPanoramas) -> PosedPanoramas:
    """The same with depths too large, by 4% on the ball, 0.5% elsewhere; up to 8% too small on the plain wall."""
    depths = []
    for k, depth in enumerate(truth.depth):
        X = points(truth, k)
        bulge = 0.08 * np.exp(-((X[..., 1] - 0.3) ** 2 + X[..., 2] ** 2) / 0.25) * (X[..., 0] > BOX[0] - 0.01)
        ball = cast(truth.rays(k), truth.T_wc[k, :3, 3])[1]
        depths.append(depth * np.where(ball, 1.04, 1.005 - bulge))
    return replace(truth, depth=np.stack(depths).astype(np.float32))


def offset(plane: Plane) -> float:
    """How far the plane is from the nearest wall of the box, metres, judged where that wall is."""
    axis = int(np.abs(plane.normal).argmax())
    wall = np.zeros(3)
    wall[axis] = np.sign(plane.normal[axis] * plane.offset) * BOX[axis]
    return float(abs(plane.normal @ wall - plane.offset))


def test_planes_are_found_and_the_frames_put_them_right(bulging: PosedPanoramas) -> None:
    generator = np.random.default_rng(0)
    found = find_planes(bulging, generator)[:6]
    axes = [int(np.abs(p.normal).argmax()) for p in found]
    assert {(axis, p.normal[axis] * p.offset > 0) for axis, p in zip(axes, found)} == {
        (axis, side) for axis in range(3) for side in (False, True)
    }
    aligned = [align(plane, bulging, generator) for plane in found]
    assert all(plane is not None for plane in aligned)
    before, after = [offset(p) for p in found], [offset(p) for p in aligned if p is not None]
    assert np.median(before) > 0.004, "as far as the depths are wrong"
    assert max(after) < 0.003
    assert all(np.abs(p.normal).max() > np.cos(0.005) for p in aligned if p is not None)


def test_plain_walls_become_flat_and_the_ball_stays_round(truth: PosedPanoramas, bulging: PosedPanoramas) -> None:
    made = corrected_depths(bulging, bulging.depth)
    known = np.isfinite(made)
    error, before = np.abs(made - truth.depth), np.abs(bulging.depth - truth.depth)
    plain = np.stack([points(truth, k)[..., 0] for k in range(len(truth))]) > BOX[0] - 0.01
    assert (before[plain] > 0.02).mean() > 0.2
    assert known[plain].mean() > 0.95
    assert (error[plain & known] > 0.02).mean() < 0.5 * (before[plain] > 0.02).mean()
    assert np.median(error[plain & known]) < 0.003 < 0.01 < np.median(before[plain])
    ball = np.stack([cast(truth.rays(k), truth.T_wc[k, :3, 3])[1] for k in range(len(truth))])
    assert known[ball].mean() > 0.6
    assert np.median(error[ball & known]) < 0.7 * np.median(before[ball])
    assert (error[ball & known] > 0.07).mean() < 0.1, "along its outline"


def test_without_parallax_the_depth_is_the_maps(truth: PosedPanoramas) -> None:
    still = replace(truth, T_wc=np.repeat(truth.T_wc[:1], len(truth), axis=0))
    assert (corrected_depths(still, still.depth) == still.depth).all()


def test_what_the_frames_do_not_show_keeps_the_maps_depth(bulging: PosedPanoramas) -> None:
    seen = np.arange(128)[:, None].repeat(256, axis=1) < 90
    scale = WorkingScale.of(ErpCamera(256, 128).with_mask(seen), 256)
    luma = np.where(seen, bulging.luma, np.float32(np.nan))
    made = corrected_depths(replace(bulging, luma=luma, scale=scale), bulging.depth)
    assert np.array_equal(made[:, ~seen], bulging.depth[:, ~seen])
    assert (made != bulging.depth)[:, seen].mean() > 0.8
