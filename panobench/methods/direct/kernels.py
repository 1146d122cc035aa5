"""Numba kernels of ``direct``: the photometric residual of a small pixel pattern, and its normal equations.

A point is a bearing m and an inverse distance rho in its host keyframe. A pixel of its pattern is the ray r = m + d in
the tangent plane. In a target camera it lies along Y = R r + rho t, where (R, t) takes host to target coordinates; at
infinity rho = 0. The residual is I_target(Y) - (1 + gain) I_host - offset. Pattern, Huber and gradient weights are
those of Engel, Koltun, Cremers, "Direct Sparse Odometry" (PAMI 2018), used on the sphere as in Huang & Yeung, 360VO
(ICRA 2022).
"""

from __future__ import annotations

import math

import numpy as np

from panobench.kernels.jit import njit
from panobench.methods.sparse.patches import _best_face, _to_face, tangent_basis

#: Offsets of the eight pixels of the pattern.
PATTERN = np.array([[0, -2], [-1, -1], [1, -1], [-2, 0], [0, 0], [2, 0], [-1, 1], [0, 2]], dtype=np.float64)
SIZE = len(PATTERN)
#: Number of unknowns of a target frame: translation, rotation, gain, offset.
FRAME = 8


@njit(cache=True)
def _sample(image, u, v, out):  # type: ignore[no-untyped-def]
    """Write the interpolated value and gradient (central differences) to out (3,). False near the border."""
    h, w = image.shape
    x, y = u - 0.5, v - 0.5
    j, i = int(x), int(y)
    if x < 1 or y < 1 or j > w - 3 or i > h - 3:
        return False
    a, b = x - j, y - i
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    p00, p01 = float(image[i, j]), float(image[i, j + 1])
    p10, p11 = float(image[i + 1, j]), float(image[i + 1, j + 1])
    out[0] = w00 * p00 + w01 * p01 + w10 * p10 + w11 * p11
    out[1] = 0.5 * (
        w00 * (p01 - image[i, j - 1])
        + w01 * (image[i, j + 2] - p00)
        + w10 * (p11 - image[i + 1, j - 1])
        + w11 * (image[i + 1, j + 2] - p10)
    )
    out[2] = 0.5 * (
        w00 * (p10 - image[i - 1, j])
        + w01 * (p11 - image[i - 1, j + 1])
        + w10 * (image[i + 2, j] - p00)
        + w11 * (image[i + 2, j + 1] - p01)
    )
    return True


@njit(cache=True)
def _pattern_residual(  # type: ignore[no-untyped-def]
    image,
    valid,
    scale,
    R_fc,
    K,
    R,
    t,
    m,
    rho,
    colour,
    gain,
    offset,
    pitch,
    pattern,
    softening,
    huber,
    res,
    J,
    Jr,
    weight,
):
    """Write residuals (8,), their derivatives J (8, 8) by the target's unknowns and Jr (8,) by rho, and weights (8,).

    Returns the robust energy, or -1 if the pattern is not in view. scale: size of this level relative to the full one.
    pitch: angle of one of its pixels, radians.
    """
    x = R[0, 0] * m[0] + R[0, 1] * m[1] + R[0, 2] * m[2] + rho * t[0]
    y = R[1, 0] * m[0] + R[1, 1] * m[1] + R[1, 2] * m[2] + rho * t[1]
    z = R[2, 0] * m[0] + R[2, 1] * m[1] + R[2, 2] * m[2] + rho * t[2]
    norm = math.sqrt(x * x + y * y + z * z)
    f, cosine = _best_face(R_fc, x, y, z)
    if cosine < 0.1 * norm:
        return -1.0
    u, v = _to_face(R_fc, K, f, x, y, z)
    h, w = valid.shape[1], valid.shape[2]
    if u < 1 or v < 1 or u > w - 1 or v > h - 1 or not valid[f, int(v), int(u)]:
        return -1.0
    ax, ay, az, bx, by, bz = tangent_basis(m[0], m[1], m[2])
    pixel = np.empty(3)
    energy = 0.0
    fx, fy = K[0] * scale, K[1] * scale
    F = R_fc[f]
    for n in range(pattern.shape[0]):
        p, q = pattern[n, 0] * pitch, pattern[n, 1] * pitch
        r0, r1, r2 = m[0] + p * ax + q * bx, m[1] + p * ay + q * by, m[2] + p * az + q * bz
        x = R[0, 0] * r0 + R[0, 1] * r1 + R[0, 2] * r2 + rho * t[0]
        y = R[1, 0] * r0 + R[1, 1] * r1 + R[1, 2] * r2 + rho * t[1]
        z = R[2, 0] * r0 + R[2, 1] * r1 + R[2, 2] * r2 + rho * t[2]
        px = F[0, 0] * x + F[0, 1] * y + F[0, 2] * z
        py = F[1, 0] * x + F[1, 1] * y + F[1, 2] * z
        pz = F[2, 0] * x + F[2, 1] * y + F[2, 2] * z
        if pz < 1e-6:
            return -1.0
        if not _sample(image[f], fx * px / pz + K[2] * scale, fy * py / pz + K[3] * scale, pixel):
            return -1.0
        e = pixel[0] - (1.0 + gain) * colour[n] - offset
        a, b = pixel[1] * fx / pz, pixel[2] * fy / pz
        c = -(a * px + b * py) / pz
        g0 = F[0, 0] * a + F[1, 0] * b + F[2, 0] * c
        g1 = F[0, 1] * a + F[1, 1] * b + F[2, 1] * c
        g2 = F[0, 2] * a + F[1, 2] * b + F[2, 2] * c
        s = softening * softening / (softening * softening + pixel[1] * pixel[1] + pixel[2] * pixel[2])
        size = abs(e)
        energy += s * (e * e if size < huber else 2 * huber * size - huber * huber)
        res[n] = e
        weight[n] = s if size < huber else s * huber / size
        J[n, 0], J[n, 1], J[n, 2] = rho * g0, rho * g1, rho * g2
        J[n, 3], J[n, 4], J[n, 5] = y * g2 - z * g1, z * g0 - x * g2, x * g1 - y * g0
        J[n, 6], J[n, 7] = -colour[n], -1.0
        Jr[n] = g0 * t[0] + g1 * t[1] + g2 * t[2]
    return energy


@njit(cache=True, nogil=True)
def cut_colours(image, R_fc, K, scale, bearings, pitch, pattern, out):  # type: ignore[no-untyped-def]
    """Write the pattern's intensities on one level around bearings (N, 3) to out (N, 8); NaN at a border."""
    pixel = np.empty(3)
    for n in range(len(bearings)):
        m = bearings[n]
        ax, ay, az, bx, by, bz = tangent_basis(m[0], m[1], m[2])
        f, _ = _best_face(R_fc, m[0], m[1], m[2])
        for k in range(pattern.shape[0]):
            p, q = pattern[k, 0] * pitch, pattern[k, 1] * pitch
            u, v = _to_face(R_fc, K, f, m[0] + p * ax + q * bx, m[1] + p * ay + q * by, m[2] + p * az + q * bz)
            out[n, k] = pixel[0] if _sample(image[f], u * scale, v * scale, pixel) else np.nan


@njit(cache=True, nogil=True)
def frame_system(  # type: ignore[no-untyped-def]
    image,
    valid,
    scale,
    R_fc,
    K,
    R,
    t,
    host,
    bearings,
    rho,
    colours,
    affine,
    pitch,
    pattern,
    softening,
    huber,
    cut,
    H,
    g,
):
    """Normal equations of one frame against the window's points: adds to H (8, 8) and g (8,).

    R, t (K, 3, 3), (K, 3): from host keyframe to frame. affine (K, 2): gain and offset from host to frame. Returns the
    energy, in which outliers count as ``cut``, how many patterns are in view, and how many are no outliers.
    """
    res, J, Jr, weight = np.empty(SIZE), np.empty((SIZE, FRAME)), np.empty(SIZE), np.empty(SIZE)
    energy, seen, used = 0.0, 0, 0
    for n in range(len(bearings)):
        k = host[n]
        e = _pattern_residual(
            image, valid, scale, R_fc, K, R[k], t[k], bearings[n], rho[n], colours[n], affine[k, 0], affine[k, 1],
            pitch, pattern, softening, huber, res, J, Jr, weight,
        )  # fmt: skip
        if not e >= 0:
            continue
        seen += 1
        if e > cut:
            energy += cut
            continue
        used += 1
        energy += e
        for i in range(SIZE):
            for r in range(FRAME):
                a = weight[i] * J[i, r]
                g[r] += a * res[i]
                for c in range(FRAME):
                    H[r, c] += a * J[i, c]
    return energy, seen, used


@njit(cache=True, nogil=True)
def window_system(  # type: ignore[no-untyped-def]
    images, valid, R_fc, K, R, t, host, bearings, rho, colours, affine, pitch, pattern, softening, huber, cut,
    H, g, Htr, Hrr, gr, good,
):  # fmt: skip
    """Normal equations of all points in all other keyframes of the window. Returns the energy.

    images (K, F, H, W). R, t (K, K, 3, 3), (K, K, 3): [target, host], from host to target. affine (K, K, 2). Adds to
    H (K, K, 8, 8) and g (K, K, 8), for each pair of target and host by the target's unknowns; to Htr (N, K, 8),
    Hrr (N,) and gr (N,), for each point; and to good (N,), the number of targets in which a point is an inlier.
    """
    res, J, Jr, weight = np.empty(SIZE), np.empty((SIZE, FRAME)), np.empty(SIZE), np.empty(SIZE)
    energy = 0.0
    for n in range(len(bearings)):
        h = host[n]
        for k in range(len(images)):
            if k == h:
                continue
            e = _pattern_residual(
                images[k], valid, 1.0, R_fc, K, R[k, h], t[k, h], bearings[n], rho[n], colours[n], affine[k, h, 0],
                affine[k, h, 1], pitch, pattern, softening, huber, res, J, Jr, weight,
            )  # fmt: skip
            if not e >= 0:
                continue
            if e > cut:
                energy += cut
                continue
            good[n] += 1
            energy += e
            block, vector = H[k, h], g[k, h]
            for i in range(SIZE):
                b = weight[i] * Jr[i]
                Hrr[n] += b * Jr[i]
                gr[n] += b * res[i]
                for r in range(FRAME):
                    a = weight[i] * J[i, r]
                    vector[r] += a * res[i]
                    Htr[n, k, r] += b * J[i, r]
                    for c in range(r, FRAME):
                        block[r, c] += a * J[i, c]
    return energy


@njit(cache=True, nogil=True)
def trace(  # type: ignore[no-untyped-def]
    image, valid, R_fc, K, R, t, host, bearings, colours, affine, low, high, focal, pattern, softening, huber, cut,
    rho, sigma, status,
):  # fmt: skip
    """Search each candidate's inverse distance between low and high (N,) along its epipolar curve.

    Writes rho, sigma (N,) and status (N,): 1 found, 0 too little parallax here, -1 no match or an ambiguous one.
    """
    res, J, Jr, weight = np.empty(SIZE), np.empty((SIZE, FRAME)), np.empty(SIZE), np.empty(SIZE)
    energies = np.empty(129)
    pitch = 1.0 / focal
    for n in range(len(bearings)):
        k = host[n]
        status[n] = 0
        m = bearings[n]
        ends = np.empty((2, 3))
        for side in range(2):
            r = low[n] if side == 0 else high[n]
            length = 0.0
            for c in range(3):
                ends[side, c] = R[k, c, 0] * m[0] + R[k, c, 1] * m[1] + R[k, c, 2] * m[2] + r * t[k, c]
                length += ends[side, c] ** 2
            length = math.sqrt(length)
            for c in range(3):
                ends[side, c] /= length
        chord = 0.0
        for c in range(3):
            chord += (ends[0, c] - ends[1, c]) ** 2
        travel = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(chord))) * focal
        if travel < 1.0:
            continue
        steps = min(128, max(4, int(1.5 * travel)))
        best, at = 1e30, -1
        for s in range(steps + 1):
            r = low[n] + (high[n] - low[n]) * s / steps
            e = _pattern_residual(
                image, valid, 1.0, R_fc, K, R[k], t[k], m, r, colours[n], affine[k, 0],
                affine[k, 1], pitch, pattern, softening, huber, res, J, Jr, weight,
            )  # fmt: skip
            energies[s] = e if e >= 0 else 1e30
            if energies[s] < best:
                best, at = energies[s], s
        status[n] = -1
        if at < 0 or best > 1.5 * cut:
            continue
        second = 1e30
        apart = max(2, int(3.0 * steps / travel))
        for s in range(steps + 1):
            if abs(s - at) > apart and energies[s] < second:
                second = energies[s]
        if best > 0.7 * second:
            continue
        r = low[n] + (high[n] - low[n]) * at / steps
        step = (high[n] - low[n]) / steps
        information = 0.0
        for _ in range(4):
            e = _pattern_residual(
                image, valid, 1.0, R_fc, K, R[k], t[k], m, r, colours[n], affine[k, 0],
                affine[k, 1], pitch, pattern, softening, huber, res, J, Jr, weight,
            )  # fmt: skip
            if not e >= 0:
                break
            information, slope = 1e-12, 0.0
            for i in range(SIZE):
                information += weight[i] * Jr[i] * Jr[i]
                slope += weight[i] * Jr[i] * res[i]
            move = -slope / information
            r += min(max(move, -step), step)
        if information <= 1e-12 or not e >= 0 or e > cut:
            continue
        rho[n] = r
        # Noise of four grey levels, and at least a third of a pixel along the curve.
        sigma[n] = math.sqrt(16.0 / information + (0.33 * (high[n] - low[n]) / travel) ** 2)
        status[n] = 1
