"""Casting rays: the hierarchy against brute force, the tiles against the hierarchy, distances against samples."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.calibration import builtin_calibration
from panobench.cameras.erp import ErpCamera
from panobench.rooms import render, visibility
from panobench.rooms.builder import Builder
from panobench.rooms.kinds import KINDS
from panobench.rooms.mesh import DISC, LEAF, RECT, TRIANGLE, Material, Mesh
from panobench.rooms.scene import Geometry, make_geometry
from panobench.rooms.trace import clearances, trace

SHAPES = (RECT, TRIANGLE, DISC, LEAF)


def scattered(count: int) -> Mesh:
    """Quads of random place, size and shape in a cube of 4 m."""
    rng = np.random.default_rng(1)
    b = Builder(rng, node_spacing=10.0)
    for k in range(count):
        p0, eu, ev = rng.uniform(-2, 2, 3), *rng.normal(size=(2, 3)) * 0.4
        b.quad(p0, eu, ev, Material(), shape=SHAPES[k % 4], two_sided=True)
    return b.build()


def nearest(g: Geometry, origin: NDArray, ray: NDArray) -> tuple[int, float]:
    """Primitive and distance by the hierarchy; (-1, far) if there is none."""
    row, distance, _, _ = trace(
        g.boxes, g.links, g.planes, g.tree_shape, *origin, *ray, 1e3, 0.0, np.empty(128, np.int32)
    )
    return (int(g.order[row]) if row >= 0 else -1), distance


def brute_force(g: Geometry, origin: NDArray, ray: NDArray) -> tuple[int, float]:
    """The same by testing every primitive."""
    m = g.mesh
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((m.p0 - origin) * g.normal).sum(axis=1) / (g.normal @ ray)
        x = origin + t[:, None] * ray - m.p0
    u, v = (g.duals[:, :3] * x).sum(axis=1), (g.duals[:, 3:] * x).sum(axis=1)
    inside = (u >= 0) & (v >= 0) & (u <= 1) & (v <= 1)
    inside &= (m.shape != TRIANGLE) | (u + v <= 1)
    inside &= (m.shape != DISC) | ((u - 0.5) ** 2 + (v - 0.5) ** 2 <= 0.25)
    inside &= (m.shape != LEAF) | (np.abs(v - 0.5) <= 2 * u * (1 - u))
    t = np.where(inside & (t > 1e-4), t, np.inf)
    who = int(np.argmin(t))
    return (who, float(t[who])) if np.isfinite(t[who]) else (-1, 1e3)


def test_the_hierarchy_finds_what_brute_force_finds() -> None:
    geometry = make_geometry(scattered(300))
    rng = np.random.default_rng(2)
    hits = set()
    for _ in range(1000):
        origin, ray = rng.uniform(-2, 2, 3), rng.normal(size=3)
        ray /= np.linalg.norm(ray)
        who, distance = nearest(geometry, origin, ray)
        expected, exact = brute_force(geometry, origin, ray)
        assert who == expected or abs(distance - exact) < 1e-4  # float32 at an edge
        hits.add(int(geometry.mesh.shape[who]) if who >= 0 else -1)
    assert hits == {-1, *SHAPES}


@pytest.mark.parametrize(
    "camera", [ErpCamera(128, 64), builtin_calibration("palvio_up").scaled(160)], ids=["erp", "pal"]
)
def test_the_tiles_see_what_rays_see(camera: Camera) -> None:
    """Depth by edge functions over tiles and by single rays through the hierarchy, in a furnished room."""
    geometry = make_geometry(KINDS["tiny"].plan(np.random.default_rng(0)).mesh)
    T_wc = np.eye(4)
    T_wc[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # z forward along the floor
    T_wc[:3, 3] = (1.6, 1.4, 1.3)
    depth = render.depth(geometry, render.ray_bundle(camera), T_wc)
    rays = camera.rays() @ T_wc[:3, :3].T
    valid = camera.valid_mask()
    traced = np.array([nearest(geometry, T_wc[:3, 3], ray)[1] for ray in rays[valid]])
    assert (
        np.abs(depth[valid] - traced) < 1e-4 * traced
    ).mean() > 0.998  # the rest are edges, where float32 may differ
    assert np.isnan(depth[~valid]).all()


def test_blocks_without_a_ray_have_no_cone() -> None:
    """Such a block was once searched for everything that there is."""
    lens = builtin_calibration("palvio_up").scaled(320)
    fine = render.ray_bundle(lens).fine[..., 3]
    valid = lens.valid_mask().reshape(fine.shape[0], visibility.FINE_H, fine.shape[1], visibility.FINE_W)
    assert np.array_equal(fine > 1.5, ~valid.any(axis=(1, 3)))
    assert fine[fine < 1.5].min() > 0.8


@pytest.mark.parametrize("shape", SHAPES)
def test_clearances_are_lower_bounds(shape: int) -> None:
    mesh = scattered(8)
    mesh.shape[:] = shape
    rng = np.random.default_rng(3)
    points = rng.uniform(-3, 3, (40, 3))
    u, v = rng.uniform(0, 1, (2, 4000))
    keep = {RECT: u >= 0, TRIANGLE: u + v <= 1, DISC: np.hypot(u - 0.5, v - 0.5) <= 0.5}
    inside = keep.get(shape, np.abs(v - 0.5) <= 2 * u * (1 - u))
    surface = (mesh.p0[:, None] + u[inside, None] * mesh.eu[:, None] + v[inside, None] * mesh.ev[:, None]).reshape(
        -1, 3
    )
    sampled = np.linalg.norm(points[:, None] - surface, axis=-1).min(axis=1)
    found = clearances(mesh.p0, mesh.eu, mesh.ev, points)
    assert (found <= sampled + 1e-9).all()
    if shape == RECT:
        assert (sampled - found).max() < 0.05
