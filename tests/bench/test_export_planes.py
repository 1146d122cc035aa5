"""Planes of a scene, and where they are preferred: in a box with patterned walls, a plain one, and a ball."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from panoramas_of_a_box import BOX, cast, painted, points

from panobench.bench.export.plane_alignment import align
from panobench.bench.export.plane_pieces import PlanePieces, solid_pieces
from panobench.bench.export.plane_preference import preferred
from panobench.bench.export.planes import Plane, find_planes
from panobench.bench.export.posed_panoramas import PosedPanoramas

Array = NDArray[np.float64]


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


def on_wall(views: PosedPanoramas, k: int, margin: float = 0.0) -> NDArray[np.bool_]:
    """Where view ``k`` shows the plain wall, by its depth, so far from the others."""
    X = points(views, k)
    return np.asarray((X[..., 0] > BOX[0] - 0.01) & (np.abs(X[..., 1:]) < BOX[1:] - margin).all(axis=-1))


def unsure(views: PosedPanoramas) -> NDArray[np.bool_]:
    return np.zeros(views.depth.shape[1:], bool)


@pytest.fixture(scope="module")
def walls(truth: PosedPanoramas) -> list[PlanePieces]:
    """The six of the box; the plain one is the first."""
    planes = [Plane(side * np.eye(3)[axis], float(BOX[axis])) for axis in range(3) for side in (1.0, -1.0)]
    return [solid_pieces(p, truth.depth, truth.T_wc, truth.scale.rays, truth.median_depth) for p in planes]


def test_a_wall_is_solid_but_for_its_window(truth: PosedPanoramas) -> None:
    depths, plane = truth.depth.copy(), Plane(np.array([1.0, 0, 0]), float(BOX[0]))
    for k in range(len(truth)):
        X = points(truth, k)
        depths[k][on_wall(truth, k) & (np.abs(X[..., 1:]) < 0.4).all(axis=-1)] *= 1.5
        depths[k][on_wall(truth, k) & (X[..., 2] > 1)] *= 1.5 if k == 0 else 1.0  # one of seven sees the street there
    pieces = solid_pieces(plane, depths, truth.T_wc, truth.scale.rays, truth.median_depth)
    axes = np.stack([pieces.across, pieces.down])
    index = (np.indices(pieces.solid.shape) - len(pieces.solid) // 2 + 0.5) * pieces.edge
    X = index.transpose(1, 2, 0) @ axes + pieces.middle
    wall = (np.abs(X[..., 1:]) < BOX[1:] - 0.15).all(axis=-1)
    window = (np.abs(X[..., 1:]) < 0.25).all(axis=-1)
    assert pieces.solid[wall & (np.abs(X[..., 1:]) > 0.55).any(axis=-1)].mean() > 0.97
    assert not pieces.solid[window].any()


def test_walls_are_preferred_and_the_ball_stays_round(
    truth: PosedPanoramas, bulging: PosedPanoramas, walls: list[PlanePieces]
) -> None:
    for k in (1, 3):
        chosen = preferred(bulging, k, unsure(bulging), walls)
        ball = cast(truth.rays(k), truth.T_wc[k, :3, 3])[1]
        plain = on_wall(truth, k, 0.1) & (truth.depth[k] < 1.04 * bulging.depth[k])
        assert (chosen[plain] == 0).mean() > 0.95
        assert (chosen[ball] >= 0).mean() < 0.2
        for number, wall in enumerate(walls):
            away = np.abs(points(truth, k) @ wall.plane.normal - wall.plane.offset) > 0.3
            assert (chosen[away] == number).mean() < 0.02


def test_what_a_wall_mirrors_does_not_take_depth_off_it(truth: PosedPanoramas, walls: list[PlanePieces]) -> None:
    """The plain wall mirrors the room faintly; the depth at hand is 10% behind it, or 4% before."""
    luma = truth.luma.copy()
    for k in range(len(truth)):
        wall, mirror = on_wall(truth, k), np.array([-1.0, 1.0, 1.0])
        rays, centre = truth.rays(k)[wall] * mirror, truth.T_wc[k, :3, 3] * mirror + [2 * BOX[0], 0, 0]
        far, ball = cast(rays, centre)
        luma[k][wall] += 0.02 * painted(centre + far[:, None] * rays, ball).astype(np.float32)
    wall = on_wall(truth, 3, 0.3)
    for factor in (1.1, 0.96):
        shining = replace(truth, luma=luma, depth=truth.depth * np.float32(factor))
        assert (preferred(shining, 3, unsure(truth), walls)[wall] == 0).mean() > 0.9, factor
        sure = preferred(shining, 3, ~unsure(truth), walls)[wall]
        assert (sure == (0 if factor > 1 else -1)).all(), "what is confirmed stays before a wall, not behind it"


def test_without_parallax_no_plane_is_preferred(truth: PosedPanoramas, walls: list[PlanePieces]) -> None:
    still = replace(truth, T_wc=np.repeat(truth.T_wc[:1], len(truth), axis=0))
    assert (preferred(still, 2, unsure(still), walls) == -1).all()
