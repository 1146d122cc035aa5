"""From Gaussians in the world to packed instances a tile can composite, and the way back for gradients.

Sphere: the exact tangent-plane footprint. With m = mu/|mu|, an orthonormal tangent basis E (2x3) and
S = E Sigma E^T / |mu|^2 + low-pass, the offset of a ray r is d = E r / (m.r), weight exp(-d^T S^-1 d / 2).
First order: Sigma_2D = J Sigma J^T + low-pass with the projection's Jacobian J (Zwicker et al., EWA splatting, 2002;
the panoramic J as in ODGS/OmniGS and the PanoGS-SLAM paper).

Derivatives: moving mu by dmu turns the basis; with (a, b) = E dmu / |mu| the offset of a fixed ray changes by
-(I + d d^T)(a, b), and E by -(a, b) m^T. Covariances are whitened as S^-1 = W^T W, t = W d.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from panobench.splat.algebra import (
    axes_in_camera,
    camera_covariance,
    dot,
    rotate,
    rows_of,
    symmetric_times,
    whiten,
)
from panobench.splat.block import BLOCK, load_parameters
from panobench.splat.footprint import FOOTPRINT_CHANNELS, sphere_block, store_block
from panobench.splat.kernel_options import ALPHA_MIN, JIT, PARALLEL
from panobench.splat.view import BOUND_LATLON, CONIC_ERP, CONIC_PINHOLE, SPHERE


@njit(**JIT)
def first_order(mu, code, intr):  # type: ignore[no-untyped-def]
    """First-order projection: u, v, rows of J, and whether x/z, y/z were clamped inside J (pinhole, as 3DGS)."""
    x, y, z = mu
    if code == CONIC_ERP:
        a, b = intr[0] / (2 * np.pi), intr[1] / np.pi
        rho2 = max(x * x + z * z, 1e-12)
        rho = np.sqrt(rho2)
        r2 = rho2 + y * y
        u, v = 0.5 * intr[0] + a * np.arctan2(x, z), 0.5 * intr[1] + b * np.arctan2(y, rho)
        J0 = (a * z / rho2, 0.0, -a * x / rho2)
        J1 = (-b * x * y / (r2 * rho), b * rho / r2, -b * z * y / (r2 * rho))
        return u, v, J0, J1, False, False
    fx, fy, lx, ly = intr[2], intr[3], intr[6], intr[7]
    tx, ty = x / z, y / z
    u, v = fx * tx + intr[4], fy * ty + intr[5]
    cx, cy = abs(tx) > lx, abs(ty) > ly
    tx, ty = min(max(tx, -lx), lx), min(max(ty, -ly), ly)
    return u, v, (fx / z, 0.0, -fx * tx / z), (0.0, fy / z, -fy * ty / z), cx, cy


@njit(**JIT)
def _first_order(  # type: ignore[no-untyped-def]
    k, means, log_scales, quats, logits, colours, R, t, code, intr, low_pass, near, sloped, packed, rows, cols, key
):
    """Gaussian k by a projection's Jacobian."""
    W, H = intr[0], intr[1]
    key[k] = np.float32(-1.0)
    mx, my, mz = rotate(R, (float(means[k, 0]), float(means[k, 1]), float(means[k, 2])))
    mu = (mx + t[0], my + t[1], mz + t[2])
    dist = np.sqrt(dot(mu, mu))
    if not (dist >= near and dist < 1e9) or (code == CONIC_PINHOLE and mu[2] < near):
        return
    o = 1.0 / (1.0 + np.exp(-float(logits[k])))
    if not o > ALPHA_MIN:
        return
    q_cut = 2.0 * np.log(o / ALPHA_MIN)
    q = (quats[k, 0], quats[k, 1], quats[k, 2], quats[k, 3])
    C = camera_covariance(axes_in_camera(q, (log_scales[k, 0], log_scales[k, 1], log_scales[k, 2]), R))
    u, v, J0, J1, _, _ = first_order(mu, code, intr)
    C0, C1 = symmetric_times(C, J0), symmetric_times(C, J1)
    S00, S01, S11 = dot(J0, C0) + low_pass, dot(J0, C1), dot(J1, C1) + low_pass
    w00, w01, w11 = whiten(S00, S01, S11)
    packed[k, 0], packed[k, 1], packed[k, 2] = w00, w01, -(w00 * u + w01 * v)
    packed[k, 3], packed[k, 4], packed[k, 5] = 0.0, w11, -w11 * v
    packed[k, 6], packed[k, 7], packed[k, 8] = 0.0, 0.0, 1.0
    packed[k, 15], packed[k, 16], packed[k, 17] = u, 0.0, 1.0
    packed[k, 18], packed[k, 19] = 0.0, 0.0
    if sloped:
        c0, c1 = dot(mu, C0) / dist, dot(mu, C1) / dist
        packed[k, 18], packed[k, 19] = w00 * c0 + w01 * c1, w11 * c1
    ru, rv = np.sqrt(q_cut * S00) + 1e-3, np.sqrt(q_cut * S11) + 1e-3
    rows[k, 0] = max(int(np.ceil(max(v - rv, -1.0) - 0.5)), 0)
    rows[k, 1] = min(int(np.floor(min(v + rv, H + 1.0) - 0.5)), int(H) - 1)
    if code == CONIC_ERP:
        ru = min(ru, 0.5 * W - 1.0)
        cols[k, 0], cols[k, 1] = int(np.ceil(u - ru - 0.5)), int(np.floor(u + ru - 0.5))
    else:
        cols[k, 0] = max(int(np.ceil(max(u - ru, -1.0) - 0.5)), 0)
        cols[k, 1] = min(int(np.floor(min(u + ru, W + 1.0) - 0.5)), int(W) - 1)
    if rows[k, 1] < rows[k, 0] or cols[k, 1] < cols[k, 0]:
        return
    packed[k, 9], packed[k, 13], packed[k, 14] = o, dist, q_cut
    for c in range(3):
        packed[k, 10 + c] = colours[k, c]
    key[k] = np.float32(dist)


@njit(**PARALLEL)
def project(  # type: ignore[no-untyped-def]
    means, log_scales, quats, logits, colours, R_cw, t_cw, code, bound, intr, pixel_angle, low_pass, near,
    sloped, packed, rows, cols, key, threads,
):  # fmt: skip
    """Project N Gaussians; writes one packed row each and key = distance (-1: not visible).

    packed columns: 0-2 p1, 3-5 p2, 6-8 m, 9 opacity, 10-12 colour, 13 distance, 14 largest |t|^2 that still
    gives alpha >= 1/255, 15 column of the mean (first-order ERP), 16 cos and 17 sin of the angular radius,
    18, 19 change of distance per unit of t: the mean of the distance given the direction, which on a Gaussian
    flattened along a wall is the wall's (zero unless ``sloped``: then every pixel gets the centre's distance).
    rows (N, 2), cols (N, 2): first and last pixel row and column; columns may run past the edge of a panorama.
    """
    count = means.shape[0]
    share = (count + threads - 1) // threads
    low = low_pass * pixel_angle * pixel_angle
    for th in prange(threads):
        R, t = rows_of(R_cw), (t_cw[0], t_cw[1], t_cw[2])
        end = min((th + 1) * share, count)
        if code == SPHERE:
            buf = np.empty(FOOTPRINT_CHANNELS * BLOCK, np.float32)
            for k0 in range(th * share, end, BLOCK):
                n = min(BLOCK, end - k0)
                for j in range(n):
                    load_parameters(buf, j, k0 + j, means, log_scales, quats, logits, colours)
                if bound == BOUND_LATLON:
                    sphere_block(buf, n, R, t, near, low, sloped, True)
                else:
                    sphere_block(buf, n, R, t, near, low, sloped, False)
                store_block(buf, n, k0, bound, intr, colours, packed, rows, cols, key)
        else:
            for k in range(th * share, end):
                _first_order(
                    k, means, log_scales, quats, logits, colours, R, t, code, intr, low_pass, near, sloped,
                    packed, rows, cols, key,
                )  # fmt: skip
