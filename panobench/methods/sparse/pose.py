"""Residuals of bearing vectors, and a pose from known points.

The residual is the direction of a point in the camera minus its measured bearing, on the bearing's tangent plane,
times ``focal``. This is in pixels of a face's centre, everywhere on the sphere and for every camera model. Each bearing
begins at an origin in the camera's axes: the centre of the lens that saw it, zero for a central camera. Solved by
Levenberg-Marquardt with Huber weights and the left perturbation T_cw <- exp(xi) T_cw, xi = (translation, rotation).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import renormalise
from panobench.inertial.rotation_prior import RotationPrior
from panobench.kernels.jit import njit
from panobench.methods.sparse.patches import tangent_basis

Array = NDArray[np.float64]


@njit(cache=True)
def apply_increment(xi, R, t):  # type: ignore[no-untyped-def]
    """(R, t) <- exp(xi) (R, t), in place, by Rodrigues' formula."""
    wx, wy, wz = xi[3], xi[4], xi[5]
    theta2 = wx * wx + wy * wy + wz * wz
    theta = math.sqrt(theta2)
    if theta < 1e-6:
        a, b, c = 1 - theta2 / 6, 0.5 - theta2 / 24, 1 / 6 - theta2 / 120
    else:
        a, b, c = math.sin(theta) / theta, (1 - math.cos(theta)) / theta2, (theta - math.sin(theta)) / (theta2 * theta)
    for column in range(4):
        if column < 3:
            x, y, z = R[0, column], R[1, column], R[2, column]
        else:
            x, y, z = t[0], t[1], t[2]
        px, py, pz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        qx, qy, qz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
        x, y, z = x + a * px + b * qx, y + a * py + b * qy, z + a * pz + b * qz
        if column < 3:
            R[0, column], R[1, column], R[2, column] = x, y, z
        else:
            t[0], t[1], t[2] = x, y, z
    x, y, z = xi[0], xi[1], xi[2]
    px, py, pz = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
    qx, qy, qz = wy * pz - wz * py, wz * px - wx * pz, wx * py - wy * px
    t[0] += x + b * px + c * qx
    t[1] += y + b * py + c * qy
    t[2] += z + b * pz + c * qz


@njit(cache=True)
def residual(R, t, X, c, b, focal, J, Y):  # type: ignore[no-untyped-def]
    """Residual (2,) in pixels of a bearing b that begins at c, both (3,) in the camera frame.

    Writes the point in the camera frame to Y (3,) and the derivative by it to J (2, 3).
    """
    for r in range(3):
        Y[r] = R[r, 0] * X[0] + R[r, 1] * X[1] + R[r, 2] * X[2] + t[r]
    d0, d1, d2 = Y[0] - c[0], Y[1] - c[1], Y[2] - c[2]
    norm = math.sqrt(d0 * d0 + d1 * d1 + d2 * d2) + 1e-12
    m0, m1, m2 = d0 / norm, d1 / norm, d2 / norm
    ax, ay, az, cx, cy, cz = tangent_basis(b[0], b[1], b[2])
    e0, e1 = ax * m0 + ay * m1 + az * m2, cx * m0 + cy * m1 + cz * m2
    s = focal / norm
    J[0, 0], J[0, 1], J[0, 2] = s * (ax - e0 * m0), s * (ay - e0 * m1), s * (az - e0 * m2)
    J[1, 0], J[1, 1], J[1, 2] = s * (cx - e1 * m0), s * (cy - e1 * m1), s * (cz - e1 * m2)
    if m0 * b[0] + m1 * b[1] + m2 * b[2] < 0:  # more than 90 degrees off: the cost of 90 degrees
        return focal, focal
    return focal * e0, focal * e1


@njit(cache=True)
def pose_row(J, Y, i, row):  # type: ignore[no-untyped-def]
    """Row i of d(residual) / d(xi) = [J, -J hat(Y)]."""
    row[0], row[1], row[2] = J[i, 0], J[i, 1], J[i, 2]
    row[3] = Y[1] * J[i, 2] - Y[2] * J[i, 1]
    row[4] = Y[2] * J[i, 0] - Y[0] * J[i, 2]
    row[5] = Y[0] * J[i, 1] - Y[1] * J[i, 0]


@njit(cache=True)
def _pose_cost(R, t, X, o, b, focal, huber):  # type: ignore[no-untyped-def]
    J, Y = np.empty((2, 3)), np.empty(3)
    cost = 0.0
    for n in range(len(X)):
        e0, e1 = residual(R, t, X[n], o[n], b[n], focal, J, Y)
        q = e0 * e0 + e1 * e1
        cost += q if q < huber * huber else 2 * huber * math.sqrt(q) - huber * huber
    return cost


@njit(cache=True)
def _pose_system(R, t, X, o, b, focal, huber, H, g):  # type: ignore[no-untyped-def]
    """Normal equations of one pose: adds to H (6, 6) and g (6,)."""
    J, Y = np.empty((2, 3)), np.empty(3)
    row = np.empty(6)
    for n in range(len(X)):
        e0, e1 = residual(R, t, X[n], o[n], b[n], focal, J, Y)
        q = math.sqrt(e0 * e0 + e1 * e1)
        w = 1.0 if q < huber else huber / q
        for i in range(2):
            e = e0 if i == 0 else e1
            pose_row(J, Y, i, row)
            for r in range(6):
                g[r] += w * row[r] * e
                for c in range(6):
                    H[r, c] += w * row[r] * row[c]


@njit(cache=True)
def all_errors(R, t, kf, pt, X, o, b, focal, out):  # type: ignore[no-untyped-def]
    J, Y = np.empty((2, 3)), np.empty(3)
    for n in range(len(kf)):
        e0, e1 = residual(R[kf[n]], t[kf[n]], X[pt[n]], o[n], b[n], focal, J, Y)
        out[n] = math.sqrt(e0 * e0 + e1 * e1)


def solve_pose(
    T_cw: Array,
    points: Array,
    bearings: Array,
    focal: float,
    huber: float,
    iterations: int = 10,
    origins: Array | None = None,
    prior: RotationPrior | None = None,
) -> Array:
    """World-to-camera pose (4, 4) that fits points (N, 3) seen along bearings (N, 3) best; ``T_cw`` is the start.

    origins (N, 3): where the bearings begin in the camera's axes; None: at its centre. prior: of the rotation, weighed
    as if bearings deviated by ``huber`` pixels.
    """
    if len(points) < 3:
        return T_cw
    X, b, o = np.ascontiguousarray(points), np.ascontiguousarray(bearings), origins_of(origins, len(points))
    R, t = T_cw[:3, :3].copy(), T_cw[:3, 3].copy()

    def cost_at(R: Array, t: Array) -> float:
        cost = float(_pose_cost(R, t, X, o, b, focal, huber))
        return cost if prior is None else cost + huber**2 * prior.cost(R)

    cost, damping = cost_at(R, t), 1e-4
    for _ in range(iterations):
        H, g = np.zeros((6, 6)), np.zeros(6)
        _pose_system(R, t, X, o, b, focal, huber, H, g)
        if prior is not None:
            information, gradient = prior.linearise(R)
            H[3:, 3:] += huber**2 * information * np.eye(3)
            g[3:] += huber**2 * gradient
        new = cost
        for _ in range(5):
            R2, t2 = R.copy(), t.copy()
            apply_increment(-np.linalg.solve(H + np.diag(damping * np.diag(H) + 1e-9), g), R2, t2)
            new = cost_at(R2, t2)
            if new < cost:
                break
            damping *= 10
        if not new < cost:
            break
        small = cost - new < 1e-6 * cost
        R, t, cost, damping = R2, t2, new, damping * 0.1
        if small:
            break
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, t
    return renormalise(T)


def origins_of(origins: Array | None, count: int) -> Array:
    return np.zeros((count, 3)) if origins is None else np.ascontiguousarray(origins, dtype=np.float64)


def deviation(errors: Array) -> float:
    """Of residuals per axis, by the median of their lengths (N,) in pixels, as of a Rayleigh distribution."""
    return float(np.median(errors)) / 1.1774 if len(errors) else 0.0


def errors_in_views(
    T_cw: Array,
    points: Array,
    view: NDArray[np.int64],
    point: NDArray[np.int64],
    bearings: Array,
    focal: float,
    origins: Array | None = None,
) -> Array:
    """Lengths (N,) of the residuals in pixels: the camera at T_cw[view[n]] saw points[point[n]] along bearings[n]."""
    out = np.empty(len(view))
    R, t = np.ascontiguousarray(T_cw[:, :3, :3]), np.ascontiguousarray(T_cw[:, :3, 3])
    X, b = np.ascontiguousarray(points), np.ascontiguousarray(bearings)
    all_errors(R, t, view, point, X, origins_of(origins, len(view)), b, focal, out)
    return out


def pose_errors(T_cw: Array, points: Array, bearings: Array, focal: float, origins: Array | None = None) -> Array:
    """Lengths (N,) of the residuals in pixels."""
    zero, index = np.zeros(len(points), np.int64), np.arange(len(points))
    return errors_in_views(T_cw[None], points, zero, index, bearings, focal, origins)
