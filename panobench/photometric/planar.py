"""A filter of depth maps with the prior that rooms are piecewise planar.

On a plane n.X = c the inverse radial depth is linear in the ray, 1 / d = (n / c).r, whatever the camera. Each pixel is
therefore replaced by a least-squares fit of that form to its neighbours, weighted by how well their own depth is
determined and by similarity of luma and of depth: a bilateral filter that fits planes instead of constants.
"""

from __future__ import annotations

import numpy as np

from panobench.kernels.jit import JIT, JIT_FINITE, PARALLEL, njit, prange
from panobench.photometric.lens_centres import moved_origin
from panobench.photometric.warp import sample, to_pixel

#: exp(-z) is negligible from here.
_Z_MAX = np.float32(12)
_E1, _E2, _E3 = np.float32(1), np.float32(1 / 2), np.float32(1 / 6)
_E4, _E5, _E6 = np.float32(1 / 24), np.float32(1 / 120), np.float32(1 / 720)
# Offsets in a row's table, in units of its width: information and ray; inverse depth and luma are at 0 and 1.
_U = tuple(np.uint64(k) for k in range(9))
_INFORMATION, _RAY = _U[2], _U[3:6]


@njit(**PARALLEL)
def depth_information(reference, depth, rays, frames, R, t, code, cam, out):  # type: ignore[no-untyped-def]
    """Write out (H, W), the sum over frames of (dI / d log depth)^2: how well the images determine the depth (H, W).

    The other arguments are as in ``sweep.reprojection_error``.
    """
    h, w = reference.shape
    step = np.float32(0.03)
    for y in prange(h):
        for x in range(w):
            total = np.float32(0.0)
            for f in range(frames.shape[0]):
                a, b = np.float32(np.nan), np.float32(np.nan)
                for side in range(2):
                    d = depth[y, x] * (np.float32(1) + step if side else np.float32(1) - step)
                    px = d * (R[f, 0, 0] * rays[y, x, 0] + R[f, 0, 1] * rays[y, x, 1] + R[f, 0, 2] * rays[y, x, 2])
                    py = d * (R[f, 1, 0] * rays[y, x, 0] + R[f, 1, 1] * rays[y, x, 1] + R[f, 1, 2] * rays[y, x, 2])
                    pz = d * (R[f, 2, 0] * rays[y, x, 0] + R[f, 2, 1] * rays[y, x, 1] + R[f, 2, 2] * rays[y, x, 2])
                    if cam.ndim == 2:
                        tx, ty, tz = moved_origin(R[f], t[f], rays[y, x, 0], rays[y, x, 1], rays[y, x, 2], cam)
                        u, v, ok = to_pixel(px + tx, py + ty, pz + tz, code, cam)
                    else:
                        u, v, ok = to_pixel(px + t[f, 0], py + t[f, 1], pz + t[f, 2], code, cam)
                    value = sample(frames[f], u, v, code) if ok else np.float32(np.nan)
                    if side:
                        b = value
                    else:
                        a = value
                g = (b - a) / (2 * step)
                if g == g:
                    total += g * g
            out[y, x] = total


@njit(**JIT_FINITE)
def _gather_run(first, count, shift, w, here, there, by_luma, by_depth, sums):  # type: ignore[no-untyped-def]
    """Add the neighbours ``shift`` columns further on in row ``there`` to the sums of ``count`` pixels of row ``here``.

    here, there (6 w,): inverse depth, luma, information and ray (3) of the rows' pixels. sums (9 w,): the normal
    equations N a = b, upper triangle and b. Flat arrays and unsigned indices let LLVM vectorise this.
    """
    for j in range(count):
        x = first + j
        p = x + shift
        rho = there[p]
        e = (rho / here[x] - _E1) * by_depth
        # exp(-z) as the 16th power of a Taylor polynomial: exact to 1e-5 where it is not negligible.
        z = min(abs(there[p + w] - here[x + w]) * by_luma + e * e, _Z_MAX)
        q = z * np.float32(1 / 16)
        k = _E1 - q * (_E1 - q * (_E2 - q * (_E3 - q * (_E4 - q * (_E5 - q * _E6)))))
        k = k * k
        k = k * k
        k = k * k
        k = k * k * there[p + w * _INFORMATION]
        k = k if z < _Z_MAX else np.float32(0)
        r0, r1, r2 = there[p + w * _RAY[0]], there[p + w * _RAY[1]], there[p + w * _RAY[2]]
        k0, k1, k2 = k * r0, k * r1, k * r2
        sums[x] += k0 * r0
        sums[x + w] += k0 * r1
        sums[x + w * _U[2]] += k0 * r2
        sums[x + w * _U[3]] += k1 * r1
        sums[x + w * _U[4]] += k1 * r2
        sums[x + w * _U[5]] += k2 * r2
        sums[x + w * _U[6]] += k0 * rho
        sums[x + w * _U[7]] += k1 * rho
        sums[x + w * _U[8]] += k2 * rho


@njit(**JIT)
def _solve(n, rho, r0, r1, r2):  # type: ignore[no-untyped-def]
    """Inverse depth a.r at ray r of the plane that solves the normal equations N a = b in n (9,); rho: that before."""
    n00, n01, n02, n11, n12, n22 = float(n[0]), float(n[1]), float(n[2]), float(n[3]), float(n[4]), float(n[5])
    # A weak prior of constant depth around this ray keeps the 3 x 3 system solvable.
    ridge = 1e-6 * (n00 + n11 + n22) + 1e-9
    n00, n11, n22 = n00 + ridge, n11 + ridge, n22 + ridge
    b0, b1, b2 = n[6] + ridge * rho * r0, n[7] + ridge * rho * r1, n[8] + ridge * rho * r2
    c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
    det = n00 * c00 + n01 * c01 + n02 * c02
    c11, c12, c22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
    a0 = (c00 * b0 + c01 * b1 + c02 * b2) / det
    a1 = (c01 * b0 + c11 * b1 + c12 * b2) / det
    a2 = (c02 * b0 + c12 * b1 + c22 * b2) / det
    return a0 * r0 + a1 * r1 + a2 * r2


@njit(**PARALLEL)
def planar_filter(depth, information, luma, rays, radius, stride, sigma_luma, sigma_depth, floor, wrap, out):  # type: ignore[no-untyped-def]
    """Fit 1 / d = a.r around each pixel of a depth map (H, W), and evaluate it there, out (H, W).

    information (H, W): weights, see ``depth_information``. luma (H, W), rays (H, W, 3): all inputs are finite. radius,
    stride: of the neighbours, in pixels; in panoramas columns are widened by 1 / cos(latitude). sigma_luma (of 1) and
    sigma_depth (relative): of the bilateral weights. floor: added to the information. wrap: columns wrap.
    """
    h, w = depth.shape
    by_luma, by_depth = np.float32(1 / sigma_luma), np.float32(1 / sigma_depth)
    table = np.empty((h, 6 * w), np.float32)
    for y in prange(h):
        for x in range(w):
            table[y, x], table[y, x + w] = np.float32(1) / depth[y, x], luma[y, x]
            table[y, x + 2 * w] = information[y, x] + np.float32(floor)
            for c in range(3):
                table[y, x + (3 + c) * w] = rays[y, x, c]
    for y in prange(h):
        shrink = 1.0
        if wrap:
            shrink = max(np.cos((0.5 - (y + 0.5) / h) * np.pi), 0.1)
        reach_x = min(int(radius / shrink), w // 4)
        step_x = max(int(stride / shrink), 1)
        sums, here, u_w = np.zeros(9 * w, np.float32), table[y], np.uint64(w)
        for j in range(-radius, radius + 1, stride):
            q = y + j
            if q < 0 or q >= h:
                continue
            for i in range(-(reach_x // step_x) * step_x, reach_x + 1, step_x):
                lo, hi = max(-i, 0), min(w - i, w)
                # Indices are unsigned: a negative shift wraps around, so that adding it subtracts.
                inside = np.uint64(hi - lo)
                _gather_run(np.uint64(lo), inside, np.uint64(i), u_w, here, table[q], by_luma, by_depth, sums)
                if wrap and lo > 0:
                    _gather_run(_U[0], np.uint64(lo), np.uint64(i + w), u_w, here, table[q], by_luma, by_depth, sums)
                if wrap and hi < w:
                    _gather_run(
                        np.uint64(hi), np.uint64(w - hi), np.uint64(i - w), u_w, here, table[q], by_luma, by_depth, sums
                    )
        n = np.empty(9)
        for x in range(w):
            rho = here[x]
            for k in range(9):
                n[k] = sums[x + k * w]
            fit = _solve(n, rho, rays[y, x, 0], rays[y, x, 1], rays[y, x, 2])
            good = fit > 0.3 * rho and fit < 3.0 * rho
            out[y, x] = np.float32(1.0 / fit) if good else depth[y, x]
