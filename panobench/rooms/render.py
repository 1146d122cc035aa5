"""Images and depth of a scene for any camera."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.rooms import shading, visibility
from panobench.rooms.scene import Geometry, Scene

SUB = 4  # visibility samples per pixel side


def worker_count() -> int:
    """Threads to render with: the processors this process may use, at most 8."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(usable, 8))


@dataclass(frozen=True)
class RayBundle:
    """A camera's rays for the kernels, in the camera frame; zero where the camera sees nothing.

    rays, exact:   (H, W, 3) unit rays of the pixel centres, float32 and float64.
    ray_x, ray_y:  (H, W, 3) their derivatives per pixel.
    coarse, fine:  bounding cones of the tiles, see ``visibility.tile_cones``.
    """

    rays: NDArray[np.float32]
    exact: NDArray[np.float64]
    ray_x: NDArray[np.float32]
    ray_y: NDArray[np.float32]
    coarse: NDArray[np.float64]
    fine: NDArray[np.float64]


def ray_bundle(camera: Camera) -> RayBundle:
    """The rays of all pixels of ``camera``."""
    valid = camera.valid_mask()
    exact = np.where(valid[..., None], camera.rays(), 0.0)
    grid = camera.pixel_grid()
    diff = []
    for axis in range(2):
        step = np.zeros(2)
        step[axis] = 0.25
        a, b = camera.unproject(grid - step), camera.unproject(grid + step)
        d = (b - a) * 2
        one_sided = np.where(np.isfinite(b), b - exact, exact - a) * 4
        d = np.where(np.isfinite(d), d, np.nan_to_num(one_sided))
        diff.append(np.where(valid[..., None], d, 0.0))
    spread = 0.75 * np.maximum(np.linalg.norm(diff[0], axis=-1), np.linalg.norm(diff[1], axis=-1))
    exact = np.ascontiguousarray(exact, dtype=np.float64)
    return RayBundle(
        rays=exact.astype(np.float32),
        exact=exact,
        ray_x=np.ascontiguousarray(diff[0], dtype=np.float32),
        ray_y=np.ascontiguousarray(diff[1], dtype=np.float32),
        coarse=visibility.tile_cones(exact, spread, visibility.COARSE_W, visibility.COARSE_H),
        fine=visibility.tile_cones(exact, spread, visibility.FINE_W, visibility.FINE_H),
    )


def _view(T_wc: NDArray[np.float64]) -> NDArray[np.float64]:
    """(4, 3): rows of the camera-to-world rotation, then the camera centre."""
    return np.ascontiguousarray(np.vstack([T_wc[:3, :3], T_wc[:3, 3]]))


def sample_offsets(sub: int) -> NDArray[np.float32]:
    """(sub^2, 2) sample positions in a pixel, -1/2..1/2.

    The grid is sheared: no two samples share a row or a column, so that edges along either have sub^2 grey levels.
    """
    a, b = np.meshgrid(np.arange(sub), np.arange(sub))
    x, y = a + (b + 0.5) / sub, b + (a + 0.5) / sub
    return (np.stack([x.ravel(), y.ravel()], axis=-1) / sub - 0.5).astype(np.float32)


def radiance(
    scene: Scene, bundle: RayBundle, T_wc: NDArray[np.float64], *, gain: float = 1.0, sub: int = SUB
) -> NDArray[np.float32]:
    """Display-linear RGB (H, W, 3) in 0..1: after the tone curve, before the sRGB curve.

    gain: exposure factor before the tone curve. sub: visibility samples per pixel side.
    """
    g, s = scene.geometry, scene.surfaces
    m = g.mesh
    out = np.zeros(bundle.rays.shape, dtype=np.float32)
    shading.render_frame(
        _view(T_wc), bundle.rays, bundle.ray_x, bundle.ray_y, bundle.coarse, bundle.fine, sample_offsets(sub),
        float(gain), g.seen_from(T_wc[:3, 3]), m.p0, g.duals, g.normal, m.two_sided, m.shape,
        s.look, s.paint, s.atlas.texels, s.atlas.table, s.light,
        g.boxes, g.links, g.planes, g.tree_shape, g.order, out,
    )  # fmt: skip
    return out


def to_image(linear: NDArray[np.float32], *, sigma: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    """Apply the sRGB curve to display-linear RGB, add sensor noise of deviation ``sigma`` (full scale 1), quantise."""
    out = np.empty(linear.shape, dtype=np.uint8)
    shading.encode(np.ascontiguousarray(linear, dtype=np.float32), float(sigma), np.random.default_rng(seed), out)
    return out


def depth(g: Geometry, bundle: RayBundle, T_wc: NDArray[np.float64]) -> NDArray[np.float32]:
    """Exact radial depth (H, W) of the pixel centres, metres; NaN where nothing is seen."""
    m = g.mesh
    view = _view(T_wc)
    only = g.seen_from(T_wc[:3, 3])
    f = np.empty((len(only), 9), dtype=np.float32)
    index = np.empty(len(only), dtype=np.int32)
    count = visibility.edge_functions(only, m.p0, g.duals, g.normal, m.two_sided, view, f, index)
    who = np.full(bundle.rays.shape[:2], -1, dtype=np.int32)
    visibility.cast_centres(f, count, index, m.shape, bundle.rays, bundle.coarse, bundle.fine, who)
    out = np.empty(who.shape, dtype=np.float32)
    visibility.plane_depth(m.p0, g.normal, who, bundle.exact, view, out)
    return out
