"""Rotation between two frames from small blurred images: a prior for tracking that needs no motion model.

Inverse-compositional Gauss-Newton on SO(3) over all pixels of the coarsest faces. Small blurry images are used as in
Klein & Murray, "Improving the agility of keyframe-based SLAM" (ECCV 2008), here on the whole sphere.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import renormalise, so3_exp
from panobench.kernels.jit import njit
from panobench.methods.sparse.faces import FaceSet
from panobench.methods.sparse.patches import _best_face, _bilinear, _to_face

Array = NDArray[np.float64]

#: Residual from which the Huber loss is linear, grey levels.
HUBER = 8.0
#: Pixels per radian of the small images. At fifteen, a rotation by ten degrees is less than three pixels.
RESOLUTION = 15.0


def _halve(image: NDArray[np.float32], times: int) -> NDArray[np.float32]:
    """Means of 2^times x 2^times pixels. Incomplete blocks at the right and lower edge are left out."""
    size = 1 << times
    h, w = image.shape[0] // size, image.shape[1] // size
    blocks = image[: h * size, : w * size].reshape(h, size, w, size)
    return np.asarray(blocks.mean(axis=(1, 3)), dtype=np.float32)


@njit(cache=True, nogil=True)
def _normal_equations(image, valid, R_fc, K, scale, R, rays, values, J, H, g):  # type: ignore[no-untyped-def]
    """Adds J^T w J to H and J^T w r to g. Returns the mean loss of the visible pixels, and their number."""
    loss, seen = 0.0, 0
    h, w = valid.shape[1], valid.shape[2]
    for n in range(len(rays)):
        x = R[0, 0] * rays[n, 0] + R[0, 1] * rays[n, 1] + R[0, 2] * rays[n, 2]
        y = R[1, 0] * rays[n, 0] + R[1, 1] * rays[n, 1] + R[1, 2] * rays[n, 2]
        z = R[2, 0] * rays[n, 0] + R[2, 1] * rays[n, 1] + R[2, 2] * rays[n, 2]
        f, cosine = _best_face(R_fc, x, y, z)
        if cosine < 0.1:
            continue
        u, v = _to_face(R_fc, K, f, x, y, z)
        if u < 1 or v < 1 or u > w - 1 or v > h - 1 or not valid[f, int(v), int(u)]:
            continue
        r = _bilinear(image[f], u * scale, v * scale) - values[n]
        a = abs(r)
        weight = 1.0 if a < HUBER else HUBER / a
        loss += r * r if a < HUBER else 2 * HUBER * a - HUBER * HUBER
        seen += 1
        for i in range(3):
            g[i] += weight * J[n, i] * r
            for j in range(3):
                H[i, j] += weight * J[n, i] * J[n, j]
    return loss / max(seen, 1), seen


class RotationFinder:
    """Keeps the last two frames as small images. ``rotation`` is computed only when it is called."""

    def __init__(self, face_set: FaceSet, levels: int) -> None:
        self.face_set = face_set
        self.top = levels - 1
        self.level = max(self.top, round(np.log2(face_set.focal / RESOLUTION)))
        self.scale = 1.0 / (1 << self.level)
        self.size = (face_set.size[0] >> self.level, face_set.size[1] >> self.level)
        u, v = np.meshgrid(np.arange(self.size[1]) + 0.5, np.arange(self.size[0]) + 0.5)
        pixels = np.column_stack([u.ravel(), v.ravel()]) / self.scale
        self.index = [np.flatnonzero(_halve(c.astype(np.float32), self.level).ravel() > 0.5) for c in face_set.core]
        self.rays = np.concatenate([face_set.rays(f, pixels[i]) for f, i in enumerate(self.index)])
        self._last: NDArray[np.float32] | None = None
        self._before: NDArray[np.float32] | None = None

    def push(self, pyramid: list[NDArray[np.uint8]]) -> None:
        """Add the next frame."""
        self._before = self._last
        self._last = np.stack([self._small(f) for f in pyramid[self.top]])

    def rotation(self) -> Array:
        """R (3, 3) that takes rays of the frame before to the last one. The identity without two frames."""
        if self._before is None or self._last is None or len(self.rays) == 0:
            return np.eye(3)
        values = np.concatenate([f.ravel()[i] for f, i in zip(self._before, self.index)]).astype(np.float64)
        return self._align(self._last, values, self._jacobian(self._before))

    def _small(self, face: NDArray[np.uint8]) -> NDArray[np.float32]:
        small = _halve(face.astype(np.float32), self.level - self.top)
        return np.asarray(cv2.GaussianBlur(small, (0, 0), 1.0), dtype=np.float32)

    def _jacobian(self, faces: NDArray[np.float32]) -> Array:
        """d(value) / d(w) (N, 3) for rays rotated by exp(w)."""
        fx, fy = self.face_set.intrinsics[:2] * self.scale
        parts, start = [], 0
        for f, index in enumerate(self.index):
            gv, gu = np.gradient(faces[f].astype(np.float64))
            rays = self.rays[start : start + len(index)]
            start += len(index)
            p = rays @ self.face_set.R_fc[f].T
            x, y, z = p.T
            a, b = gu.ravel()[index] * fx / z, gv.ravel()[index] * fy / z
            along = np.column_stack([a, b, -(a * x + b * y) / z]) @ self.face_set.R_fc[f]
            parts.append(np.cross(rays, along))
        return np.concatenate(parts)

    def _align(self, faces: NDArray[np.float32], values: Array, J: Array) -> Array:
        R, best, best_loss = np.eye(3), np.eye(3), np.inf
        for _ in range(15):
            H, g = np.zeros((3, 3)), np.zeros(3)
            face_set = self.face_set
            loss, seen = _normal_equations(
                faces, face_set.valid, face_set.R_fc, face_set.intrinsics, self.scale, R, self.rays, values, J, H, g
            )
            if seen < 0.3 * len(self.rays) or loss >= best_loss:
                break
            best, best_loss = R, loss
            if np.linalg.cond(H) > 1e8:
                break
            step = np.linalg.solve(H, g)
            T = np.eye(4)
            T[:3, :3] = R @ so3_exp(-step)
            R = renormalise(T)[:3, :3]
            if float(np.linalg.norm(step)) < 1e-4:
                break
        return best
