"""Rows of footprints within columns of tiles: nothing that is drawn is missed, and little is visited in vain."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from splat_scenes import gaussian_map

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.kernels.columns import FOOTPRINT as F
from panobench.kernels.columns import span
from panobench.splat.footprint import COS_MIN
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.splat.view import TILE_H, TILE_W

CAMERAS: dict[str, Camera] = {
    "least": ErpCamera(24, 12),  # a column of tiles is more than half of it
    "small": ErpCamera(72, 36),
    "large": ErpCamera(512, 256),
    "pinhole": PinholeCamera(70, 50, fx=42.0, fy=45.0, cx=31.0, cy=27.5),
}


def scene(seed: int, n: int, longest: float) -> GaussianMap:
    """Gaussians all around, poles and seam included, some of them ``longest`` times as long as wide."""
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(n, 3))
    d[::5] *= [0.05, 1, 0.05]  # over the poles
    d[1::5] *= [0.02, 1, 1]
    d[1::5, 2] = -np.abs(d[1::5, 2])  # over the seam
    scale = np.exp(rng.normal(-3.5, 1.0, size=(n, 1))) * longest ** rng.uniform(-0.5, 0.5, size=(n, 3))
    points = d / np.linalg.norm(d, axis=1, keepdims=True) * rng.uniform(0.7, 3, size=(n, 1))
    return gaussian_map(points, scale=scale, quats=rng.normal(size=(n, 4)), logit=rng.normal(1.0, 2.0, size=n))


def spans_and_truth(camera: Camera, g: GaussianMap) -> tuple[np.ndarray, np.ndarray]:
    """(M, H, W): pixels that each drawn Gaussian's entries visit, and those its footprint holds (float64)."""
    renderer = Renderer(camera, "sphere", low_pass=0.1, stop=0.0)
    out = renderer.forward(g, np.eye(4))
    s, view = out._tape, renderer.view
    assert s is not None
    H, W, M = view.height, view.width, len(out.order)
    visited = np.zeros((M, H, W), bool)
    for tile in range(view.tiles_x * view.tiles_y):
        y0, x0 = tile // view.tiles_x * TILE_H, tile % view.tiles_x * TILE_W
        for e in range(s.starts[tile], s.starts[tile + 1]):
            first, rows = (int(v) for v in s.spans[e])
            assert 1 <= rows <= TILE_H - first
            assert y0 + first + rows <= H
            cell = visited[s.entries[e], y0 + first : y0 + first + rows, x0 : x0 + TILE_W]
            assert not cell.any()  # nothing is listed twice
            cell[:] = True
    p, rays = s.footprints.astype(np.float64), view.rays.astype(np.float64)
    t1, t2, depth = (np.einsum("mi,ihw->mhw", p[:, span(vector)], rays) for vector in (F.p1, F.p2, F.m))
    inside = t1**2 + t2**2 <= (1 - 1e-4) * p[:, F.cut, None, None] * depth**2
    return visited, inside & (depth > COS_MIN)


@given(st.integers(0, 10**6), st.sampled_from([1.0, 5.0, 60.0, 1000.0]), st.sampled_from(sorted(CAMERAS)))
@settings(max_examples=40, deadline=None)
def test_every_pixel_of_a_footprint_is_visited(seed: int, longest: float, name: str) -> None:
    visited, inside = spans_and_truth(CAMERAS[name], scene(seed, 20, longest))
    assert not (inside & ~visited).any()


def test_little_is_visited_in_vain() -> None:
    """Within columns of tiles, what is visited of a slanted footprint is hardly taller than what it holds."""
    visited, inside = spans_and_truth(CAMERAS["large"], scene(1, 150, 10.0))
    columns = [slice(x, x + TILE_W) for x in range(0, visited.shape[2], TILE_W)]
    wide = inside.any(axis=1).sum(axis=1)
    compact = (wide > 8) & (wide < 64)
    tall, needed = (
        np.stack([a[:, :, c].any(axis=2).sum(axis=1) for c in columns], axis=1)[compact] for a in (visited, inside)
    )
    box = visited.any(axis=2).sum(axis=1)[compact, None] * (tall > 0)
    assert np.count_nonzero(compact) > 30
    assert needed.sum() < tall.sum() < 1.15 * needed.sum()
    assert tall.sum() < 0.85 * box.sum()  # what the rectangles alone would visit
