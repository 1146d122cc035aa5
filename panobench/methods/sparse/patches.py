"""Numba kernels for image patches: cutting templates on the tangent plane of a bearing, and aligning them.

A template lies on the tangent plane of the bearing at which its point was first seen, so it depends on no face and no
camera model. Alignment warps it into the current face by the point's predicted motion, and solves for the remaining
2-D shift from coarse to fine: inverse-compositional Gauss-Newton with an intensity offset (Baker & Matthews,
"Lucas-Kanade 20 years on", IJCV 2004; for sparse points as in Forster et al., SVO, 2014).
"""

from __future__ import annotations

import math
from concurrent.futures import Executor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.kernels.jit import njit

#: Side of a stored template in pixels: an 8x8 window fits into it at any rotation and moderate scales.
STORED = 16
WINDOW = 8
_HALF = WINDOW // 2


@njit(cache=True)
def tangent_basis(x, y, z):  # type: ignore[no-untyped-def]
    """Two unit vectors that are orthogonal to the unit vector (x, y, z) and to each other (Duff et al. 2017)."""
    s = 1.0 if z >= 0 else -1.0
    a = -1.0 / (s + z)
    b = x * y * a
    return 1.0 + s * x * x * a, s * b, -s * x, b, s + y * y * a, -y


@njit(cache=True)
def _best_face(R_fc, x, y, z):  # type: ignore[no-untyped-def]
    best, top = -1, -2.0
    for f in range(R_fc.shape[0]):
        c = R_fc[f, 2, 0] * x + R_fc[f, 2, 1] * y + R_fc[f, 2, 2] * z
        if c > top:
            top, best = c, f
    return best, top


@njit(cache=True)
def _to_face(R_fc, K, f, x, y, z):  # type: ignore[no-untyped-def]
    px = R_fc[f, 0, 0] * x + R_fc[f, 0, 1] * y + R_fc[f, 0, 2] * z
    py = R_fc[f, 1, 0] * x + R_fc[f, 1, 1] * y + R_fc[f, 1, 2] * z
    pz = R_fc[f, 2, 0] * x + R_fc[f, 2, 1] * y + R_fc[f, 2, 2] * z
    if pz < 1e-6:
        return -1e6, -1e6
    return K[0] * px / pz + K[2], K[1] * py / pz + K[3]


@njit(cache=True)
def _bilinear(image, u, v):  # type: ignore[no-untyped-def]
    """Interpolated value at pixel coordinates (centres at k + 0.5), clamped to the border."""
    h, w = image.shape
    x = min(max(u - 0.5, 0.0), w - 1.001)
    y = min(max(v - 0.5, 0.0), h - 1.001)
    i, j = int(y), int(x)
    a, b = x - j, y - i
    top = image[i, j] + a * (float(image[i, j + 1]) - image[i, j])
    bottom = image[i + 1, j] + a * (float(image[i + 1, j + 1]) - image[i + 1, j])
    return top + b * (bottom - top)


@njit(cache=True, nogil=True)
def _cut_level(image, level, R_fc, K, bearings, pitch, out):  # type: ignore[no-untyped-def]
    scale = 1.0 / (1 << level)
    step = pitch * (1 << level)
    for n in range(bearings.shape[0]):
        x, y, z = bearings[n, 0], bearings[n, 1], bearings[n, 2]
        ax, ay, az, bx, by, bz = tangent_basis(x, y, z)
        for i in range(STORED):
            q = (i - STORED / 2 + 0.5) * step
            for j in range(STORED):
                p = (j - STORED / 2 + 0.5) * step
                rx, ry, rz = x + p * ax + q * bx, y + p * ay + q * by, z + p * az + q * bz
                f, _ = _best_face(R_fc, rx, ry, rz)
                u, v = _to_face(R_fc, K, f, rx, ry, rz)
                out[n, level, i, j] = _bilinear(image[f], u * scale, v * scale)


def cut_templates(
    pyramid: list[NDArray[np.uint8]],
    R_fc: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    bearings: NDArray[np.float64],
    focal: float,
) -> NDArray[np.float32]:
    """Templates (N, levels, 16, 16) around unit bearings (N, 3). A template pixel is 2^level / focal radians."""
    out = np.zeros((len(bearings), len(pyramid), STORED, STORED), np.float32)
    for level, image in enumerate(pyramid):
        _cut_level(image, level, R_fc, intrinsics, bearings, 1.0 / focal, out)
    return out


@njit(cache=True, fastmath=True)
def _shift(image, template, gx, gy, inv, offset, u, v, limit):  # type: ignore[no-untyped-def]
    """Gauss-Newton for the shift of one window. Returns u, v and whether they stayed within the limit."""
    u0, v0 = u, v
    h, w = image.shape
    for _ in range(12):
        if u < _HALF or v < _HALF or u > w - _HALF - 1 or v > h - _HALF - 1:
            return u, v, False
        b0, b1, b2 = 0.0, 0.0, 0.0
        # All samples have the same subpixel position, so the bilinear weights are computed once.
        x, y = u - _HALF, v - _HALF  # the first sample's centre as an index
        j0, i0 = int(x), int(y)
        a, b = x - j0, y - i0
        w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
        for i in range(WINDOW):
            upper, lower = image[i0 + i], image[i0 + i + 1]
            for j in range(WINDOW):
                value = w00 * upper[j0 + j] + w01 * upper[j0 + j + 1] + w10 * lower[j0 + j] + w11 * lower[j0 + j + 1]
                e = value - template[i, j] + offset
                b0 += gx[i, j] * e
                b1 += gy[i, j] * e
                b2 += e
        du = inv[0, 0] * b0 + inv[0, 1] * b1 + inv[0, 2] * b2
        dv = inv[1, 0] * b0 + inv[1, 1] * b1 + inv[1, 2] * b2
        dm = inv[2, 0] * b0 + inv[2, 1] * b1 + inv[2, 2] * b2
        u -= du
        v -= dv
        offset -= dm
        if abs(u - u0) > limit or abs(v - v0) > limit:
            return u, v, False
        if du * du + dv * dv < 1e-4:
            break
    return u, v, True


@njit(cache=True)
def _through_plane(R, t, rho, R_f, K, u, v, step, pixel, m, M, H):  # type: ignore[no-untyped-def]
    """Write the homography H (3, 3) from a face's pixels about (u, v) to a template's about its middle.

    It leads through the plane on which the template lies. R, t, rho: the motion from the anchor, and the inverse
    distance there. step: side of a template's pixel, radians. pixel: side of a face's, at distance 1. m (3,): the
    template's bearing. M (3, 3): scratch.
    """
    ax, ay, az, cx, cy, cz = tangent_basis(m[0], m[1], m[2])
    for r in range(3):  # its columns: the plane's two directions and its point, in the face's axes
        M[r, 0] = M[r, 1] = M[r, 2] = 0.0
        for k in range(3):
            M[r, 0] += R_f[r, k] * step * (R[k, 0] * ax + R[k, 1] * ay + R[k, 2] * az)
            M[r, 1] += R_f[r, k] * step * (R[k, 0] * cx + R[k, 1] * cy + R[k, 2] * cz)
            M[r, 2] += R_f[r, k] * (R[k, 0] * m[0] + R[k, 1] * m[1] + R[k, 2] * m[2] + rho * t[k])
    x, y = (u - K[2]) / K[0], (v - K[3]) / K[1]
    for r in range(3):  # the adjugate of M is its inverse but for a factor
        i, j = (r + 1) % 3, (r + 2) % 3
        e0 = M[1, i] * M[2, j] - M[2, i] * M[1, j]
        e1 = M[2, i] * M[0, j] - M[0, i] * M[2, j]
        e2 = M[0, i] * M[1, j] - M[1, i] * M[0, j]
        H[r, 0], H[r, 1], H[r, 2] = pixel * e0, pixel * e1, e0 * x + e1 * y + e2


@njit(cache=True, fastmath=True)
def _window_through(stored, H, template, gx, gy, inv, big):  # type: ignore[no-untyped-def]
    """As ``_window``, warped by the homography H (3, 3) of ``_through_plane``."""
    for i in range(WINDOW + 2):
        dv = i - _HALF - 0.5
        for j in range(WINDOW + 2):
            du = j - _HALF - 0.5
            w = 1.0 / (H[2, 0] * du + H[2, 1] * dv + H[2, 2])
            p = w * (H[0, 0] * du + H[0, 1] * dv + H[0, 2])
            q = w * (H[1, 0] * du + H[1, 1] * dv + H[1, 2])
            big[i, j] = _bilinear(stored, p + STORED / 2, q + STORED / 2)
    return _prepare(template, gx, gy, inv, big)


@njit(cache=True, fastmath=True)
def _window(stored, A_inv, template, gx, gy, inv, big):  # type: ignore[no-untyped-def]
    """Write the template as the current face sees it, its gradients and inverse Hessian. False without texture."""
    for i in range(WINDOW + 2):
        dv = i - _HALF - 0.5
        for j in range(WINDOW + 2):
            du = j - _HALF - 0.5
            p = A_inv[0, 0] * du + A_inv[0, 1] * dv
            q = A_inv[1, 0] * du + A_inv[1, 1] * dv
            big[i, j] = _bilinear(stored, p + STORED / 2, q + STORED / 2)
    return _prepare(template, gx, gy, inv, big)


@njit(cache=True, fastmath=True)
def _prepare(template, gx, gy, inv, big):  # type: ignore[no-untyped-def]
    """The window, its gradients and inverse Hessian, from the warped template ``big``, a pixel larger on every side."""
    h00, h01, h11, s0, s1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(WINDOW):
        for j in range(WINDOW):
            template[i, j] = big[i + 1, j + 1]
            x = 0.5 * (big[i + 1, j + 2] - big[i + 1, j])
            y = 0.5 * (big[i + 2, j + 1] - big[i, j + 1])
            gx[i, j], gy[i, j] = x, y
            h00 += x * x
            h01 += x * y
            h11 += y * y
            s0 += x
            s1 += y
    n = float(WINDOW * WINDOW)
    # The inverse of the 3x3 Hessian by blocks, from the Schur complement of the intensity offset.
    a, b, c = h00 - s0 * s0 / n, h01 - s0 * s1 / n, h11 - s1 * s1 / n
    det = a * c - b * b
    trace = a + c
    if trace <= 0 or det <= 0:
        return False
    smallest = 0.5 * (trace - math.sqrt(max(0.0, trace * trace - 4 * det)))
    if smallest < 1.0 * n:  # mean squared gradient in the weakest direction: one grey level per pixel
        return False
    i00, i01, i11 = c / det, -b / det, a / det
    inv[0, 0], inv[0, 1], inv[1, 0], inv[1, 1] = i00, i01, i01, i11
    k0, k1 = -(i00 * s0 + i01 * s1) / n, -(i01 * s0 + i11 * s1) / n
    inv[0, 2], inv[2, 0], inv[1, 2], inv[2, 1] = k0, k0, k1, k1
    inv[2, 2] = 1.0 / n - (k0 * s0 + k1 * s1) / n
    return True


@njit(cache=True, fastmath=True)
def _zncc(image, template, u, v):  # type: ignore[no-untyped-def]
    """Zero-mean normalised cross-correlation of a template with the window around (u, v), inside the image."""
    h, w = image.shape
    x, y = min(u - _HALF, w - WINDOW - 1.0), min(v - _HALF, h - WINDOW - 1.0)
    j0, i0 = int(x), int(y)
    c, d = x - j0, y - i0
    w00, w01, w10, w11 = (1 - c) * (1 - d), c * (1 - d), (1 - c) * d, c * d
    sa, sb, saa, sbb, sab = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(WINDOW):
        upper, lower = image[i0 + i], image[i0 + i + 1]
        for j in range(WINDOW):
            a = template[i, j]
            b = w00 * upper[j0 + j] + w01 * upper[j0 + j + 1] + w10 * lower[j0 + j] + w11 * lower[j0 + j + 1]
            sa += a
            sb += b
            saa += a * a
            sbb += b * b
            sab += a * b
    n = WINDOW * WINDOW
    va, vb = saa - sa * sa / n, sbb - sb * sb / n
    if va <= 1e-6 or vb <= 1e-6:
        return 0.0
    return (sab - sa * sb / n) / math.sqrt(va * vb)


@njit(cache=True, nogil=True)
def _align_level(  # type: ignore[no-untyped-def]
    image, valid, level, R_fc, K, focal, stored, anchors, rho, R_ca, t_ca, which, bearings, ok, score, limit, exact
):
    scale = 1.0 / (1 << level)
    h, w = image.shape[1], image.shape[2]
    A, A_inv, X, P = np.empty((2, 2)), np.empty((2, 2)), np.empty(3), np.empty((3, 2))
    template, gx, gy = np.empty((WINDOW, WINDOW)), np.empty((WINDOW, WINDOW)), np.empty((WINDOW, WINDOW))
    inv, big = np.empty((3, 3)), np.empty((WINDOW + 2, WINDOW + 2))
    M, H = np.empty((3, 3)), np.empty((3, 3))
    for n in range(anchors.shape[0]):
        if not ok[n]:
            continue
        ok[n] = False
        bx, by, bz = bearings[n, 0], bearings[n, 1], bearings[n, 2]
        f, cosine = _best_face(R_fc, bx, by, bz)
        if cosine < 0.1:
            continue
        u, v = _to_face(R_fc, K, f, bx, by, bz)
        if u < 1 or v < 1 or u > valid.shape[2] - 1 or v > valid.shape[1] - 1 or not valid[f, int(v), int(u)]:
            continue
        # Derivative of the face's pixel by the template's tangent coordinates, at the predicted position.
        mx, my, mz = anchors[n, 0], anchors[n, 1], anchors[n, 2]
        ax, ay, az, cx, cy, cz = tangent_basis(mx, my, mz)
        k = which[n]
        step = (1 << level) / focal
        for corner in range(3):
            p = step if corner == 1 else 0.0
            q = step if corner == 2 else 0.0
            rx, ry, rz = mx + p * ax + q * cx, my + p * ay + q * cy, mz + p * az + q * cz
            for r in range(3):
                X[r] = R_ca[k, r, 0] * rx + R_ca[k, r, 1] * ry + R_ca[k, r, 2] * rz + rho[n] * t_ca[k, r]
            P[corner, 0], P[corner, 1] = _to_face(R_fc, K, f, X[0], X[1], X[2])
        if P[0, 0] < -1e5 or P[1, 0] < -1e5 or P[2, 0] < -1e5:
            continue
        for corner in range(2):
            A[0, corner] = (P[corner + 1, 0] - P[0, 0]) * scale
            A[1, corner] = (P[corner + 1, 1] - P[0, 1]) * scale
        det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        if det < 0.2 or det > 6.0:
            continue
        A_inv[0, 0], A_inv[0, 1] = A[1, 1] / det, -A[0, 1] / det
        A_inv[1, 0], A_inv[1, 1] = -A[1, 0] / det, A[0, 0] / det
        if exact:
            pixel = (1 << level) / K[0]
            _through_plane(R_ca[k], t_ca[k], rho[n], R_fc[f], K, P[0, 0], P[0, 1], step, pixel, anchors[n], M, H)
            if not _window_through(stored[n], H, template, gx, gy, inv, big):
                continue
        elif not _window(stored[n], A_inv, template, gx, gy, inv, big):
            continue
        u, v, good = _shift(image[f], template, gx, gy, inv, 0.0, u * scale, v * scale, limit)
        if not good or u < _HALF or v < _HALF or u > w - _HALF or v > h - _HALF:
            continue
        score[n] = _zncc(image[f], template, u, v)
        u, v = u / scale, v / scale
        dx, dy = (u - K[2]) / K[0], (v - K[3]) / K[1]
        norm = math.sqrt(dx * dx + dy * dy + 1.0)
        for c in range(3):
            bearings[n, c] = (R_fc[f, 0, c] * dx + R_fc[f, 1, c] * dy + R_fc[f, 2, c]) / norm
        ok[n] = True


def align_level(
    pool: Executor | None,
    image: NDArray[np.uint8],
    valid: NDArray[np.bool_],
    level: int,
    R_fc: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    focal: float,
    stored: NDArray[np.float32],
    anchors: NDArray[np.float64],
    rho: NDArray[np.float64],
    motion: NDArray[np.float64],
    which: NDArray[np.int64],
    bearings: NDArray[np.float64],
    ok: NDArray[np.bool_],
    limit: float,
    exact: bool = False,
) -> NDArray[np.float64]:
    """Align N templates on one pyramid level: updates bearings (N, 3) and ok (N,) in place, returns the ZNCC (N,).

    image (F, H, W): the level's faces. valid (F, H0, W0): of level 0. stored (N, 16, 16): the level's templates.
    anchors (N, 3): their bearings in the anchor keyframes. rho (N,): inverse distances there. motion (K, 4, 4): from
    each anchor keyframe to the current camera; which (N,) says each point's keyframe. bearings: the prediction on
    input, the measurement on output. limit: largest shift in this level's pixels. exact: warp templates by the
    homography of their planes, not by its linear part, which is off by some hundredths of a pixel away from a face's
    middle. The two halves of the points run in parallel on ``pool``.
    """
    score = np.zeros(len(anchors))
    R, t = np.ascontiguousarray(motion[:, :3, :3]), np.ascontiguousarray(motion[:, :3, 3])

    kernel: Any = _align_level

    def part(s: slice) -> None:
        per_point: list[Any] = [a[s] for a in (stored, anchors, rho)]
        results: list[Any] = [a[s] for a in (which, bearings, ok, score)]
        kernel(image, valid, level, R_fc, intrinsics, focal, *per_point, R, t, *results, limit, exact)

    n = len(anchors)
    if pool is None or n < 100:
        part(slice(0, n))
    else:
        list(pool.map(part, (slice(0, n // 2), slice(n // 2, n))))
    return score
