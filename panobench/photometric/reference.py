"""The reference that frames are aligned to: an image with depth, as selected pixels with Jacobians, on a pyramid."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from panobench.cameras.base import Camera
from panobench.kernels.columns import CAM
from panobench.kernels.jit import JIT, PARALLEL, njit, prange
from panobench.photometric.lens_centres import origin_of, panorama_of
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pyramid import F32, halve
from panobench.photometric.warp import camera_code, parameters_at_level


@dataclass(frozen=True)
class AlignOptions:
    """Options of ``align`` and ``make_reference``. Residuals are of 1, the range of luma.

    iterations: most iterations on each level, coarsest first; the last number repeats.
    huber, huber_min: Huber threshold, in robust standard deviations of the level's residuals at its start, and its
    least value (of 1). A fixed threshold would let the few strong edges, where interpolation and occlusion cause
    errors, outvote weakly textured walls.
    cut, cut_levels: on the ``cut_levels`` finest levels, residuals above ``cut`` Huber thresholds do not count; they
    are where the reference is wrong.
    cut_moving, cut_moving_min: on all levels, residuals above ``cut_moving`` Huber thresholds and above
    ``cut_moving_min`` (of 1) do not count if a twentieth of the view has such residuals; see ``reject_moving``.
    depth_edge: pixels whose four neighbours span a larger ratio of depths, at full size, are not selected.
    latitude_limit_deg: nor are rows nearer to the poles, where alignment in (u, v) is ill-conditioned.
    step_m, step_rad: a level has converged when a step is shorter than both.
    exposure: also solve for gain and offset of the frame.
    gradient_min: least sum of the absolute derivatives (of 1 per pixel) of a pixel that is selected.
    rotation_only: keep the translation of the start.
    pixels: about how many pixels a level has at most, evenly spread; None for no limit.
    """

    iterations: tuple[int, ...] = (12, 8, 6, 5)
    huber: float = 1.0
    huber_min: float = 0.002
    cut: float = 10.0
    cut_levels: int = 1
    cut_moving: float = math.inf
    cut_moving_min: float = 0.08
    depth_edge: float = 1.1
    latitude_limit_deg: float = 75.0
    step_m: float = 2e-5
    step_rad: float = 1e-5
    exposure: bool = False
    gradient_min: float = 2e-3
    rotation_only: bool = False
    pixels: int | None = None


#: The options when none are given.
DEFAULT = AlignOptions()
#: A view of more solid angle (steradians) sees enough of the static scene beside something large that moves.
WIDE_SR = 3 * np.pi


def reject_moving(camera: Camera, options: AlignOptions = DEFAULT) -> AlignOptions:
    """``options`` with which a large moving object in front of a wide camera does not pull the pose.

    Huber's cost bounds the influence of a pixel, but not that of a quarter of the view that moves together. Cameras
    with a narrower view keep their options: for them the same residuals are the parallax that tells a rotation from a
    translation.
    """
    wide = ViewWidth.of(camera, WIDE_SR) is ViewWidth.WIDE
    return replace(options, cut_moving=5.0) if wide else options


@dataclass(frozen=True)
class ReferenceLevel:
    """The n selected pixels of one pyramid level, float32.

    points (3, n): in the reference camera's frame, in the unit of the depth. jacobian (6, n): derivative of the luma
    by a twist (translation, rotation) of the points. value (n,): luma of 1. weight (n,): proportional to the pixel's
    solid angle. camera (6,): see ``kernels.columns.CameraColumns``.
    """

    points: F32
    jacobian: F32
    value: F32
    weight: F32
    camera: F32

    @cached_property
    def total(self) -> float:
        """Sum of the weights."""
        return float(self.weight.sum(dtype=np.float64))


@dataclass(frozen=True)
class Reference:
    """An image with depth that frames can be aligned to. levels: level 0 is full size; code: of ``camera_code``."""

    levels: list[ReferenceLevel]
    code: int


@njit(**JIT)
def _pixel_angles(code, cam, w, h):  # type: ignore[no-untyped-def]
    """Sines and cosines, (4, max(w, h)), of a panorama's longitudes by column (0, 1) and latitudes by row (2, 3)."""
    out = np.empty((4, max(w, h)))
    if code == 0:
        for x in range(w):
            lon = ((x + 0.5) / cam[CAM.width] - 0.5) * 2 * np.pi
            out[0, x], out[1, x] = np.sin(lon), np.cos(lon)
        for y in range(h):
            lat = (0.5 - (y + 0.5) / cam[CAM.height]) * np.pi
            out[2, y], out[3, y] = np.sin(lat), np.cos(lat)
    return out


@njit(**JIT)
def _select_row(  # type: ignore[no-untyped-def]
    y, image, depth, code, cam, angles, sin_limit, gradient_min, edge, keep, points, jacobian, value, weight, n, fill
):
    """Select pixels of row y, and write them from index n on if ``fill``; returns n plus their number.

    One pixel in ``keep`` is considered, in a slanted pattern that no straight line of the image can miss.
    """
    w, pixels = image.shape[1], panorama_of(cam)
    if code == 0 and abs(angles[2, y]) > sin_limit:
        return n
    slant = int(0.382 * keep) | 1
    for x in range((-slant * y) % keep, w, keep):
        d = depth[y, x]
        if not d > 0:
            continue
        xm, xp = x - 1, x + 1
        if code == 0:
            xm, xp = (w - 1 if x == 0 else xm), (0 if xp == w else xp)
        elif xm < 0 or xp >= w:
            continue
        gx = 0.5 * (image[y, xp] - image[y, xm])
        gy = 0.5 * (image[y + 1, x] - image[y - 1, x])
        if not (abs(gx) + abs(gy) >= gradient_min):  # also drops NaN
            continue
        near = min(min(depth[y, xm], depth[y, xp]), min(depth[y - 1, x], depth[y + 1, x]))
        far = max(max(depth[y, xm], depth[y, xp]), max(depth[y - 1, x], depth[y + 1, x]))
        if max(far, d) > edge * min(near, d):
            continue
        if fill:
            if code == 0:
                c = angles[3, y]
                X, Y, Z = c * angles[0, x] * d, -angles[2, y] * d, c * angles[1, x] * d
                a, b = pixels[CAM.width] / (2 * np.pi), pixels[CAM.height] / np.pi
                rho, r2 = c * d, d * d
                rho2 = rho * rho
                jx = gx * a * Z / rho2 - gy * b * X * Y / (r2 * rho)
                jy = gy * b * rho / r2
                jz = -gx * a * X / rho2 - gy * b * Z * Y / (r2 * rho)
            else:
                rx, ry = (x + 0.5 - pixels[CAM.cx]) / pixels[CAM.fx], (y + 0.5 - pixels[CAM.cy]) / pixels[CAM.fy]
                c, Z = 1.0, d / np.sqrt(rx * rx + ry * ry + 1.0)
                X, Y = rx * Z, ry * Z
                jx, jy = gx * pixels[CAM.fx] / Z, gy * pixels[CAM.fy] / Z
                jz = -(jx * X + jy * Y) / Z
            if cam.ndim == 2:
                ox, oy, oz = origin_of(X, Y, Z, cam)
                X, Y, Z = X + ox, Y + oy, Z + oz
            points[0, n], points[1, n], points[2, n] = X, Y, Z
            jacobian[0, n], jacobian[1, n], jacobian[2, n] = jx, jy, jz
            jacobian[3, n] = Y * jz - Z * jy
            jacobian[4, n] = Z * jx - X * jz
            jacobian[5, n] = X * jy - Y * jx
            value[n] = image[y, x]
            weight[n] = c
        n += 1
    return n


@njit(**PARALLEL)
def _select(image, depth, code, cam, sin_limit, gradient_min, edge, keep):  # type: ignore[no-untyped-def]
    """The points, Jacobians, values and weights of ``ReferenceLevel``; image, depth (H, W), NaN where unknown."""
    h = image.shape[0]
    angles = _pixel_angles(code, panorama_of(cam), image.shape[1], h)
    counts = np.zeros(h + 1, np.int64)
    e2, e1 = np.empty((0, 0), np.float32), np.empty(0, np.float32)
    for y in prange(1, h - 1):
        counts[y + 1] = _select_row(
            y, image, depth, code, cam, angles, sin_limit, gradient_min, edge, keep, e2, e2, e1, e1, 0, False
        )
    for y in range(h):
        counts[y + 1] += counts[y]
    n = counts[h]
    points, jacobian = np.empty((3, n), np.float32), np.empty((6, n), np.float32)
    value, weight = np.empty(n, np.float32), np.empty(n, np.float32)
    for y in prange(1, h - 1):
        _select_row(
            y, image, depth, code, cam, angles, sin_limit, gradient_min, edge, keep, points, jacobian, value, weight,
            counts[y], True,
        )  # fmt: skip
    return points, jacobian, value, weight


@njit(**PARALLEL)
def _halve_depth(depth, ratio):  # type: ignore[no-untyped-def]
    """Mean inverse depth of 2x2 blocks; NaN where fewer than three are known or their depths differ by ``ratio``."""
    h, w = depth.shape[0] // 2, depth.shape[1] // 2
    out = np.empty((h, w), np.float32)
    for y in prange(h):
        for x in range(w):
            s, n, near, far = 0.0, 0, 1e30, 0.0
            for dy in range(2):
                for dx in range(2):
                    d = depth[2 * y + dy, 2 * x + dx]
                    if d > 0:
                        s += 1.0 / d
                        n += 1
                        near, far = min(near, d), max(far, d)
            out[y, x] = n / s if n >= 3 and far < ratio * near else np.nan
    return out


def make_reference(camera: Camera, luma: F32, depth: F32, levels: int, options: AlignOptions = DEFAULT) -> Reference:
    """A reference from luma (H, W) in 0..1 and radial depth (H, W), both float32 and NaN where unknown.

    Raises UnsupportedError for cameras that ``camera_code`` does not know.
    """
    code, cam = camera_code(camera)
    sin_limit = float(np.sin(np.deg2rad(options.latitude_limit_deg)))
    out = []
    for level in range(levels):
        if level:
            luma, depth = halve(luma), _halve_depth(depth, 1.3)
        parameters = parameters_at_level(cam, level)
        keep = 1 if options.pixels is None else max(round(luma.size / options.pixels), 1)
        points, jacobian, value, weight = _select(
            luma, depth, code, parameters, sin_limit, options.gradient_min, 1 + (options.depth_edge - 1) * 2**level,
            keep,
        )  # fmt: skip
        out.append(ReferenceLevel(points, jacobian, value, weight, parameters))
    return Reference(out, code)
