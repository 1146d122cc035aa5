"""Warping inside kernels: projecting points and sampling images, for panoramas and pinholes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.rig_panorama import RigPanorama
from panobench.errors import UnsupportedError
from panobench.kernels.columns import CAM
from panobench.kernels.fast_math import atan2_fast
from panobench.kernels.jit import INLINE, JIT, JIT_FINITE, njit
from panobench.photometric.lens_centres import pixel_from_lenses, project_from_lenses, rig_parameters

ERP, PINHOLE = 0, 1
_PI = np.float32(np.pi)
_I0 = np.int32(0)
_HALF, PER_TURN = np.float32(0.5), np.float32(0.5 / np.pi)


def camera_code(camera: Camera) -> tuple[int, NDArray[np.float32]]:
    """ERP or PINHOLE, and the parameters (6,) of ``kernels.columns.CameraColumns`` in pixels.

    A panorama of a rig has more rows of them: see ``lens_centres``. Raises UnsupportedError for other cameras.
    """
    if camera.kind == "erp":
        size = np.array([camera.width, camera.height, 0, 0, 0, 0], np.float32)
        lenses = camera.lenses if isinstance(camera, RigPanorama) else None
        return ERP, size if lenses is None else rig_parameters(size, lenses)
    if camera.kind == "pinhole" and not any(getattr(camera, "distortion", ()) or ()):
        values = [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]  # type: ignore[attr-defined]
        return PINHOLE, np.array(values, np.float32)
    raise UnsupportedError(
        f"photometric alignment works on erp and undistorted pinhole images, not on this {camera.kind} camera; "
        "convert it with --camera erp"
    )


def parameters_at_level(parameters: NDArray[np.float32], level: int) -> NDArray[np.float32]:
    """Parameters of the camera at a level of the pyramid: a plain division, as pixel centres lie at k + 0.5."""
    if parameters.ndim == 2:
        return np.concatenate([parameters[:1] / np.float32(2**level), parameters[1:]])
    return np.asarray(parameters / np.float32(2**level), dtype=np.float32)


@njit(**JIT)
def to_pixel(x, y, z, code, cam):  # type: ignore[no-untyped-def]
    """Point in the camera frame -> pixel u, v and whether it lies in front of the camera."""
    if cam.ndim == 2:
        return pixel_from_lenses(x, y, z, cam)
    if code == 0:
        rho = np.sqrt(x * x + z * z)
        u = cam[CAM.width] * (np.float32(0.5) + atan2_fast(x, z) / (2 * _PI))
        v = cam[CAM.height] * (np.float32(0.5) + atan2_fast(y, rho) / _PI)
        return u, v, True
    if z < np.float32(1e-3):
        return np.float32(0), np.float32(0), False
    return cam[CAM.fx] * x / z + cam[CAM.cx], cam[CAM.fy] * y / z + cam[CAM.cy], True


@njit(**JIT_FINITE)
def project_panorama(X, Y, Z, R, t, w, h, u, v):  # type: ignore[no-untyped-def]
    """Write pixels u, v (n,) of points X, Y, Z (n,) moved by R (3, 3), t (3,), in a panorama of w x h pixels."""
    for k in range(len(X)):
        x, y, z = X[k], Y[k], Z[k]
        px = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        py = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        pz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        rho = np.sqrt(px * px + pz * pz)
        u[k] = w * (_HALF + atan2_fast(px, pz) * PER_TURN)
        v[k] = h * (_HALF + np.float32(2) * atan2_fast(py, rho) * PER_TURN)


@njit(**JIT)
def project_pinhole(X, Y, Z, R, t, cam, u, v):  # type: ignore[no-untyped-def]
    """As ``project_panorama`` for a pinhole of parameters ``cam`` (6,); points behind it get u = v = -1e6."""
    for k in range(len(X)):
        x, y, z = X[k], Y[k], Z[k]
        px = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z + t[0]
        py = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z + t[1]
        pz = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z + t[2]
        front = pz >= np.float32(1e-3)
        inv = np.float32(1) / (pz if front else np.float32(1))
        u[k] = cam[CAM.fx] * px * inv + cam[CAM.cx] if front else np.float32(-1e6)
        v[k] = cam[CAM.fy] * py * inv + cam[CAM.cy] if front else np.float32(-1e6)


@njit(**JIT)
def project(X, Y, Z, R, t, code, cam, u, v):  # type: ignore[no-untyped-def]
    """Write pixels u, v (n,) of points X, Y, Z (n,) moved by R (3, 3), t (3,); code, cam: as from ``camera_code``."""
    if cam.ndim == 2:
        project_from_lenses(X, Y, Z, R, t, cam, u, v)
        return
    if code == 0:
        project_panorama(X, Y, Z, R, t, cam[CAM.width], cam[CAM.height], u, v)
    else:
        project_pinhole(X, Y, Z, R, t, cam, u, v)


@njit(**INLINE)
def _mix(p00, p01, p10, p11, a, b):  # type: ignore[no-untyped-def]
    """Bilinear value between four pixels at (a, b) in 0..1, and its derivatives by a and b."""
    left, right = p01 - p00, p11 - p10
    top, low = p00 + a * left, p10 + a * right
    return top + b * (low - top), left + b * (right - left), low - top


@njit(**INLINE)
def _panorama_at(image, w, h, u, v):  # type: ignore[no-untyped-def]
    """Bilinear value at (u, v) of a flat image (h w,), and its derivatives; columns wrap and rows are clamped."""
    fu, fv = u - _HALF, v - _HALF
    bu, bv = np.floor(fu), np.floor(fv)
    last, bottom = np.int32(w - 1), np.int32(h - 1)
    x0, y0 = np.int32(bu), np.int32(bv)
    x1, y1 = x0 + np.int32(1), y0 + np.int32(1)
    x0 = x0 + np.int32(w) if x0 < 0 else (x0 - np.int32(w) if x0 > last else x0)
    x1 = x1 + np.int32(w) if x1 < 0 else (x1 - np.int32(w) if x1 > last else x1)
    x0, x1 = min(max(x0, _I0), last), min(max(x1, _I0), last)
    y0, y1 = min(max(y0, _I0), bottom) * np.int32(w), min(max(y1, _I0), bottom) * np.int32(w)
    p00, p01 = image[np.uint32(y0 + x0)], image[np.uint32(y0 + x1)]
    p10, p11 = image[np.uint32(y1 + x0)], image[np.uint32(y1 + x1)]
    return _mix(p00, p01, p10, p11, fu - bu, fv - bv)


@njit(**INLINE)
def _pinhole_at(image, w, h, u, v):  # type: ignore[no-untyped-def]
    """The same in a pinhole image of at least 2 x 2 pixels; the value is NaN outside."""
    fu, fv = u - _HALF, v - _HALF
    bu, bv = np.floor(fu), np.floor(fv)
    inside = (bu >= 0) & (bv >= 0) & (bu <= np.float32(w - 2)) & (bv <= np.float32(h - 2))
    x, y = np.int32(bu) if inside else _I0, np.int32(bv) if inside else _I0
    i = y * np.int32(w) + x
    j = i + np.int32(w)
    p00, p01 = image[np.uint32(i)], image[np.uint32(i + np.int32(1))]
    p10, p11 = image[np.uint32(j)], image[np.uint32(j + np.int32(1))]
    value, du, dv = _mix(p00, p01, p10, p11, fu - bu, fv - bv)
    return value if inside else np.float32(np.nan), du, dv


@njit(**JIT)
def _sample_panorama(image, w, h, u, v, out, du, dv):  # type: ignore[no-untyped-def]
    for k in range(len(u)):
        out[k], du[k], dv[k] = _panorama_at(image, w, h, u[k], v[k])


@njit(**JIT)
def _sample_pinhole(image, w, h, u, v, out, du, dv):  # type: ignore[no-untyped-def]
    for k in range(len(u)):
        out[k], du[k], dv[k] = _pinhole_at(image, w, h, u[k], v[k])


@njit(**JIT)
def sample(image, u, v, code):  # type: ignore[no-untyped-def]
    """Bilinear value at pixel (u, v) of a contiguous image (h, w).

    On a panorama columns wrap and rows are clamped; outside a pinhole image the value is NaN.
    """
    h, w = image.shape
    if code == 0:
        return _panorama_at(image.reshape(-1), w, h, u, v)[0]
    if h < 2 or w < 2:
        return np.float32(np.nan)
    return _pinhole_at(image.reshape(-1), w, h, u, v)[0]


@njit(**JIT)
def sample_run(image, u, v, code, out, du, dv):  # type: ignore[no-untyped-def]
    """``sample`` at pixels u, v (n,), vectorised: writes values ``out`` and their derivatives du, dv (n,)."""
    h, w = image.shape
    if h < 2 or w < 2:
        out[: len(u)] = np.float32(np.nan)
    elif code == 0:
        _sample_panorama(image.reshape(-1), w, h, u, v, out, du, dv)
    else:
        _sample_pinhole(image.reshape(-1), w, h, u, v, out, du, dv)


def sample_points(
    image: NDArray[np.float32],
    points: NDArray[np.floating],
    T_fr: NDArray[np.float64],
    code: int,
    cam: NDArray[np.float32],
) -> NDArray[np.float32]:
    """(N,): what an image (h, w) shows of points (N, 3) once T_fr (4, 4) has moved them; NaN of points that are NaN.

    code, cam: as from ``camera_code``. Bilinear; outside a pinhole's image NaN.
    """
    known = np.isfinite(points).all(axis=1)
    safe = np.where(known[:, None], points, [1.0, 0.0, 1.0]).astype(np.float32)
    x, y, z = np.ascontiguousarray(safe.T)
    u, v, value, du, dv = np.empty((5, len(points)), np.float32)
    R, t = np.ascontiguousarray(T_fr[:3, :3], np.float32), T_fr[:3, 3].astype(np.float32)
    project(x, y, z, R, t, code, cam, u, v)
    sample_run(np.ascontiguousarray(image), u, v, code, value, du, dv)
    value[~known] = np.nan
    return value
