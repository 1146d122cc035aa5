"""Moment sums of the blend -> gradients of the Gaussian parameters and of the pose.

See project.py for the forward formulas. With g = dL/d(exponent): dL/dS = W^T (sum g t t^T) W / 2, and on the sphere
dL/d(E dmu/|mu|) = W^T sum g t + W^-1 sum g |t|^2 t - 2 (dL/dS) E Sigma m / |mu|^2.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from panobench.splat.kernel_options import JIT, MOMENTS, PARALLEL
from panobench.splat.project import (
    axes_in_camera,
    camera_covariance,
    dot,
    first_order,
    rotate,
    rotation,
    symmetric_times,
    tangent_basis,
    whiten,
)
from panobench.splat.view import CONIC_ERP, SPHERE

#: Columns of the gradient array: means 0-2, log_scales 3-5, quats 6-9, opacity_logit 10, colours 11-13.
PARAMETERS = 14


@njit(**JIT)
def _covariance_gradient(M, w00, w01, w11):  # type: ignore[no-untyped-def]
    """dL/dS = W^T [[M3, M4], [M4, M5]] W / 2 as (00, 01, 11)."""
    a00, a01, a11 = M[3] * w00, M[3] * w01 + M[4] * w11, M[4] * w01 + M[5] * w11
    return 0.5 * w00 * a00, 0.5 * w00 * a01, 0.5 * (w01 * a01 + w11 * a11)


@njit(**JIT)
def _sandwich(a, b, g00, g01, g11, f):  # type: ignore[no-untyped-def]
    """f [a b] [[g00, g01], [g01, g11]] [a b]^T, upper triangle of the symmetric 3x3 (dL/dSigma)."""
    pa = (g00 * a[0] + g01 * b[0], g00 * a[1] + g01 * b[1], g00 * a[2] + g01 * b[2])
    pb = (g01 * a[0] + g11 * b[0], g01 * a[1] + g11 * b[1], g01 * a[2] + g11 * b[2])
    return (
        f * (a[0] * pa[0] + b[0] * pb[0]), f * (a[0] * pa[1] + b[0] * pb[1]), f * (a[0] * pa[2] + b[0] * pb[2]),
        f * (a[1] * pa[1] + b[1] * pb[1]), f * (a[1] * pa[2] + b[1] * pb[2]), f * (a[2] * pa[2] + b[2] * pb[2]),
    )  # fmt: skip


@njit(**JIT)
def _sphere_gradients(mu, C, M, dist, low):  # type: ignore[no-untyped-def]
    """dL/dSigma (upper triangle) and dL/dmu for the tangent-plane footprint."""
    m = (mu[0] / dist, mu[1] / dist, mu[2] / dist)
    e, s = tangent_basis(m)
    Ce, Cs = symmetric_times(C, e), symmetric_times(C, s)
    inv2 = 1.0 / (dist * dist)
    S00, S01, S11 = dot(e, Ce) * inv2, dot(s, Ce) * inv2, dot(s, Cs) * inv2
    w00, w01, w11 = whiten(S00 + low, S01, S11 + low)
    g00, g01, g11 = _covariance_gradient(M, w00, w01, w11)
    i00, i11 = 1.0 / w00, 1.0 / w11
    i01 = -w01 * i00 * i11  # W^-1 of an upper-triangular W
    n0, n1 = dot(Ce, m) * inv2, dot(Cs, m) * inv2
    d0 = w00 * M[1] + i00 * M[6] + i01 * M[7] - 2.0 * (g00 * n0 + g01 * n1)
    d1 = w01 * M[1] + w11 * M[2] + i11 * M[7] - 2.0 * (g01 * n0 + g11 * n1)
    radial = -2.0 * (g00 * S00 + 2.0 * g01 * S01 + g11 * S11)
    gmu = (
        (e[0] * d0 + s[0] * d1 + m[0] * radial) / dist,
        (e[1] * d0 + s[1] * d1 + m[1] * radial) / dist,
        (e[2] * d0 + s[2] * d1 + m[2] * radial) / dist,
    )
    return _sandwich(e, s, g00, g01, g11, inv2), gmu


@njit(**JIT)
def _erp_curvature(mu, g0, g1, intr):  # type: ignore[no-untyped-def]
    """sum over entries of dL/dJ times dJ/dmu for the panorama (second derivatives of u and v)."""
    x, y, z = mu
    a, b = intr[0] / (2 * np.pi), intr[1] / np.pi
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
    """As ``_erp_curvature`` for the pinhole; clamped entries depend on z only."""
    x, y, z = mu
    fx, fy = intr[2], intr[3]
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
def _conic_gradients(mu, C, M, code, intr, low_pass):  # type: ignore[no-untyped-def]
    """dL/dSigma and dL/dmu for a first-order projection, including the dependence of J on mu."""
    _, _, J0, J1, clamped_x, clamped_y = first_order(mu, code, intr)
    C0, C1 = symmetric_times(C, J0), symmetric_times(C, J1)
    w00, w01, w11 = whiten(dot(J0, C0) + low_pass, dot(J0, C1), dot(J1, C1) + low_pass)
    g00, g01, g11 = _covariance_gradient(M, w00, w01, w11)
    gu, gv = w00 * M[1], w01 * M[1] + w11 * M[2]
    g0 = (2 * (g00 * C0[0] + g01 * C1[0]), 2 * (g00 * C0[1] + g01 * C1[1]), 2 * (g00 * C0[2] + g01 * C1[2]))
    g1 = (2 * (g01 * C0[0] + g11 * C1[0]), 2 * (g01 * C0[1] + g11 * C1[1]), 2 * (g01 * C0[2] + g11 * C1[2]))
    if code == CONIC_ERP:
        h = _erp_curvature(mu, g0, g1, intr)
        p0, p1 = J0, J1
    else:
        h = _pinhole_curvature(mu, g0, g1, J0, J1, clamped_x, clamped_y, intr)
        iz = 1.0 / mu[2]
        p0 = (intr[2] * iz, 0.0, -intr[2] * mu[0] * iz * iz)
        p1 = (0.0, intr[3] * iz, -intr[3] * mu[1] * iz * iz)
    gmu = (
        h[0] + gu * p0[0] + gv * p1[0],
        h[1] + gu * p0[1] + gv * p1[1],
        h[2] + gu * p0[2] + gv * p1[2],
    )
    return _sandwich(J0, J1, g00, g01, g11, 1.0), gmu


@njit(**JIT)
def _quaternion_gradient(q, G):  # type: ignore[no-untyped-def]
    """dL/dq through the normalisation, for G = dL/dR row-major."""
    _, scale = rotation(q)
    w, x, y, z = q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale
    d21, d02, d10 = G[7] - G[5], G[2] - G[6], G[3] - G[1]
    s01, s02, s12 = G[1] + G[3], G[2] + G[6], G[5] + G[7]
    gw = 2 * (x * d21 + y * d02 + z * d10)
    gx = 2 * (-2 * x * (G[4] + G[8]) + y * s01 + z * s02 + w * d21)
    gy = 2 * (x * s01 - 2 * y * (G[0] + G[8]) + z * s12 + w * d02)
    gz = 2 * (x * s02 + y * s12 - 2 * z * (G[0] + G[4]) + w * d10)
    radial = gw * w + gx * x + gy * y + gz * z
    return (gw - radial * w) * scale, (gx - radial * x) * scale, (gy - radial * y) * scale, (gz - radial * z) * scale


@njit(inline="always", **JIT)
def gaussian_gradient(  # type: ignore[no-untyped-def]
    M, k, means, log_scales, quats, logits, R_cw, t_cw, code, intr, low_pass, low, out, row, tau
):
    """Gaussian k: its moment sums M -> out[row, row] (PARAMETERS,); its share of the pose gradient joins tau (6,)."""
    mx, my, mz = rotate(R_cw, float(means[k, 0]), float(means[k, 1]), float(means[k, 2]))
    mu = (mx + t_cw[0], my + t_cw[1], mz + t_cw[2])
    dist = np.sqrt(dot(mu, mu))
    axes = axes_in_camera(quats, log_scales, k, R_cw)
    C = camera_covariance(axes)
    if code == SPHERE:
        gC, gmu = _sphere_gradients(mu, C, M, dist, low)
    else:
        gC, gmu = _conic_gradients(mu, C, M, code, intr, low_pass)
    f = M[11] / dist
    gmu = (gmu[0] + f * mu[0], gmu[1] + f * mu[1], gmu[2] + f * mu[2])
    # The pose moves mu_c and Sigma_c rigidly: dSigma = [w] Sigma - Sigma [w], A = Sigma dL/dSigma.
    r0, r1, r2 = (C[0], C[1], C[2]), (C[1], C[3], C[4]), (C[2], C[4], C[5])
    A0, A1, A2 = symmetric_times(gC, r0), symmetric_times(gC, r1), symmetric_times(gC, r2)
    tau[0] += gmu[0]
    tau[1] += gmu[1]
    tau[2] += gmu[2]
    tau[3] += mu[1] * gmu[2] - mu[2] * gmu[1] + 2.0 * (A1[2] - A2[1])
    tau[4] += mu[2] * gmu[0] - mu[0] * gmu[2] + 2.0 * (A2[0] - A0[2])
    tau[5] += mu[0] * gmu[1] - mu[1] * gmu[0] + 2.0 * (A0[1] - A1[0])
    for i in range(3):
        out[row, i] = R_cw[0, i] * gmu[0] + R_cw[1, i] * gmu[1] + R_cw[2, i] * gmu[2]
    # Sigma = sum_q s_q^2 a_q a_q^T: dL/d(log s_q) = 2 s_q^2 a_q.(gC a_q), dL/da_q = 2 s_q^2 gC a_q.
    a0, a1, a2, s = axes
    v0, v1, v2 = 2.0 * s[0] * s[0], 2.0 * s[1] * s[1], 2.0 * s[2] * s[2]
    b0, b1, b2 = symmetric_times(gC, a0), symmetric_times(gC, a1), symmetric_times(gC, a2)
    out[row, 3], out[row, 4], out[row, 5] = v0 * dot(a0, b0), v1 * dot(a1, b1), v2 * dot(a2, b2)
    G = (
        v0 * (R_cw[0, 0] * b0[0] + R_cw[1, 0] * b0[1] + R_cw[2, 0] * b0[2]),
        v1 * (R_cw[0, 0] * b1[0] + R_cw[1, 0] * b1[1] + R_cw[2, 0] * b1[2]),
        v2 * (R_cw[0, 0] * b2[0] + R_cw[1, 0] * b2[1] + R_cw[2, 0] * b2[2]),
        v0 * (R_cw[0, 1] * b0[0] + R_cw[1, 1] * b0[1] + R_cw[2, 1] * b0[2]),
        v1 * (R_cw[0, 1] * b1[0] + R_cw[1, 1] * b1[1] + R_cw[2, 1] * b1[2]),
        v2 * (R_cw[0, 1] * b2[0] + R_cw[1, 1] * b2[1] + R_cw[2, 1] * b2[2]),
        v0 * (R_cw[0, 2] * b0[0] + R_cw[1, 2] * b0[1] + R_cw[2, 2] * b0[2]),
        v1 * (R_cw[0, 2] * b1[0] + R_cw[1, 2] * b1[1] + R_cw[2, 2] * b1[2]),
        v2 * (R_cw[0, 2] * b2[0] + R_cw[1, 2] * b2[1] + R_cw[2, 2] * b2[2]),
    )
    out[row, 6], out[row, 7], out[row, 8], out[row, 9] = _quaternion_gradient(
        (quats[k, 0], quats[k, 1], quats[k, 2], quats[k, 3]), G
    )
    o = 1.0 / (1.0 + np.exp(-float(logits[k])))
    out[row, 10] = M[0] * (1.0 - o)
    for c in range(3):
        out[row, 11 + c] = M[8 + c]


@njit(inline="always", **JIT)
def sum_moments(moments, k, M):  # type: ignore[no-untyped-def]
    """Moments of Gaussian k summed over threads into M (MOMENTS,); False if nothing reached it."""
    size = 0.0
    for i in range(MOMENTS):
        m = 0.0
        for t in range(moments.shape[0]):
            m += moments[t, k, i]
        M[i] = m
        size += abs(m)
    return size != 0.0


@njit(**PARALLEL)
def parameter_gradients(  # type: ignore[no-untyped-def]
    moments, means, log_scales, quats, logits, R_cw, t_cw, code, intr, pixel_angle, low_pass, grads, pose
):
    """Chain rule for moments (threads, N, MOMENTS): writes grads (N, PARAMETERS) and pose (threads, 6).

    pose is dL/dtau for mu_c <- exp(tau) mu_c, tau = (translation, rotation), summed per thread.
    """
    threads, n = moments.shape[0], means.shape[0]
    share = (n + threads - 1) // threads
    low = low_pass * pixel_angle * pixel_angle
    for th in prange(threads):
        M, tau = np.empty(MOMENTS), np.zeros(6)
        for k in range(th * share, min((th + 1) * share, n)):
            if sum_moments(moments, k, M):
                gaussian_gradient(
                    M, k, means, log_scales, quats, logits, R_cw, t_cw, code, intr, low_pass, low, grads, k, tau
                )
        for i in range(6):
            pose[th, i] = tau[i]
