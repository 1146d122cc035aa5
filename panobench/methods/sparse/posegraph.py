"""Pose graph over Sim(3): spreads a loop's correction over the keyframes, scale drift included.

A node takes camera coordinates to the world: x_w = s R x_c + t. Gauss-Newton with analytic Jacobians on the relative
transforms between nodes (Strasdat, Montiel, Davison, "Scale drift-aware large scale monocular SLAM", RSS 2010).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from panobench.geometry import hat, so3_exp, so3_log

Array = NDArray[np.float64]

#: Translations count at this weight beside angles in radians and logarithms of scale: the map's median distance is 2.
TRANSLATION_WEIGHT = 0.5


@dataclass
class Similarities:
    """N transforms: scale (N,), R (N, 3, 3), t (N, 3)."""

    scale: Array
    R: Array
    t: Array

    def between(self, i: NDArray[np.int64], j: NDArray[np.int64]) -> Similarities:
        """Node j seen from node i, for index arrays (E,)."""
        Rt = np.swapaxes(self.R[i], 1, 2)
        t = np.einsum("nij,nj->ni", Rt, self.t[j] - self.t[i]) / self.scale[i][:, None]
        return Similarities(self.scale[j] / self.scale[i], Rt @ self.R[j], t)

    def copy(self) -> Similarities:
        return Similarities(self.scale.copy(), self.R.copy(), self.t.copy())


def _residuals(nodes: Similarities, i: NDArray[np.int64], j: NDArray[np.int64], measured: Similarities) -> Array:
    now = nodes.between(i, j)
    turn = so3_log(np.swapaxes(measured.R, 1, 2) @ now.R)
    shift = TRANSLATION_WEIGHT * (now.t - measured.t)
    return np.concatenate([shift, turn, np.log(now.scale / measured.scale)[:, None]], axis=1)


def _jacobians(nodes: Similarities, i: NDArray[np.int64], j: NDArray[np.int64]) -> tuple[Array, Array]:
    """d residual / d(t, w, log s) of node i and of node j, (E, 7, 7) each; R moves on the right."""
    now = nodes.between(i, j)
    Ji, Jj = np.zeros((len(i), 7, 7)), np.zeros((len(i), 7, 7))
    Rt = np.swapaxes(nodes.R[i], 1, 2) / nodes.scale[i][:, None, None]
    Ji[:, :3, :3], Jj[:, :3, :3] = -TRANSLATION_WEIGHT * Rt, TRANSLATION_WEIGHT * Rt
    Ji[:, :3, 3:6] = TRANSLATION_WEIGHT * hat(now.t)
    Ji[:, :3, 6] = -TRANSLATION_WEIGHT * now.t
    Ji[:, 3:6, 3:6] = -np.swapaxes(now.R, 1, 2)
    Jj[:, 3:6, 3:6] = np.eye(3)
    Ji[:, 6, 6], Jj[:, 6, 6] = -1.0, 1.0
    return Ji, Jj


def optimise_pose_graph(
    nodes: Similarities,
    i: NDArray[np.int64],
    j: NDArray[np.int64],
    measured: Similarities,
    weights: Array,
    fixed: int = 0,
    iterations: int = 15,
) -> Similarities:
    """Move all nodes but ``fixed`` so that node j seen from node i is as ``measured`` (E edges, weights (E,))."""
    nodes = nodes.copy()
    n = len(nodes.scale)
    r = _residuals(nodes, i, j, measured)
    cost = float(np.sum(weights[:, None] * r * r))
    damping = 1e-6
    for _ in range(iterations):
        Ji, Jj = _jacobians(nodes, i, j)
        H, g = _normal_equations(n, i, j, Ji, Jj, r, weights)
        improved = False
        for _ in range(6):
            D = H.copy()
            D.setdiag(D.diagonal() * (1 + damping) + 1e-12)
            hold = slice(7 * fixed, 7 * fixed + 7)
            keep = np.ones(7 * n, bool)
            keep[hold] = False
            x = np.zeros(7 * n)
            x[keep] = -spsolve(D[keep][:, keep].tocsc(), g[keep])
            step = x.reshape(n, 7)
            trial = Similarities(
                nodes.scale * np.exp(step[:, 6]), nodes.R @ so3_exp(step[:, 3:6]), nodes.t + step[:, :3]
            )
            new_r = _residuals(trial, i, j, measured)
            new = float(np.sum(weights[:, None] * new_r * new_r))
            if new < cost:
                improved = True
                break
            damping = max(10 * damping, 1e-6)
        if not improved:
            break
        done = cost - new < 1e-9 * cost
        nodes, r, cost, damping = trial, new_r, new, 0.1 * damping
        if done:
            break
    return nodes


def _normal_equations(
    n: int, i: NDArray[np.int64], j: NDArray[np.int64], Ji: Array, Jj: Array, r: Array, weights: Array
) -> tuple[coo_matrix, Array]:
    w = weights[:, None, None]
    rows, columns, values = [], [], []
    lane = np.arange(7)
    for a, Ja in ((i, Ji), (j, Jj)):
        for b, Jb in ((i, Ji), (j, Jj)):
            block = np.swapaxes(Ja, 1, 2) @ (w * Jb)
            rows.append(np.broadcast_to((7 * a[:, None] + lane)[:, :, None], block.shape).ravel())
            columns.append(np.broadcast_to((7 * b[:, None] + lane)[:, None, :], block.shape).ravel())
            values.append(block.ravel())
    H = coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), (7 * n, 7 * n)).tocsr()
    g = np.zeros((n, 7))
    np.add.at(g, i, np.einsum("nab,na->nb", Ji, weights[:, None] * r))
    np.add.at(g, j, np.einsum("nab,na->nb", Jj, weights[:, None] * r))
    return H, g.ravel()
