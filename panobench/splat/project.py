"""Projection: from Gaussians in the world to footprints that a tile can composite.

Sphere: the exact footprint on the tangent plane of the unit sphere. mu and Sigma are the mean and covariance in the
camera frame, m = mu / |mu|, E (2, 3) an orthonormal basis of the tangent plane at m, and
S = E Sigma E^T / |mu|^2 + low-pass. A ray r meets the plane at the offset d = E r / (m.r), where the Gaussian weighs
exp(-d^T S^-1 d / 2).

First order: S = J Sigma J^T + low-pass with the Jacobian J of the camera's projection (Zwicker et al., "EWA splatting",
2002; the panoramic J as in ODGS, OmniGS and PanoGS-SLAM).

Derivatives (see ``chain``): moving mu by dmu rotates the basis. With (a, b) = E dmu / |mu| the offset of a fixed ray
changes by -(I + d d^T) (a, b), and E by -(a, b) m^T. Covariances are whitened: S^-1 = W^T W and t = W d.
"""

from __future__ import annotations

import numpy as np

from panobench.kernels.block import BLOCK, load_parameters
from panobench.kernels.columns import CAM
from panobench.kernels.columns import FOOTPRINT as F
from panobench.kernels.jit import JIT, PARALLEL, njit, prange
from panobench.splat.algebra import (
    axes_in_camera,
    camera_covariance,
    dot,
    rotate,
    rows_of,
    symmetric_times,
    whiten,
)
from panobench.splat.footprint import ALPHA_MIN, FOOTPRINT_CHANNELS, sphere_block, store_block
from panobench.splat.view import BOUND_LATLON, CONIC_ERP, CONIC_PINHOLE, SPHERE


@njit(**JIT)
def first_order(mu, code, intr):  # type: ignore[no-untyped-def]
    """First-order projection of the mean mu (camera frame): pixel u, v, the rows of J, and what was clamped in J.

    The two flags say whether x / z and y / z were, which happens in pinhole images only (as in 3DGS).
    """
    x, y, z = mu
    if code == CONIC_ERP:
        a, b = intr[CAM.width] / (2 * np.pi), intr[CAM.height] / np.pi
        rho2 = max(x * x + z * z, 1e-12)
        rho = np.sqrt(rho2)
        r2 = rho2 + y * y
        u, v = 0.5 * intr[CAM.width] + a * np.arctan2(x, z), 0.5 * intr[CAM.height] + b * np.arctan2(y, rho)
        J0 = (a * z / rho2, 0.0, -a * x / rho2)
        J1 = (-b * x * y / (r2 * rho), b * rho / r2, -b * z * y / (r2 * rho))
        return u, v, J0, J1, False, False
    fx, fy, lx, ly = intr[CAM.fx], intr[CAM.fy], intr[CAM.limit_x], intr[CAM.limit_y]
    tx, ty = x / z, y / z
    u, v = fx * tx + intr[CAM.cx], fy * ty + intr[CAM.cy]
    cx, cy = abs(tx) > lx, abs(ty) > ly
    tx, ty = min(max(tx, -lx), lx), min(max(ty, -ly), ly)
    return u, v, (fx / z, 0.0, -fx * tx / z), (0.0, fy / z, -fy * ty / z), cx, cy


@njit(**JIT)
def _first_order(  # type: ignore[no-untyped-def]
    g, k, means, log_scales, quats, logits, colours, R, t, code, intr, low_pass, near, sloped,
    footprints, rows, cols, key,
):  # fmt: skip
    """The first-order footprint of Gaussian g, written to row k; arguments as in ``project``, R and t as rows."""
    W, H = intr[CAM.width], intr[CAM.height]
    key[k] = np.float32(-1.0)
    mx, my, mz = rotate(R, (float(means[g, 0]), float(means[g, 1]), float(means[g, 2])))
    mu = (mx + t[0], my + t[1], mz + t[2])
    dist = np.sqrt(dot(mu, mu))
    if not (dist >= near and dist < 1e9) or (code == CONIC_PINHOLE and mu[2] < near):
        return
    o = 1.0 / (1.0 + np.exp(-float(logits[g])))
    if not o > ALPHA_MIN:
        return
    q_cut = 2.0 * np.log(o / ALPHA_MIN)
    q = (quats[g, 0], quats[g, 1], quats[g, 2], quats[g, 3])
    C = camera_covariance(axes_in_camera(q, (log_scales[g, 0], log_scales[g, 1], log_scales[g, 2]), R))
    u, v, J0, J1, _, _ = first_order(mu, code, intr)
    C0, C1 = symmetric_times(C, J0), symmetric_times(C, J1)
    S00, S01, S11 = dot(J0, C0) + low_pass, dot(J0, C1), dot(J1, C1) + low_pass
    w00, w01, w11 = whiten(S00, S01, S11)
    footprints[k, F.p1[0]], footprints[k, F.p1[1]], footprints[k, F.p1[2]] = w00, w01, -(w00 * u + w01 * v)
    footprints[k, F.p2[0]], footprints[k, F.p2[1]], footprints[k, F.p2[2]] = 0.0, w11, -w11 * v
    footprints[k, F.m[0]], footprints[k, F.m[1]], footprints[k, F.m[2]] = 0.0, 0.0, 1.0
    footprints[k, F.u], footprints[k, F.cos_radius], footprints[k, F.sin_radius] = u, 0.0, 1.0
    footprints[k, F.slope[0]], footprints[k, F.slope[1]] = 0.0, 0.0
    if sloped:
        c0, c1 = dot(mu, C0) / dist, dot(mu, C1) / dist
        footprints[k, F.slope[0]], footprints[k, F.slope[1]] = w00 * c0 + w01 * c1, w11 * c1
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
    footprints[k, F.opacity], footprints[k, F.distance], footprints[k, F.cut] = o, dist, q_cut
    for c in range(3):
        footprints[k, F.colour[c]] = colours[g, c]
    key[k] = np.float32(dist)


@njit(**PARALLEL)
def project(  # type: ignore[no-untyped-def]
    chosen, means, log_scales, quats, logits, colours, R_cw, t_cw, code, bound, intr, pixel_angle, low_pass, near,
    sloped, footprints, rows, cols, key, threads,
):  # fmt: skip
    """Project the Gaussians ``chosen`` (M,) of N.

    means, log_scales, quats, logits, colours: shapes as in ``GaussianMap``. R_cw (3, 3), t_cw (3,): world to camera.
    code, bound, intr, pixel_angle: the view's projection, bound, intrinsics and pixel angle. low_pass: variance added
    to every footprint, pixels^2. near: least distance, in the map's unit. sloped: distance follows the Gaussian's
    surface: its mean given the direction, which on a Gaussian flattened along a wall is the wall's. Otherwise every
    pixel gets the distance of the mean.

    Writes footprints (M, FOOTPRINT_COLUMNS) float32; key (M,) float32: the distance, -1 for what is not visible;
    rows, cols (M, 2) int32: first and last pixel row and column, where columns may run past a panorama's edges.
    """
    count = len(chosen)
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
                    load_parameters(buf, j, chosen[k0 + j], means, log_scales, quats, logits, colours)
                if bound == BOUND_LATLON:
                    sphere_block(buf, n, R, t, near, low, sloped, True)
                else:
                    sphere_block(buf, n, R, t, near, low, sloped, False)
                store_block(buf, n, k0, bound, intr, footprints, rows, cols, key)
        else:
            for k in range(th * share, end):
                _first_order(
                    chosen[k], k, means, log_scales, quats, logits, colours, R, t, code, intr, low_pass, near, sloped,
                    footprints, rows, cols, key,
                )  # fmt: skip
