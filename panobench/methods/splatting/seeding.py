"""Seeding Gaussians on a depth map: where, how large, and lying in the surface (DGIS).

Equal-area directions keep the poles from being over-populated; a Gaussian is a disc in the local tangent plane,
because thick overlapping blobs bias the composited depth towards the camera.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.rig_panorama import RigPanorama
from panobench.geometry import fibonacci_sphere, quaternion_from_matrix
from panobench.splat.gaussians import F32, GaussianMap

#: A disc seen edge-on is not stretched beyond this to cover its pixels.
MAX_STRETCH = 3.0


def surface_normals(camera: Camera, depth: F32, x: NDArray[np.intp], y: NDArray[np.intp]) -> NDArray[np.float64]:
    """Unit normals (M, 3) in the camera frame, facing the camera, at pixels x, y (M,): differences of the points.

    Where a neighbour is missing or lies across a depth edge (over 10% apart) the one-sided difference is used,
    else the viewing direction. Panoramas wrap.
    """
    du = _tangent(camera, depth, x, y, 1, 0)
    dv = _tangent(camera, depth, x, y, 0, 1)
    normal = np.cross(dv, du)
    norm = np.linalg.norm(normal, axis=-1, keepdims=True)
    view = -camera.rays()[y, x]
    with np.errstate(invalid="ignore", divide="ignore"):
        normal = np.where(norm > 1e-12, normal / norm, view)
    normal = np.where(np.isfinite(normal), normal, view)
    flip = np.sum(normal * view, axis=-1, keepdims=True) < 0
    return np.asarray(np.where(flip, -normal, normal))


def _tangent(
    camera: Camera, depth: F32, x: NDArray[np.intp], y: NDArray[np.intp], dx: int, dy: int
) -> NDArray[np.float64]:
    """From the point of the pixel before to that of the one after, in steps of (dx, dy), or one of them to its own."""
    here = depth[y, x].astype(np.float64)
    point = camera.rays()[y, x] * here[:, None]
    ends = []
    for side in (-1, 1):
        u, v = x + side * dx, y + side * dy
        inside = (v >= 0) & (v < camera.height)
        if camera.kind == "erp":
            u = u % camera.width
        else:
            inside &= (u >= 0) & (u < camera.width)
        u, v = np.clip(u, 0, camera.width - 1), np.clip(v, 0, camera.height - 1)
        with np.errstate(invalid="ignore", divide="ignore"):
            same = inside & (np.abs(depth[v, u] / here - 1) < 0.1)
        ends.append(np.where(same[:, None], camera.rays()[v, u] * depth[v, u, None].astype(np.float64), point))
    return np.asarray(ends[1] - ends[0])


def equal_area_pixels(camera: Camera, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """About ``count`` pixel positions (M, 2), equal in solid angle, on the camera's valid pixels.

    The lattice is turned by a random rotation, so that repeated calls do not reuse directions.
    """
    if camera.kind == "pinhole":
        # Equal area in the image: the perspective image is what has to be covered evenly.
        step = float(np.sqrt(camera.width * camera.height / max(count, 1)))
        u = np.arange(step / 2, camera.width, step)
        v = np.arange(step / 2, camera.height, step)
        grid = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2) + rng.uniform(-0.3, 0.3, 2) * step
        pixels = np.clip(grid, 0.5, [camera.width - 0.5, camera.height - 0.5])
        return pixels[_valid_at(camera, pixels)]
    coverage = float(camera.solid_angle().sum())
    total = round(count * 4 * np.pi / max(coverage, 1e-6))
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    pixels, valid = camera.project(fibonacci_sphere(total) @ (q * np.sign(np.diag(r))).T)
    pixels = pixels[valid]
    return np.asarray(pixels[_valid_at(camera, pixels)])


def _valid_at(camera: Camera, pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
    x, y = _nearest(camera, pixels)
    return np.asarray(camera.valid_mask()[y, x])


def _nearest(camera: Camera, pixels: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    x = np.clip(np.floor(pixels[:, 0]).astype(np.intp), 0, camera.width - 1)
    y = np.clip(np.floor(pixels[:, 1]).astype(np.intp), 0, camera.height - 1)
    return x, y


def seed_gaussians(
    camera: Camera,
    image: NDArray[np.uint8],
    depth: F32,
    pixels: NDArray[np.float64],
    T_wc: NDArray[np.float64],
    spacing_rad: float | NDArray[np.float64],
    *,
    flatten: float,
    scale_factor: float,
    opacity: float,
) -> GaussianMap:
    """Discs at ``pixels`` (M, 2) on the surface given by radial ``depth`` (H, W), coloured from the image.

    spacing_rad: angle between neighbouring seeds, one for all or (M,); a disc's standard deviation is
    scale_factor x spacing x depth, stretched along the tilt of the surface so that it still covers its share of the
    image, and ``flatten`` times that along the normal. Pixels without depth are skipped.
    """
    x, y = _nearest(camera, pixels)
    d = depth[y, x].astype(np.float64)
    keep = np.isfinite(d) & (d > 0)
    x, y, d, pixels = x[keep], y[keep], d[keep], pixels[keep]
    spacing = np.broadcast_to(spacing_rad, keep.shape)[keep]
    rays = camera.unproject(pixels)
    normals = surface_normals(camera, depth, x, y)
    # The seed lies off the pixel centre: slide the depth along the tangent plane through the centre's point.
    centre = camera.rays()[y, x]
    denominator = np.sum(rays * normals, axis=1)
    slide = np.sum(centre * normals, axis=1) / np.where(np.abs(denominator) > 0.1, denominator, np.inf)
    d = d * np.where((slide > 0.9) & (slide < 1.1), slide, 1.0)
    cosine = np.clip(np.abs(denominator), 1.0 / MAX_STRETCH, 1.0)
    tilt = -rays - np.sum(-rays * normals, axis=1, keepdims=True) * normals
    tilt_norm = np.linalg.norm(tilt, axis=1, keepdims=True)
    helper = np.where(np.abs(normals[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    fallback = np.cross(normals, helper)
    fallback /= np.linalg.norm(fallback, axis=1, keepdims=True)
    first = np.where(tilt_norm > 1e-3, tilt / np.maximum(tilt_norm, 1e-12), fallback)
    axes = np.stack([first, np.cross(normals, first), normals], axis=-1)
    base = scale_factor * spacing * d
    scales = np.stack([base / cosine, base, flatten * base], axis=1)
    R_wc, t = T_wc[:3, :3], T_wc[:3, 3]
    points = rays * d[:, None]
    if isinstance(camera, RigPanorama):
        points += camera.origins()[y, x]
    quats = quaternion_from_matrix(R_wc @ axes)
    return GaussianMap(
        (points @ R_wc.T + t).astype(np.float32),
        np.log(scales).astype(np.float32),
        quats.astype(np.float32),
        np.full(len(d), np.log(opacity / (1 - opacity)), np.float32),
        (image[y, x] / np.float32(255)).astype(np.float32),
    )


def fill_depth(depth: F32, wrap: bool) -> F32:
    """Nearest known depth for every unknown pixel, across the seam of a panorama; NaN only if nothing is known."""
    from scipy.ndimage import distance_transform_edt

    unknown = ~(np.isfinite(depth) & (depth > 0))
    if not unknown.any() or unknown.all():
        return depth
    w = depth.shape[1]
    tiled = np.concatenate([unknown, unknown, unknown], axis=1) if wrap else unknown
    index = distance_transform_edt(tiled, return_distances=False, return_indices=True)
    if wrap:
        index = index[:, :, w : 2 * w]
    return np.asarray(depth[index[0], index[1] % w])
