"""The sliding window: keyframes, their points, and photometric bundle adjustment of both.

Unknowns are the pose (left perturbation), gain and offset of each free keyframe, and the inverse distance of each
point in its host keyframe. The Jacobian by the host follows from that by the target through the adjoint of their
relative pose, so the normal equations are accumulated per pair of keyframes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import hat, invert_pose, renormalise, se3_exp
from panobench.methods.direct.config import DirectConfig
from panobench.methods.direct.kernels import FRAME, PATTERN, SIZE, window_system
from panobench.methods.sparse.faces import FaceSet

Array = NDArray[np.float64]

#: Weights of the priors that keep gains (relative) and offsets (grey levels) near zero.
GAIN_PRIOR, OFFSET_PRIOR = 1e4, 0.1
#: Bundle adjustment removes points that are inliers in fewer other keyframes than this.
MIN_TARGETS = 2


@dataclass
class DirectKeyframe:
    """T_cw (4, 4). affine (2,): gain and offset of its intensities. pyramid: its faces on each level."""

    number: int
    frame: int
    T_cw: Array
    pyramid: list[NDArray[np.uint8]]
    affine: Array = field(default_factory=lambda: np.zeros(2))


@dataclass
class PointCloud:
    """Points in parallel arrays. host: position of the host keyframe in the window. bearing (N, 3). rho, low, high:
    inverse distance and its bounds. colour (N, levels, 8): intensities of the pattern.

    hits, misses (candidates only): how often tracing found the point, and how often in a row it did not.
    """

    host: NDArray[np.int64]
    bearing: Array
    rho: Array
    low: Array
    high: Array
    colour: Array
    hits: NDArray[np.int64]
    misses: NDArray[np.int64]

    @staticmethod
    def empty(levels: int) -> PointCloud:
        none = np.zeros(0)
        index = np.zeros(0, np.int64)
        return PointCloud(index, np.zeros((0, 3)), none, none, none, np.zeros((0, levels, SIZE)), index, index)

    def __len__(self) -> int:
        return len(self.host)

    def select(self, keep: NDArray[Any]) -> PointCloud:
        """The points at a mask or an index."""
        return PointCloud(*(getattr(self, name)[keep] for name in _COLUMNS))

    def joined(self, other: PointCloud) -> PointCloud:
        """Both clouds' points, these first."""
        return PointCloud(*(np.concatenate([getattr(self, n), getattr(other, n)]) for n in _COLUMNS))


_COLUMNS = ("host", "bearing", "rho", "low", "high", "colour", "hits", "misses")


@dataclass
class Window:
    """Keyframes in order of time. Points and candidates refer to them by their position in the list."""

    config: DirectConfig
    face_set: FaceSet
    levels: int
    keyframes: list[DirectKeyframe] = field(default_factory=list)
    points: PointCloud = field(default_factory=lambda: PointCloud.empty(0))
    candidates: PointCloud = field(default_factory=lambda: PointCloud.empty(0))

    def poses(self) -> Array:
        """T_cw (K, 4, 4)."""
        return np.stack([k.T_cw for k in self.keyframes])

    def affines(self) -> Array:
        """(K, 2)."""
        return np.stack([k.affine for k in self.keyframes])

    def positions(self, cloud: PointCloud) -> Array:
        """World positions (N, 3)."""
        T_wc = invert_pose(self.poses())[cloud.host]
        local = cloud.bearing / np.maximum(cloud.rho, 1e-6)[:, None]
        return np.asarray(np.einsum("nij,nj->ni", T_wc[:, :3, :3], local) + T_wc[:, :3, 3])

    def drop_oldest(self) -> None:
        """Remove the oldest keyframe with its points and candidates."""
        self.keyframes.pop(0)
        for name in ("points", "candidates"):
            cloud = getattr(self, name).select(getattr(self, name).host > 0)
            cloud.host = cloud.host - 1
            setattr(self, name, cloud)

    def adjust(self, iterations: int) -> None:
        """Bundle adjustment of all points and the keyframes that are not fixed. Removes badly observed points."""
        if len(self.keyframes) < 2 or len(self.points) == 0:
            return
        held = min(self.config.held, max(1, len(self.keyframes) - 2))
        state = _State(self.poses(), self.affines(), self.points.rho.copy())
        images = np.stack([k.pyramid[0] for k in self.keyframes])
        system = self._linearise(images, state)
        damping = 1e-3
        for _ in range(iterations):
            trial = self._step(system, state, held, damping)
            new = self._linearise(images, trial)
            if new.energy < system.energy:
                small = system.energy - new.energy < 1e-4 * system.energy
                state, system, damping = trial, new, max(damping * 0.2, 1e-6)
                if small:
                    break
            else:
                damping *= 10
                if damping > 1e3:
                    break
        for keyframe, T, affine in zip(self.keyframes, state.T_cw, state.affine):
            keyframe.T_cw, keyframe.affine = T, affine
        self.points.rho = state.rho
        newest = len(self.keyframes) - 1
        wanted = np.minimum(MIN_TARGETS, newest)
        good = (system.good >= wanted) & (state.rho > 1e-4)
        self.points = self.points.select(good)

    def _linearise(self, images: NDArray[np.uint8], state: _State) -> _System:
        c, face_set, p = self.config, self.face_set, self.points
        K, N = len(state.T_cw), len(p)
        rel = state.T_cw[:, None] @ invert_pose(state.T_cw)[None]
        affine = state.affine[:, None] - state.affine[None]
        s = _System(
            np.zeros((K, K, FRAME, FRAME)),
            np.zeros((K, K, FRAME)),
            np.zeros((N, K, FRAME)),
            np.zeros(N),
            np.zeros(N),
            np.zeros(N, np.int64),
            rel,
        )
        cut = SIZE * c.outlier**2
        s.energy = window_system(
            images, face_set.valid, face_set.R_fc, face_set.intrinsics,
            np.ascontiguousarray(rel[..., :3, :3]), np.ascontiguousarray(rel[..., :3, 3]),
            p.host, p.bearing, state.rho, np.ascontiguousarray(p.colour[:, 0]), affine, 1.0 / face_set.focal,
            PATTERN, c.gradient_softening, c.huber, cut, s.H, s.g, s.Htr, s.Hrr, s.gr, s.good,
        )  # fmt: skip
        s.patterns = int(s.good.sum())
        # Patterns that are out of view or outliers in one state only must not make that state cheaper.
        s.energy += cut * (N * (K - 1) - s.patterns) * 0.25
        prior = np.array([GAIN_PRIOR, OFFSET_PRIOR])
        s.energy += float(np.sum(prior * state.affine**2))
        return s

    def _step(self, s: _System, state: _State, held: int, damping: float) -> _State:
        """The state after one damped Gauss-Newton step."""
        K = len(state.T_cw)
        H, g = np.zeros((K, FRAME, K, FRAME)), np.zeros((K, FRAME))
        C = np.zeros((len(state.rho), K, FRAME))
        host = self.points.host
        for k in range(K):
            for h in range(K):
                if k == h:
                    continue
                A = _host_factor(s.rel[k, h])
                M = np.triu(s.H[k, h]) + np.triu(s.H[k, h], 1).T
                H[k, :, k] += M
                H[h, :, h] += A.T @ M @ A
                H[k, :, h] += M @ A
                H[h, :, k] += A.T @ M
                g[k] += s.g[k, h]
                g[h] += A.T @ s.g[k, h]
                mine = host == h
                C[mine, k] += s.Htr[mine, k]
                C[mine, h] += s.Htr[mine, k] @ A
        prior = np.array([GAIN_PRIOR, OFFSET_PRIOR])
        for k in range(K):
            H[k, [6, 7], k, [6, 7]] += prior
            g[k, 6:] += prior * state.affine[k]
        free = slice(held * FRAME, K * FRAME)
        Hf, gf = H.reshape(K * FRAME, -1)[free, free], g.reshape(-1)[free]
        Cf = C.reshape(len(C), -1)[:, free]
        # A weak prior keeps badly observed depths where they are.
        Hrr = s.Hrr * (1 + damping) + 1.0
        Hf = Hf + np.diag(damping * np.diag(Hf) + 1e-6)
        reduced = Hf - Cf.T @ (Cf / Hrr[:, None])
        x = -np.linalg.solve(reduced, gf - Cf.T @ (s.gr / Hrr))
        move = -(s.gr + Cf @ x) / Hrr
        limit = 0.3 * np.maximum(state.rho, 0.02)
        full = np.zeros((K, FRAME))
        full[held:] = x.reshape(-1, FRAME)
        return _State(
            renormalise(se3_exp(full[:, :6]) @ state.T_cw),
            state.affine + full[:, 6:],
            np.maximum(state.rho + np.clip(move, -limit, limit), 1e-5),
        )


@dataclass
class _State:
    """Poses (K, 4, 4), gain and offset (K, 2) and inverse distances (N,)."""

    T_cw: Array
    affine: Array
    rho: Array


@dataclass
class _System:
    """The normal equations of ``window_system``, and the relative poses (K, K, 4, 4) they were made at."""

    H: Array
    g: Array
    Htr: Array
    Hrr: Array
    gr: Array
    good: NDArray[np.int64]
    rel: Array
    energy: float = 0.0
    patterns: int = 0


def _host_factor(T: Array) -> Array:
    """(8, 8): the derivative by the host is minus the adjoint times that by the target; gain and offset change sign."""
    R, t = T[:3, :3], T[:3, 3]
    A = np.zeros((FRAME, FRAME))
    A[:3, :3] = A[3:6, 3:6] = -R
    A[:3, 3:6] = -hat(t) @ R
    A[6, 6] = A[7, 7] = -1.0
    return A
