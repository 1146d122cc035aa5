"""The chain rule: from the moments of the blending to gradients of the Gaussians' parameters and of the pose.

``project`` has the forward formulas. With g = dL/d(exponent) and sums over pixels, dL/dS = W^T (sum g t t^T) W / 2, and
on the sphere dL/d(E dmu / |mu|) = W^T sum g t + W^-1 sum g |t|^2 t - 2 (dL/dS) E Sigma m / |mu|^2.
"""

from __future__ import annotations

import numpy as np

from panobench.kernels.block import BLOCK, P, channels, load3, load4, load_parameters, offsets, store3, store4
from panobench.kernels.columns import CAM, MOMENT, MOMENTS, PARAMETER, PARAMETERS
from panobench.kernels.fast_math import exp_fast
from panobench.kernels.jit import INLINE, JIT, PARALLEL, njit, prange
from panobench.splat.algebra import (
    axes_in_camera,
    camera_covariance,
    dot,
    rotate,
    rotation,
    rows_of,
    symmetric_times,
    tangent_basis,
    unrotate,
    whiten,
)
from panobench.splat.project import first_order
from panobench.splat.view import CONIC_ERP, SPHERE

# Offsets in a block's buffer after the parameters: their gradients and the moments, by name and one after the other.
G, M = offsets(PARAMETER, PARAMETERS), offsets(MOMENT, 2 * PARAMETERS)
GRADIENTS, _MOMENTS = channels(PARAMETERS, PARAMETERS), channels(2 * PARAMETERS, MOMENTS)
#: Channels up to here.
CHAIN_CHANNELS = 2 * PARAMETERS + MOMENTS


@njit(**INLINE)
def _doubles(v):  # type: ignore[no-untyped-def]
    return float(v[0]), float(v[1]), float(v[2])


@njit(**INLINE)
def _covariance_gradient(gtt, w00, w01, w11):  # type: ignore[no-untyped-def]
    """dL/dS = W^T (sum g t t^T) W / 2 as (00, 01, 11)."""
    a00, a01, a11 = gtt[0] * w00, gtt[0] * w01 + gtt[1] * w11, gtt[1] * w01 + gtt[2] * w11
    return 0.5 * w00 * a00, 0.5 * w00 * a01, 0.5 * (w01 * a01 + w11 * a11)


@njit(**INLINE)
def _sandwich(a, b, g00, g01, g11, f):  # type: ignore[no-untyped-def]
    """f [a b] [[g00, g01], [g01, g11]] [a b]^T: the upper triangle of dL/dSigma (3, 3)."""
    pa = (g00 * a[0] + g01 * b[0], g00 * a[1] + g01 * b[1], g00 * a[2] + g01 * b[2])
    pb = (g01 * a[0] + g11 * b[0], g01 * a[1] + g11 * b[1], g01 * a[2] + g11 * b[2])
    return (
        f * (a[0] * pa[0] + b[0] * pb[0]), f * (a[0] * pa[1] + b[0] * pb[1]), f * (a[0] * pa[2] + b[0] * pb[2]),
        f * (a[1] * pa[1] + b[1] * pb[1]), f * (a[1] * pa[2] + b[1] * pb[2]), f * (a[2] * pa[2] + b[2] * pb[2]),
    )  # fmt: skip


@njit(**INLINE)
def _sphere_gradients(mu, C, gt, gtt, gttt, dist, low):  # type: ignore[no-untyped-def]
    """dL/dSigma (upper triangle) and dL/dmu of the tangent-plane footprint; mu, C: in the camera frame."""
    m = (mu[0] / dist, mu[1] / dist, mu[2] / dist)
    e, s = tangent_basis(m)
    Ce, Cs = symmetric_times(C, e), symmetric_times(C, s)
    inv2 = 1.0 / (dist * dist)
    S00, S01, S11 = dot(e, Ce) * inv2, dot(s, Ce) * inv2, dot(s, Cs) * inv2
    w00, w01, w11 = whiten(S00 + low, S01, S11 + low)
    g00, g01, g11 = _covariance_gradient(gtt, w00, w01, w11)
    i00, i11 = 1.0 / w00, 1.0 / w11
    i01 = -w01 * i00 * i11  # W^-1 of an upper-triangular W
    n0, n1 = dot(Ce, m) * inv2, dot(Cs, m) * inv2
    d0 = w00 * gt[0] + i00 * gttt[0] + i01 * gttt[1] - 2.0 * (g00 * n0 + g01 * n1)
    d1 = w01 * gt[0] + w11 * gt[1] + i11 * gttt[1] - 2.0 * (g01 * n0 + g11 * n1)
    radial = -2.0 * (g00 * S00 + 2.0 * g01 * S01 + g11 * S11)
    gmu = (
        (e[0] * d0 + s[0] * d1 + m[0] * radial) / dist,
        (e[1] * d0 + s[1] * d1 + m[1] * radial) / dist,
        (e[2] * d0 + s[2] * d1 + m[2] * radial) / dist,
    )
    return _sandwich(e, s, g00, g01, g11, inv2), gmu


@njit(**JIT)
def _erp_curvature(mu, g0, g1, intr):  # type: ignore[no-untyped-def]
    """dL/dmu through the Jacobian of the panorama (second derivatives of u and v); g0, g1: the rows of dL/dJ."""
    x, y, z = mu
    a, b = intr[CAM.width] / (2 * np.pi), intr[CAM.height] / np.pi
    rho2 = max(x * x + z * z, 1e-12)
    rho = np.sqrt(rho2)
    r2 = rho2 + y * y
    rho4, r4 = rho2 * rho2, r2 * r2
    uxx, uxz = -2 * x * z / rho4 * a, (x * x - z * z) / rho4 * a
    hp, hpp, hpy, hyy = -y / r2, 2 * y * rho / r4, (y * y - rho2) / r4, -2 * y * rho / r4
    cx, cz = x / rho, z / rho
    vxx, vzz = b * (hpp * cx * cx + hp * cz * cz / rho), b * (hpp * cz * cz + hp * cx * cx / rho)
    vxz = b * (hpp * cx * cz - hp * cx * cz / rho)
    vxy, vzy, vyy = b * hpy * cx, b * hpy * cz, b * hyy
    return (
        g0[0] * uxx + g0[2] * uxz + g1[0] * vxx + g1[1] * vxy + g1[2] * vxz,
        g1[0] * vxy + g1[1] * vyy + g1[2] * vzy,
        g0[0] * uxz - g0[2] * uxx + g1[0] * vxz + g1[1] * vzy + g1[2] * vzz,
    )


@njit(**JIT)
def _pinhole_curvature(mu, g0, g1, J0, J1, clamped_x, clamped_y, intr):  # type: ignore[no-untyped-def]
    """As ``_erp_curvature`` for the pinhole; entries of J that were clamped depend on z only."""
    x, y, z = mu
    fx, fy = intr[CAM.fx], intr[CAM.fy]
    iz, iz2 = 1.0 / z, 1.0 / (z * z)
    gx, gy, gz = 0.0, 0.0, -(g0[0] * fx + g1[1] * fy) * iz2
    if clamped_x:
        gz -= g0[2] * J0[2] * iz
    else:
        gx -= g0[2] * fx * iz2
        gz += 2.0 * g0[2] * fx * x * iz2 * iz
    if clamped_y:
        gz -= g1[2] * J1[2] * iz
    else:
        gy -= g1[2] * fy * iz2
        gz += 2.0 * g1[2] * fy * y * iz2 * iz
    return gx, gy, gz


@njit(**JIT)
def _conic_gradients(mu, C, gt, gtt, code, intr, low_pass):  # type: ignore[no-untyped-def]
    """dL/dSigma and dL/dmu of a first-order projection, including the dependence of its Jacobian J on mu."""
    _, _, J0, J1, clamped_x, clamped_y = first_order(mu, code, intr)
    C0, C1 = symmetric_times(C, J0), symmetric_times(C, J1)
    w00, w01, w11 = whiten(dot(J0, C0) + low_pass, dot(J0, C1), dot(J1, C1) + low_pass)
    g00, g01, g11 = _covariance_gradient(gtt, w00, w01, w11)
    gu, gv = w00 * gt[0], w01 * gt[0] + w11 * gt[1]
    g0 = (2 * (g00 * C0[0] + g01 * C1[0]), 2 * (g00 * C0[1] + g01 * C1[1]), 2 * (g00 * C0[2] + g01 * C1[2]))
    g1 = (2 * (g01 * C0[0] + g11 * C1[0]), 2 * (g01 * C0[1] + g11 * C1[1]), 2 * (g01 * C0[2] + g11 * C1[2]))
    if code == CONIC_ERP:
        h = _erp_curvature(mu, g0, g1, intr)
        p0, p1 = J0, J1
    else:
        h = _pinhole_curvature(mu, g0, g1, J0, J1, clamped_x, clamped_y, intr)
        iz = 1.0 / mu[2]
        p0 = (intr[CAM.fx] * iz, 0.0, -intr[CAM.fx] * mu[0] * iz * iz)
        p1 = (0.0, intr[CAM.fy] * iz, -intr[CAM.fy] * mu[1] * iz * iz)
    gmu = (
        h[0] + gu * p0[0] + gv * p1[0],
        h[1] + gu * p0[1] + gv * p1[1],
        h[2] + gu * p0[2] + gv * p1[2],
    )
    return _sandwich(J0, J1, g00, g01, g11, 1.0), gmu


@njit(**INLINE)
def _quaternion_gradient(q, G0, G1, G2):  # type: ignore[no-untyped-def]
    """dL/dq of the unnormalised quaternion (w, x, y, z), for the rows of dL/dR."""
    _, scale = rotation(q)
    w, x, y, z = q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale
    d21, d02, d10 = G2[1] - G1[2], G0[2] - G2[0], G1[0] - G0[1]
    s01, s02, s12 = G0[1] + G1[0], G0[2] + G2[0], G1[2] + G2[1]
    gw = 2 * (x * d21 + y * d02 + z * d10)
    gx = 2 * (-2 * x * (G1[1] + G2[2]) + y * s01 + z * s02 + w * d21)
    gy = 2 * (x * s01 - 2 * y * (G0[0] + G2[2]) + z * s12 + w * d02)
    gz = 2 * (x * s02 + y * s12 - 2 * z * (G0[0] + G1[1]) + w * d10)
    radial = gw * w + gx * x + gy * y + gz * z
    return (gw - radial * w) * scale, (gx - radial * x) * scale, (gy - radial * y) * scale, (gz - radial * z) * scale


@njit(inline="always", **JIT)
def _block(buf, n, R, t, code, intr, low_pass, low, pose):  # type: ignore[no-untyped-def]
    """Gradients of n Gaussians from the parameters and moments in a block's buffer; dL/dtau is added to pose (6,)."""
    p0, p1, p2, p3, p4, p5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(np.uint64(n)):
        qw, qx, qy, qz = load4(buf, j, P.quat)
        q = (float(qw), float(qx), float(qy), float(qz))
        gt = (float(buf[j + M.gt[0]]), float(buf[j + M.gt[1]]))
        gtt = _doubles(load3(buf, j, M.gtt))
        gttt = (float(buf[j + M.gttt[0]]), float(buf[j + M.gttt[1]]))
        x, y, z = rotate(R, _doubles(load3(buf, j, P.mean)))
        mu = (x + t[0], y + t[1], z + t[2])
        dist = np.sqrt(dot(mu, mu))
        axes = axes_in_camera(q, load3(buf, j, P.log_scale), R)
        C = camera_covariance(axes)
        if code == SPHERE:
            gC, gmu = _sphere_gradients(mu, C, gt, gtt, gttt, dist, low)
        else:
            gC, gmu = _conic_gradients(mu, C, gt, gtt, code, intr, low_pass)
        f = buf[j + M.distance] / dist
        gmu = (gmu[0] + f * mu[0], gmu[1] + f * mu[1], gmu[2] + f * mu[2])
        # The pose moves mu_c and Sigma_c rigidly: dSigma = [w] Sigma - Sigma [w], A = Sigma dL/dSigma.
        A0 = symmetric_times(gC, (C[0], C[1], C[2]))
        A1, A2 = symmetric_times(gC, (C[1], C[3], C[4])), symmetric_times(gC, (C[2], C[4], C[5]))
        # Sigma = sum_q s_q^2 a_q a_q^T: dL/d(log s_q) = 2 s_q^2 a_q.(gC a_q), dL/da_q = 2 s_q^2 gC a_q.
        a0, a1, a2, s = axes
        v0, v1, v2 = 2.0 * s[0] * s[0], 2.0 * s[1] * s[1], 2.0 * s[2] * s[2]
        b0, b1, b2 = symmetric_times(gC, a0), symmetric_times(gC, a1), symmetric_times(gC, a2)
        c0 = unrotate(R, (v0 * b0[0], v0 * b0[1], v0 * b0[2]))
        c1 = unrotate(R, (v1 * b1[0], v1 * b1[1], v1 * b1[2]))
        c2 = unrotate(R, (v2 * b2[0], v2 * b2[1], v2 * b2[2]))
        gq = _quaternion_gradient(q, (c0[0], c1[0], c2[0]), (c0[1], c1[1], c2[1]), (c0[2], c1[2], c2[2]))
        gm = unrotate(R, gmu)
        o = 1.0 / (1.0 + exp_fast(-buf[j + P.logit]))
        p0 += gmu[0]
        p1 += gmu[1]
        p2 += gmu[2]
        p3 += mu[1] * gmu[2] - mu[2] * gmu[1] + 2.0 * (A1[2] - A2[1])
        p4 += mu[2] * gmu[0] - mu[0] * gmu[2] + 2.0 * (A2[0] - A0[2])
        p5 += mu[0] * gmu[1] - mu[1] * gmu[0] + 2.0 * (A0[1] - A1[0])
        store3(buf, j, G.mean, gm)
        store3(buf, j, G.log_scale, (v0 * dot(a0, b0), v1 * dot(a1, b1), v2 * dot(a2, b2)))
        store4(buf, j, G.quat, gq)
        buf[j + G.logit] = float(buf[j + M.g]) * (1.0 - o)
        store3(buf, j, G.colour, load3(buf, j, M.colour))
    pose[0] += p0
    pose[1] += p1
    pose[2] += p2
    pose[3] += p3
    pose[4] += p4
    pose[5] += p5


@njit(**JIT)
def gradient_block(buf, n, R, t, code, intr, low_pass, low, pose):  # type: ignore[no-untyped-def]
    """As ``_block``, compiled once for the sphere alone: without the other projections' branches it is vectorised."""
    if code == SPHERE:
        _block(buf, n, R, t, SPHERE, intr, low_pass, low, pose)
    else:
        _block(buf, n, R, t, code, intr, low_pass, low, pose)


@njit(**JIT)
def load_touched(buf, ids, k, end, moments, means, log_scales, quats, logits, colours):  # type: ignore[no-untyped-def]
    """Fill a block with the Gaussians in k .. end - 1 that any pixel touched, and with their moments.

    ids (BLOCK,) receives their numbers. Returns how many there are and where the next block begins. Moments
    (threads, N, MOMENTS) are summed over the threads.
    """
    threads, n = moments.shape[0], 0
    while k < end and n < BLOCK:
        size = np.float32(0.0)
        for i in range(MOMENTS):
            m = moments[0, k, i]
            for t in range(1, threads):
                m += moments[t, k, i]
            buf[n + _MOMENTS[i]] = m
            size += abs(m)
        if size != 0.0:
            load_parameters(buf, n, k, means, log_scales, quats, logits, colours)
            ids[n] = k
            n += 1
        k += 1
    return n, k


@njit(**PARALLEL)
def parameter_gradients(  # type: ignore[no-untyped-def]
    moments, means, log_scales, quats, logits, colours, R_cw, t_cw, code, intr, pixel_angle, low_pass, grads, pose
):
    """Chain rule for moments (threads, N, MOMENTS): writes grads (N, PARAMETERS) and pose (threads, 6).

    means, log_scales, quats, logits, colours: shapes as in ``GaussianMap``. R_cw (3, 3), t_cw (3,): world to camera.
    code, intr, pixel_angle: the view's projection, intrinsics and pixel angle. low_pass: pixels^2. pose receives
    dL/dtau for mu_c <- exp(tau) mu_c, tau = (translation, rotation), one row per thread. Rows of ``grads`` of
    Gaussians that no pixel touched are left as they are.
    """
    threads, count = moments.shape[0], means.shape[0]
    share = (count + threads - 1) // threads
    low = low_pass * pixel_angle * pixel_angle
    for th in prange(threads):
        buf, ids, tau = np.empty(CHAIN_CHANNELS * BLOCK, np.float32), np.empty(BLOCK, np.int64), np.zeros(6)
        R, t = rows_of(R_cw), (t_cw[0], t_cw[1], t_cw[2])
        k, end = th * share, min((th + 1) * share, count)
        while k < end:
            n, k = load_touched(buf, ids, k, end, moments, means, log_scales, quats, logits, colours)
            gradient_block(buf, n, R, t, code, intr, low_pass, low, tau)
            for j in range(n):
                for i in range(PARAMETERS):
                    grads[ids[j], i] = buf[j + GRADIENTS[i]]
        for i in range(6):
            pose[th, i] = tau[i]
