"""Smoothing a depth map with the prior that rooms are piecewise planar.

On a plane n.X = c the inverse radial depth is linear in the ray, 1/d = (n/c).r, whatever the camera. So every pixel is
replaced by a least-squares fit of that form to its neighbours, weighted by how well their own depth is determined,
by similarity of brightness and of depth (a bilateral filter with planes for constants).
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from panobench.photometric.warp import sample, to_pixel
from panobench.splat.kernel_options import PARALLEL


@njit(**PARALLEL)
def depth_information(reference, depth, rays, frames, R, t, code, cam, out):  # type: ignore[no-untyped-def]
    """Sum over frames of (dI / d log depth)^2 at the current depth (H, W): how firmly the images fix it."""
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


@njit(**PARALLEL)
def planar_filter(depth, information, luma, rays, radius, stride, sigma_luma, sigma_depth, floor, wrap, out):  # type: ignore[no-untyped-def]
    """Fit 1/d = a.r around every pixel and evaluate it there. (H, W) -> out (H, W).

    radius in pixels (of the equator: columns are widened by 1 / cos latitude), every ``stride``-th neighbour;
    sigma_luma absolute, sigma_depth relative; floor: least weight, in units of information.
    """
    h, w = depth.shape
    for y in prange(h):
        c = 1.0
        if wrap:
            c = max(np.cos((0.5 - (y + 0.5) / h) * np.pi), 0.1)
        reach_x = min(int(radius / c), w // 4)
        step_x = max(int(stride / c), 1)
        for x in range(w):
            rho = 1.0 / depth[y, x]
            n00, n01, n02, n11, n12, n22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            b0, b1, b2 = 0.0, 0.0, 0.0
            for j in range(-radius, radius + 1, stride):
                q = y + j
                if q < 0 or q >= h:
                    continue
                for i in range(-(reach_x // step_x) * step_x, reach_x + 1, step_x):
                    p = x + i
                    if wrap:
                        p = p % w
                    elif p < 0 or p >= w:
                        continue
                    d = depth[q, p]
                    dl = luma[q, p] - luma[y, x]
                    e = (1.0 / d) / rho - 1.0
                    k = (information[q, p] + floor) * np.exp(
                        -abs(dl) / sigma_luma - (e / sigma_depth) * (e / sigma_depth)
                    )
                    if not k > 0:
                        continue
                    r0, r1, r2 = rays[q, p, 0], rays[q, p, 1], rays[q, p, 2]
                    n00 += k * r0 * r0
                    n01 += k * r0 * r1
                    n02 += k * r0 * r2
                    n11 += k * r1 * r1
                    n12 += k * r1 * r2
                    n22 += k * r2 * r2
                    b0 += k * r0 / d
                    b1 += k * r1 / d
                    b2 += k * r2 / d
            # A pull towards "constant depth around this ray" keeps the 3x3 system solvable.
            r0, r1, r2 = rays[y, x, 0], rays[y, x, 1], rays[y, x, 2]
            ridge = 1e-6 * (n00 + n11 + n22) + 1e-9
            n00 += ridge
            n11 += ridge
            n22 += ridge
            b0 += ridge * rho * r0
            b1 += ridge * rho * r1
            b2 += ridge * rho * r2
            c00, c01, c02 = n11 * n22 - n12 * n12, n02 * n12 - n01 * n22, n01 * n12 - n02 * n11
            det = n00 * c00 + n01 * c01 + n02 * c02
            c11, c12, c22 = n00 * n22 - n02 * n02, n01 * n02 - n00 * n12, n00 * n11 - n01 * n01
            a0 = (c00 * b0 + c01 * b1 + c02 * b2) / det
            a1 = (c01 * b0 + c11 * b1 + c12 * b2) / det
            a2 = (c02 * b0 + c12 * b1 + c22 * b2) / det
            value = a0 * r0 + a1 * r1 + a2 * r2
            good = value > 0.3 * rho and value < 3.0 * rho
            out[y, x] = np.float32(1.0 / value) if good else depth[y, x]
