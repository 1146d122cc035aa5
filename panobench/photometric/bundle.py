"""Joint refinement of frame poses and the depths of selected reference pixels (photometric bundle adjustment).

Alternating pose and depth creeps along the directions in which both compensate each other (a turn of all frames
against a tilt of the whole scene); solving for both at once does not. Every pixel has one unknown, its log depth, so
it is eliminated by the Schur complement (Engel et al., "Direct sparse odometry", 2018, without its sliding window).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from panobench.geometry import renormalise, se3_exp
from panobench.photometric.pyramid import F32
from panobench.photometric.warp import sample, to_pixel
from panobench.splat.kernel_options import JIT, PARALLEL

#: Runs of pixels whose sums are taken apart: the same for every number of threads, so that the sums are too.
_BLOCKS = 16


@dataclass(frozen=True)
class BundleOptions:
    """cell_px: one pixel, that with the largest gradient, per cell. huber, cut: residuals, in robust standard
    deviations at the start, where the cost turns linear and where a residual (an occlusion, say) stops counting;
    sigma_min: least standard deviation assumed (of 1). depth_edge: as in alignment.
    """

    cell_px: int = 3
    gradient_min: float = 0.01
    latitude_limit_deg: float = 75.0
    iterations: int = 15
    huber: float = 1.0
    cut: float = 20.0
    sigma_min: float = 0.002
    depth_edge: float = 1.1


@njit(**JIT)
def _residuals_of(  # type: ignore[no-untyped-def]
    block, first, last, value, rays, log_depth, frames, R, t, code, cam, huber, cut, Hpd, Hdd, bd, Hpp, bp, cost, size
):
    """Pixels ``first`` to ``last`` - 1 of ``_residuals``."""
    for p in range(first, last):
        d = np.exp(log_depth[p])
        hdd, b, c = 0.0, 0.0, 0.0
        for f in range(frames.shape[0]):
            image = frames[f]
            for i in range(6):
                Hpd[p, f, i] = 0.0
            size[p, f] = np.nan
            qx = d * (R[f, 0, 0] * rays[p, 0] + R[f, 0, 1] * rays[p, 1] + R[f, 0, 2] * rays[p, 2])
            qy = d * (R[f, 1, 0] * rays[p, 0] + R[f, 1, 1] * rays[p, 1] + R[f, 1, 2] * rays[p, 2])
            qz = d * (R[f, 2, 0] * rays[p, 0] + R[f, 2, 1] * rays[p, 1] + R[f, 2, 2] * rays[p, 2])
            x, y, z = qx + t[f, 0], qy + t[f, 1], qz + t[f, 2]
            u, v, ok = to_pixel(np.float32(x), np.float32(y), np.float32(z), code, cam)
            if not ok:
                c += huber * (cut - 0.5 * huber)
                continue
            r = sample(image, u, v, code) - value[p]
            h = np.float32(0.5)
            gx = sample(image, u + h, v, code) - sample(image, u - h, v, code)
            gy = sample(image, u, v + h, code) - sample(image, u, v - h, code)
            if not (abs(r) + abs(gx) + abs(gy) < 10):
                c += huber * (cut - 0.5 * huber)
                continue
            size[p, f] = abs(r)
            if abs(r) > cut:
                c += huber * (cut - 0.5 * huber)
                continue
            if code == 0:
                a, e = cam[0] / (2 * np.pi), cam[1] / np.pi
                rho2 = x * x + z * z
                rho, r2 = np.sqrt(rho2), rho2 + y * y
                jx = gx * a * z / rho2 - gy * e * x * y / (r2 * rho)
                jy = gy * e * rho / r2
                jz = -gx * a * x / rho2 - gy * e * z * y / (r2 * rho)
            else:
                jx, jy = gx * cam[2] / z, gy * cam[3] / z
                jz = -(jx * x + jy * y) / z
            J = (jx, jy, jz, y * jz - z * jy, z * jx - x * jz, x * jy - y * jx)
            jd = jx * qx + jy * qy + jz * qz
            m = abs(r)
            w = 1.0 if m <= huber else huber / m
            c += 0.5 * r * r if m <= huber else huber * (m - 0.5 * huber)
            hdd += w * jd * jd
            b += w * jd * r
            k = 0
            for i in range(6):
                Hpd[p, f, i] = w * J[i] * jd
                bp[block, f, i] += w * J[i] * r
                for j in range(i, 6):
                    Hpp[block, f, k] += w * J[i] * J[j]
                    k += 1
        Hdd[p], bd[p], cost[p] = hdd, b, c


@njit(**PARALLEL)
def _residuals(value, rays, log_depth, frames, R, t, code, cam, huber, cut, Hpd, Hdd, bd, Hpp, bp, cost, size):  # type: ignore[no-untyped-def]
    """Normal equations. Of every pixel: Hpd (P, F, 6), Hdd, bd (P,), cost (P,), size (P, F): |residual|, NaN where
    unseen; summed over runs of pixels: Hpp (B, F, 21), bp (B, F, 6).
    """
    blocks = Hpp.shape[0]
    share = (len(value) + blocks - 1) // blocks
    for block in prange(blocks):
        _residuals_of(
            block, block * share, min((block + 1) * share, len(value)),
            value, rays, log_depth, frames, R, t, code, cam, huber, cut, Hpd, Hdd, bd, Hpp, bp, cost, size,
        )  # fmt: skip


def select_pixels(
    luma: F32, rays: F32, depth: F32, options: BundleOptions
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the strongest pixel of each cell of a reference (H, W)."""
    gx = 0.5 * (np.roll(luma, -1, axis=1) - np.roll(luma, 1, axis=1))
    gy = np.zeros_like(luma)
    gy[1:-1] = 0.5 * (luma[2:] - luma[:-2])
    strength = np.nan_to_num(np.hypot(gx, gy))
    usable = np.isfinite(luma) & np.isfinite(depth) & (depth > 0)
    usable &= np.abs(rays[..., 1]) < np.sin(np.deg2rad(options.latitude_limit_deg))
    strength = np.where(usable & (strength >= options.gradient_min), strength, 0)
    near, far = cv2.erode(depth, np.ones((3, 3))), cv2.dilate(depth, np.ones((3, 3)))
    strength = np.where(far < options.depth_edge * near, strength, 0)
    c = options.cell_px
    h, w = luma.shape[0] // c * c, luma.shape[1] // c * c
    cells = strength[:h, :w].reshape(h // c, c, w // c, c).transpose(0, 2, 1, 3).reshape(h // c, w // c, c * c)
    best, top = cells.argmax(axis=-1), cells.max(axis=-1)
    cy, cx = np.nonzero(top > 0)
    return cy * c + best[cy, cx] // c, cx * c + best[cy, cx] % c


def refine(
    luma: F32,
    rays: F32,
    depth: F32,
    frames: F32,
    T_fr: NDArray[np.float64],
    code: int,
    cam: F32,
    options: BundleOptions = BundleOptions(),
) -> tuple[NDArray[np.float64], float]:
    """Poses (F, 4, 4) of ``frames`` (F, H, W) from the reference, refined together with the depth of its pixels.

    luma, depth (H, W), rays (H, W, 3) of the reference. Returns the poses, at the scale of the depth given, and the
    mean robust cost. Too few usable pixels: the poses as they came.
    """
    ys, xs = select_pixels(luma, rays, depth, options)
    n, F = len(ys), len(frames)
    if n < 100:
        return T_fr, np.inf
    value, r = luma[ys, xs], np.ascontiguousarray(rays[ys, xs])
    s, T = np.log(depth[ys, xs].astype(np.float64)), T_fr.copy()
    upper = np.triu_indices(6)

    def linearise(T: NDArray[np.float64], s: NDArray[np.float64]) -> tuple[NDArray, ...]:
        Hpd, bp, Hpp = np.empty((n, F, 6)), np.zeros((_BLOCKS, F, 6)), np.zeros((_BLOCKS, F, 21))
        Hdd, bd, cost, size = np.empty(n), np.empty(n), np.empty(n), np.empty((n, F), np.float32)
        R, t = np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3])
        _residuals(value, r, s, frames, R, t, code, cam, huber, cut, Hpd, Hdd, bd, Hpp, bp, cost, size)
        return Hpd.reshape(n, 6 * F), Hdd, bd, Hpp.sum(axis=0), bp.sum(axis=0).ravel(), cost, size

    huber = cut = 10.0
    size = linearise(T, s)[6]
    if not np.isfinite(size).any():
        return T_fr, np.inf
    sigma = max(1.4826 * float(np.nanmedian(size)), options.sigma_min)
    huber, cut = options.huber * sigma, options.cut * sigma
    state = linearise(T, s)
    cost, damping = float(state[5].sum()), 1e-3
    for _ in range(options.iterations):
        Hpd, Hdd, bd, Hpp, bp = state[:5]
        H = np.zeros((6 * F, 6 * F))
        for f in range(F):
            block = np.zeros((6, 6))
            block[upper] = Hpp[f]
            H[6 * f : 6 * f + 6, 6 * f : 6 * f + 6] = block + np.triu(block, 1).T
        H[np.diag_indices(6 * F)] *= 1 + damping
        inverse = 1.0 / (Hdd * (1 + damping) + 1e-6)
        whitened = Hpd * np.sqrt(inverse)[:, None]
        A = H - whitened.T @ whitened + 1e-9 * np.trace(H) / len(H) * np.eye(len(H))
        x = np.linalg.solve(A, -(bp - Hpd.T @ (inverse * bd)))
        ds = np.clip(-inverse * (bd + Hpd @ x), -0.3, 0.3)
        T_new, s_new = renormalise(se3_exp(x.reshape(F, 6)) @ T), s + ds
        trial = linearise(T_new, s_new)
        new_cost = float(trial[5].sum())
        if new_cost < cost:
            small = cost - new_cost < 1e-4 * cost
            T, s, state, cost = T_new, s_new, trial, new_cost
            damping = max(damping * 0.3, 1e-6)
            if small:
                break
        else:
            damping *= 10
            if damping > 1e2:
                break
    # The scale is free: what the pixels changed by together, the best determined counting most, is taken back.
    change = s - np.log(depth[ys, xs].astype(np.float64))
    by_size, weights = np.argsort(change), np.maximum(state[1], 0)
    half = np.searchsorted(np.cumsum(weights[by_size]), 0.5 * weights.sum())
    T[:, :3, 3] *= np.exp(-change[by_size[min(half, n - 1)]])
    return T, cost / (n * F)
