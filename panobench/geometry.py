"""SO(3), SE(3), Sim(3) and the unit sphere, in float64, for arrays (..., 3), (..., 3, 3) and (..., 4, 4).

Poses are camera-to-world ``T_wc``. Quaternions are (w, x, y, z), real part first, everywhere in the package; files that
store (x, y, z, w) are reordered where they are read and written.
Formulas: Sola, Deray & Atchuthan, "A micro Lie theory for state estimation in robotics" (2018).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def hat(w: ArrayLike) -> Array:
    """(..., 3) -> the skew-symmetric matrix (..., 3, 3) with ``hat(a) @ b == cross(a, b)``."""
    w = np.asarray(w, dtype=np.float64)
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -w[..., 2], w[..., 1]
    out[..., 1, 0], out[..., 1, 2] = w[..., 2], -w[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -w[..., 1], w[..., 0]
    return out


def _rodrigues_coefficients(theta2: Array) -> tuple[Array, Array, Array]:
    """sin(t) / t, (1 - cos t) / t^2 and (t - sin t) / t^3 of t^2 (...), by series near zero."""
    small = theta2 < 1e-8
    t2 = np.where(small, 1.0, theta2)
    t = np.sqrt(t2)
    a = np.where(small, 1 - theta2 / 6, np.sin(t) / t)
    b = np.where(small, 0.5 - theta2 / 24, (1 - np.cos(t)) / t2)
    c = np.where(small, 1 / 6 - theta2 / 120, (t - np.sin(t)) / (t2 * t))
    return a, b, c


def so3_exp(w: ArrayLike) -> Array:
    """Rotation vector (..., 3) in radians -> rotation matrix (..., 3, 3)."""
    w = np.asarray(w, dtype=np.float64)
    a, b, _ = _rodrigues_coefficients(np.sum(w * w, axis=-1))
    K = hat(w)
    return np.eye(3) + a[..., None, None] * K + b[..., None, None] * (K @ K)


def so3_log(R: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3) -> rotation vector (..., 3) in radians, of length at most pi."""
    q = quaternion_from_matrix(R)
    w, v = q[..., 0], q[..., 1:]
    n = np.linalg.norm(v, axis=-1)
    small = n < 1e-9
    scale = np.where(small, 2.0 / np.maximum(w, 1e-12), 2.0 * np.arctan2(n, w) / np.where(small, 1.0, n))
    return np.asarray(v * scale[..., None])


def se3_exp(xi: ArrayLike) -> Array:
    """Twist (..., 6) = (translation, rotation) -> rigid transform (..., 4, 4)."""
    xi = np.asarray(xi, dtype=np.float64)
    rho, w = xi[..., :3], xi[..., 3:]
    a, b, c = _rodrigues_coefficients(np.sum(w * w, axis=-1))
    K = hat(w)
    K2 = K @ K
    T = np.zeros((*xi.shape[:-1], 4, 4))
    T[..., :3, :3] = np.eye(3) + a[..., None, None] * K + b[..., None, None] * K2
    V = np.eye(3) + b[..., None, None] * K + c[..., None, None] * K2
    T[..., :3, 3] = (V @ rho[..., None])[..., 0]
    T[..., 3, 3] = 1.0
    return T


def se3_log(T: ArrayLike) -> Array:
    """Rigid transform (..., 4, 4) -> twist (..., 6) = (translation, rotation)."""
    T = np.asarray(T, dtype=np.float64)
    w = so3_log(T[..., :3, :3])
    _, b, c = _rodrigues_coefficients(np.sum(w * w, axis=-1))
    K = hat(w)
    V = np.eye(3) + b[..., None, None] * K + c[..., None, None] * (K @ K)
    rho = np.linalg.solve(V, T[..., :3, 3][..., None])[..., 0]
    return np.concatenate([rho, w], axis=-1)


def make_pose(R: ArrayLike, t: ArrayLike) -> Array:
    """Rotation (..., 3, 3) and translation (..., 3) -> rigid transform (..., 4, 4)."""
    R, t = np.asarray(R, dtype=np.float64), np.asarray(t, dtype=np.float64)
    T = np.zeros((*np.broadcast_shapes(R.shape[:-2], t.shape[:-1]), 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def invert_pose(T: ArrayLike) -> Array:
    """The inverse of a rigid transform (..., 4, 4)."""
    T = np.asarray(T, dtype=np.float64)
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return make_pose(Rt, -(Rt @ T[..., :3, 3][..., None])[..., 0])


def renormalise(T: ArrayLike) -> Array:
    """The nearest rigid transform (..., 4, 4), by an SVD of the rotation: products of poses drift off SO(3)."""
    T = np.array(T, dtype=np.float64)
    U, _, Vt = np.linalg.svd(T[..., :3, :3])
    d = np.linalg.det(U @ Vt)
    U[..., :, 2] *= d[..., None]
    T[..., :3, :3] = U @ Vt
    T[..., 3, :] = [0.0, 0.0, 0.0, 1.0]
    return T


def quaternion_from_matrix(R: ArrayLike) -> Array:
    """Rotation matrix (..., 3, 3) -> unit quaternion (..., 4) as (w, x, y, z) with w >= 0."""
    from scipy.spatial.transform import Rotation

    R = np.asarray(R, dtype=np.float64)
    q = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat()[:, [3, 0, 1, 2]].reshape(*R.shape[:-2], 4)
    return np.where(q[..., :1] < 0, -q, q)


def matrix_from_quaternion(q: ArrayLike) -> Array:
    """Quaternion (..., 4) as (w, x, y, z), of any length but zero -> rotation matrix (..., 3, 3)."""
    w, x, y, z = np.moveaxis(np.asarray(q, dtype=np.float64), -1, 0)
    norm = np.sqrt(x * x + y * y + z * z + w * w)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def quat_from_matrix(R: ArrayLike) -> Array:
    """Deprecated: ``quaternion_from_matrix`` as (x, y, z, w), which plugins for contract 1.0 may use."""
    _warn_of_order("quat_from_matrix", "quaternion_from_matrix")
    return quaternion_from_matrix(R)[..., [1, 2, 3, 0]]


def matrix_from_quat(q: ArrayLike) -> Array:
    """Deprecated: ``matrix_from_quaternion`` of (x, y, z, w), which plugins for contract 1.0 may use."""
    _warn_of_order("matrix_from_quat", "matrix_from_quaternion")
    return matrix_from_quaternion(np.asarray(q, dtype=np.float64)[..., [3, 0, 1, 2]])


def _warn_of_order(old: str, new: str) -> None:
    message = f"{old} uses (x, y, z, w) and goes with contract 2: use {new}, which uses (w, x, y, z)"
    warnings.warn(message, DeprecationWarning, stacklevel=3)


@dataclass(frozen=True)
class Sim3:
    """The similarity x -> scale R x + t, with R (3, 3) and t (3,)."""

    scale: float
    R: Array
    t: Array

    def apply_points(self, points: ArrayLike) -> Array:
        """Points (..., 3) -> points (..., 3)."""
        return np.asarray(self.scale * (np.asarray(points) @ self.R.T) + self.t)

    def apply_poses(self, T_wc: ArrayLike) -> Array:
        """Camera-to-world poses (..., 4, 4) -> those in the target world, still rigid."""
        T_wc = np.asarray(T_wc, dtype=np.float64)
        return make_pose(self.R @ T_wc[..., :3, :3], self.apply_points(T_wc[..., :3, 3]))

    def inverse(self) -> Sim3:
        Rt = self.R.T
        return Sim3(1.0 / self.scale, Rt, -(Rt @ self.t) / self.scale)


def umeyama(source: ArrayLike, target: ArrayLike, with_scale: bool = True) -> Sim3:
    """The Sim(3), or SE(3) without scale, that takes source points (N, 3) onto target points (N, 3) in least squares.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns" (PAMI 1991). With fewer
    than three distinct points the rotation is not unique; the result is then one of the minimisers.
    """
    p, q = np.asarray(source, dtype=np.float64), np.asarray(target, dtype=np.float64)
    mp, mq = p.mean(axis=0), q.mean(axis=0)
    pc, qc = p - mp, q - mq
    U, S, Vt = np.linalg.svd(qc.T @ pc / len(p))
    D = np.eye(3)
    if np.linalg.det(U) * np.linalg.det(Vt) < 0:
        D[2, 2] = -1.0
    R = U @ D @ Vt
    var = float((pc**2).sum() / len(p))
    scale = float(np.trace(np.diag(S) @ D) / var) if with_scale and var > 0 else 1.0
    return Sim3(scale, R, mq - scale * R @ mp)


def distances_along(points: ArrayLike) -> Array:
    """(N,): how far each of points (N, D) lies along the line through them, from the first; the last is its length."""
    steps = np.linalg.norm(np.diff(np.asarray(points, dtype=np.float64), axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def directions_from_lonlat(lon: ArrayLike, lat: ArrayLike) -> Array:
    """Longitude, latitude (...) in radians -> unit rays (..., 3): lon = atan2(x, z), lat = atan2(-y, hypot(x, z))."""
    lon, lat = np.asarray(lon, dtype=np.float64), np.asarray(lat, dtype=np.float64)
    c = np.cos(lat)
    return np.stack([c * np.sin(lon), -np.sin(lat), c * np.cos(lon)], axis=-1)


def lonlat_from_directions(rays: ArrayLike) -> tuple[Array, Array]:
    """Rays (..., 3) of any length -> longitude in (-pi, pi] and latitude in [-pi/2, pi/2], radians."""
    r = np.asarray(rays, dtype=np.float64)
    return np.arctan2(r[..., 0], r[..., 2]), np.arctan2(-r[..., 1], np.hypot(r[..., 0], r[..., 2]))


def fibonacci_sphere(n: int) -> Array:
    """n unit directions (n, 3) of nearly equal area: the spherical Fibonacci lattice (Gonzalez 2010)."""
    k = np.arange(n) + 0.5
    y = 1.0 - 2.0 * k / n
    phi = np.pi * (3.0 - np.sqrt(5.0)) * k
    r = np.sqrt(np.maximum(0.0, 1.0 - y * y))
    return np.stack([r * np.sin(phi), -y, r * np.cos(phi)], axis=-1)
