"""The large planes of a scene, found in rendered depth: the one that explains the most, again and again.

RANSAC (Fischler and Bolles 1981) with one point and its normal for a candidate, refined by Tukey's M-estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.posed_panoramas import PosedPanoramas

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

#: Most planes, and the least part of the evidence that one must explain.
MOST, LEAST = 14, 0.008
#: Points this near (over their distance from the camera) belong to a plane; candidates tried for each.
NEAR, TRIES = 0.01, 600
#: Pixels in each direction of which one is used.
STRIDE = 3
#: A step of depth that is larger than this part of it is an edge.
EDGE = 0.04


@dataclass(frozen=True)
class Plane:
    """The points X of the world with normal . X = offset; the normal (3,) has unit length."""

    normal: Array
    offset: float

    def depth(self, rays: Array, centre: Array) -> NDArray[np.float32]:
        """Radial depth (...) along unit rays (..., 3) from the centre (3,), NaN where the plane is not ahead."""
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = (self.offset - self.normal @ centre) / (rays @ self.normal)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float32)


@dataclass(frozen=True)
class _Points:
    """X, normal (N, 3), distance from the camera and weight (N,)."""

    X: Array
    normal: Array
    distance: Array
    weight: Array


def find_planes(views: PosedPanoramas, generator: np.random.Generator) -> list[Plane]:
    """The large planes of a scene, in the order of their evidence."""
    return _consensus(_points(views), generator)


def depth_edges(depth: NDArray[np.float32]) -> Mask:
    """(H, W): within two pixels of a jump of depth (H, W)."""
    square = np.ones((5, 5), np.uint8)
    return np.asarray(cv2.dilate(depth, square) > (1 + EDGE) * cv2.erode(depth, square))


def normals_of(depth: NDArray[np.float32], rays: NDArray[np.floating]) -> Array:
    """Unit normals (H, W, 3) of the points depth * rays, from means over 5 x 5 pixels."""
    mean = cv2.blur(depth[..., None] * rays, (5, 5))
    across = np.roll(mean, -2, axis=1) - np.roll(mean, 2, axis=1)
    down = np.roll(mean, -2, axis=0) - np.roll(mean, 2, axis=0)
    normal = np.cross(across, down)
    return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12))


def _points(views: PosedPanoramas) -> _Points:
    """Points of the rendered depth; they weigh their area, and where nothing has texture one part in fifty of it."""
    area = views.scale.camera.solid_angle()
    parts: list[tuple[Array, ...]] = []
    for k, (luma, depth) in enumerate(zip(views.luma, views.depth)):
        rays = views.rays(k)
        use = np.zeros(depth.shape, bool)
        use[::STRIDE, ::STRIDE] = True
        use &= views.scale.valid & ~depth_edges(depth)
        weight = area * depth**2 * np.clip(_texture(luma) / 0.02, 0.02, 1.0)
        X = (depth[..., None] * rays)[use] + views.T_wc[k, :3, 3]
        parts.append((X, normals_of(depth, rays)[use], depth[use].astype(np.float64), weight[use]))
    return _Points(*(np.concatenate(columns) for columns in zip(*parts)))


def _texture(luma: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W): size of the gradient of luma (H, W), of 1 per pixel, around each pixel."""
    soft = cv2.GaussianBlur(np.nan_to_num(luma), (0, 0), 0.8)
    across, down = cv2.Sobel(soft, cv2.CV_32F, 1, 0) / 8, cv2.Sobel(soft, cv2.CV_32F, 0, 1) / 8
    return np.asarray(np.sqrt(cv2.GaussianBlur(across**2 + down**2, (0, 0), 1.5)), np.float32)


def _consensus(points: _Points, generator: np.random.Generator) -> list[Plane]:
    """The plane with the most evidence, again and again among the points that are left."""
    free, total = np.arange(len(points.X)), points.weight.sum()
    planes: list[Plane] = []
    while len(planes) < MOST and len(free) > 500:
        left = _Points(points.X[free], points.normal[free], points.distance[free], points.weight[free])
        plane = _refit(_best_candidate(left, generator), left)
        distance = np.abs(left.X @ plane.normal - plane.offset) / left.distance
        along = np.abs(left.normal @ plane.normal)
        if left.weight[(distance < 1.5 * NEAR) & (along > 0.8)].sum() < LEAST * total:
            break
        planes.append(plane)
        free = free[(distance > 2.5 * NEAR) | (along < 0.7)]
    return planes


def _best_candidate(points: _Points, generator: np.random.Generator) -> Plane:
    """The best of the planes through single points and along their surfaces."""
    count = len(points.X)
    judges = generator.choice(count, min(count, 12_000), replace=False)
    seeds = generator.choice(count, TRIES, p=points.weight / points.weight.sum())
    best, found = -1.0, Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    for some in np.array_split(seeds, TRIES // 100):
        normals = points.normal[some]
        offsets = (normals * points.X[some]).sum(axis=1)
        near = np.abs(points.X[judges] @ normals.T - offsets) < NEAR * points.distance[judges, None]
        near &= np.abs(points.normal[judges] @ normals.T) > 0.9
        support = points.weight[judges] @ near
        if support.max() > best:
            best, j = float(support.max()), int(support.argmax())
            found = Plane(normals[j], float(offsets[j]))
    return found


def _refit(plane: Plane, points: _Points) -> Plane:
    """Least squares with Tukey's weights, twice as wide at first; distances count over those from the camera."""
    for k in range(8):
        reach = NEAR * (2 if k < 3 else 1)
        residual = (points.X @ plane.normal - plane.offset) / points.distance
        weight = points.weight * np.clip(1 - (residual / reach) ** 2, 0, None) ** 2 / points.distance**2
        weight *= np.abs(points.normal @ plane.normal) > 0.85
        if (weight > 0).sum() < 200:
            return plane
        mean = weight @ points.X / weight.sum()
        centred = (points.X - mean) * np.sqrt(weight)[:, None]
        normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
        normal = normal if normal @ plane.normal > 0 else -normal
        plane = Plane(normal, float(normal @ mean))
    return plane
