"""What the kernels need to know of a camera: a ray for each pixel, tiles, and how to bound a footprint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.errors import UnsupportedError

#: Size of a tile in pixels: one row of it is one AVX-512 register, or two of AVX2.
TILE_W, TILE_H = 16, 16
Projection = Literal["sphere", "erp", "pinhole"]
#: Kernel codes of the projections.
SPHERE, CONIC_ERP, CONIC_PINHOLE = 0, 1, 2
#: How a footprint is bounded: by latitude and longitude (panoramas), by a rectangle of pixels (first-order
#: projections), by a cone for each tile (any camera), by planes through the camera's centre (undistorted pinholes).
BOUND_LATLON, BOUND_PIXELS, BOUND_CONES, BOUND_PINHOLE = 0, 1, 2, 3
#: Largest half width (rad of longitude) of a column of tiles that one tangent plane can hold.
_LARGEST_HALF = 1.5


@dataclass(frozen=True)
class View:
    """Tables for one camera and projection.

    width, height: of the image, pixels. projection, bound: codes, see above.
    rays (3, H, W) float32: unit rays in the camera frame ("sphere") or (u, v, 1) (first-order projections); 0 where a
    pixel has none.
    cones (tiles, 4) float32: mean ray and cosine of the angular radius of each tile, for BOUND_CONES; else (0, 4).
    column_axes (tiles_x, 4) float32: x and z of the directions a and x of each column of tiles, see ``row_bounds``;
    (0, 4) for cameras without columns that a plane can hold. column_half: largest |X| of a pixel in a column.
    tiles (K,) int32: the tiles with a valid pixel, which are drawn; in a panorama of limited view the others are not.
    intrinsics (8,): see ``kernels.columns.CameraColumns``. pixel_angle: radians that one pixel spans.
    """

    width: int
    height: int
    projection: int
    bound: int
    rays: NDArray[np.float32]
    cones: NDArray[np.float32]
    column_axes: NDArray[np.float32]
    column_half: np.float32
    tiles: NDArray[np.int32]
    intrinsics: NDArray[np.float64]
    pixel_angle: float

    @property
    def tiles_x(self) -> int:
        return -(-self.width // TILE_W)

    @property
    def tiles_y(self) -> int:
        return -(-self.height // TILE_H)


def make_view(camera: Camera, projection: Projection = "sphere") -> View:
    """Tables for rendering ``camera``. Raises UnsupportedError for a projection the camera does not have.

    "sphere" serves every camera. "erp" is the first-order projection of an ErpCamera, as in the PanoGS-SLAM paper;
    "pinhole" that of an undistorted PinholeCamera, as in 3DGS.
    """
    W, H = camera.width, camera.height
    intrinsics = np.array([W, H, 0, 0, 0, 0, 0, 0], dtype=np.float64)
    if camera.kind == "pinhole":
        fx, fy, cx, cy = (float(getattr(camera, n)) for n in ("fx", "fy", "cx", "cy"))
        intrinsics[2:] = [fx, fy, cx, cy, 0.65 * W / fx, 0.65 * H / fy]
    if projection == "sphere":
        rays = np.nan_to_num(camera.rays()).transpose(2, 0, 1).astype(np.float32)
        pinhole = camera.kind == "pinhole" and not any(getattr(camera, "distortion", ()) or ())
        bound = BOUND_LATLON if camera.kind == "erp" else BOUND_PINHOLE if pinhole else BOUND_CONES
        code = SPHERE
    else:
        if camera.kind != projection or any(getattr(camera, "distortion", ()) or ()):
            raise UnsupportedError(
                f"projection '{projection}' cannot render this {camera.kind} camera; 'sphere' renders every camera"
            )
        u, v = np.meshgrid(np.arange(W) + 0.5, np.arange(H) + 0.5)
        rays = np.stack([u, v, np.ones_like(u)]).astype(np.float32)
        bound, code = BOUND_PIXELS, CONIC_ERP if projection == "erp" else CONIC_PINHOLE
    angle = 2 * np.pi / W if camera.kind == "erp" else _pixel_angle(camera)
    cones = _tile_cones(rays) if bound == BOUND_CONES else np.zeros((0, 4), np.float32)
    axes, half = _columns(bound, intrinsics)
    tiles = _tiles_of(camera)
    return View(W, H, code, bound, np.ascontiguousarray(rays), cones, axes, half, tiles, intrinsics, angle)


def _columns(bound: int, intrinsics: NDArray[np.float64]) -> tuple[NDArray[np.float32], np.float32]:
    """``View.column_axes`` and, with a little slack, ``View.column_half``."""
    W, _, fx, _, cx = intrinsics[:5]
    centre, half = (np.arange(-(-W // TILE_W)) + 0.5) * TILE_W, 0.5 * (TILE_W - 1)
    if bound == BOUND_LATLON and half * 2 * np.pi / W < _LARGEST_HALF:
        lon, half = centre * (2 * np.pi / W) - np.pi, np.tan(half * 2 * np.pi / W)
        axes = np.stack([np.sin(lon), np.cos(lon), np.cos(lon), -np.sin(lon)], axis=1)
    elif bound == BOUND_PINHOLE:
        one = np.ones_like(centre)
        axes, half = np.stack([(centre - cx) / fx, one, one, 0 * one], axis=1), half / fx
    else:
        return np.zeros((0, 4), np.float32), np.float32(0)
    return axes.astype(np.float32), np.float32(1.002 * half)


def _tiles_of(camera: Camera) -> NDArray[np.int32]:
    """Numbers (K,) of the tiles that hold a valid pixel."""
    valid = camera.valid_mask()
    rows, columns = np.arange(0, valid.shape[0], TILE_H), np.arange(0, valid.shape[1], TILE_W)
    some = np.logical_or.reduceat(np.logical_or.reduceat(valid, rows, axis=0), columns, axis=1)
    return np.flatnonzero(some).astype(np.int32)


def _pixel_angle(camera: Camera) -> float:
    """Angular size of a pixel where the image is sharpest: 1/fx for a pinhole, else the median pixel's."""
    if camera.kind == "pinhole":
        return 1.0 / float(camera.fx)  # type: ignore[attr-defined]
    area = camera.solid_angle()
    return float(np.sqrt(np.median(area[area > 0])))


def _tile_cones(rays: NDArray[np.float32]) -> NDArray[np.float32]:
    """``View.cones``: the smallest cone around the mean ray that holds all rays of a tile; cosine 2 for empty tiles."""
    _, H, W = rays.shape
    ny, nx = -(-H // TILE_H), -(-W // TILE_W)
    cones = np.zeros((ny * nx, 4), np.float32)
    for t in range(ny * nx):
        y, x = (t // nx) * TILE_H, (t % nx) * TILE_W
        block = rays[:, y : y + TILE_H, x : x + TILE_W].reshape(3, -1)
        block = block[:, np.abs(block).sum(axis=0) > 0]
        if block.shape[1] == 0:
            cones[t] = [0, 0, 1, 2]
            continue
        mean = block.mean(axis=1)
        mean /= max(float(np.linalg.norm(mean)), 1e-9)
        cones[t] = [*mean, max(float((mean @ block).min()) - 1e-6, -1.0)]
    return cones
