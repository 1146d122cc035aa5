"""Choosing pixels to track, and finding their inverse distance."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from panobench.geometry import invert_pose
from panobench.methods.direct.kernels import PATTERN, SIZE, cut_colours, trace
from panobench.methods.direct.window import PointCloud, Window
from panobench.methods.sparse.faces import FaceSet

Array = NDArray[np.float64]

#: A pixel's gradient must exceed the mean of its surroundings by this, grey levels per pixel.
ABOVE_MEAN = 4.0
#: A candidate becomes a point when the relative uncertainty of its inverse distance is below this.
MAX_UNCERTAINTY = 0.12


def choose_pixels(face_set: FaceSet, faces: NDArray[np.uint8], wanted: int, occupied: Array) -> Array:
    """Unit bearings (N, 3) of about ``wanted`` pixels: the steepest one of each unoccupied grid cell."""
    area = int(face_set.core.sum())
    if wanted <= 0 or area == 0:
        return np.empty((0, 3))
    cell = max(4, int(np.sqrt(area / (wanted + len(occupied)))))
    found = []
    for f in range(face_set.count):
        image = cv2.GaussianBlur(faces[f], (3, 3), 0)
        gx = cv2.Sobel(image, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
        gy = cv2.Sobel(image, cv2.CV_32F, 0, 1, ksize=1, scale=0.5)
        steep = np.sqrt(gx * gx + gy * gy)  # cv2.magnitude's last bit depends on where the array lies in memory
        h, w = steep.shape
        small = cv2.resize(steep, (max(1, w // 32), max(1, h // 32)), interpolation=cv2.INTER_AREA)
        around = cv2.resize(cv2.blur(small, (3, 3)), (w, h), interpolation=cv2.INTER_LINEAR)
        steep[(steep < around + ABOVE_MEAN) | ~face_set.core[f]] = 0
        rows, columns = h // cell, w // cell
        blocks = steep[: rows * cell, : columns * cell].reshape(rows, cell, columns, cell).swapaxes(1, 2)
        flat = blocks.reshape(rows, columns, -1)
        best = flat.argmax(axis=2)
        taken = np.zeros((rows, columns), bool)
        _mark_occupied(taken, face_set, f, occupied, cell)
        i, j = np.nonzero((flat.max(axis=2) > 0) & ~taken)
        at = best[i, j]
        pixels = np.column_stack([j * cell + at % cell + 0.5, i * cell + at // cell + 0.5])
        if len(pixels):
            found.append(face_set.rays(f, pixels))
    return np.concatenate(found) if found else np.empty((0, 3))


def _mark_occupied(taken: NDArray[np.bool_], face_set: FaceSet, face: int, occupied: Array, cell: int) -> None:
    if len(occupied) == 0:
        return
    fx, fy, cx, cy = face_set.intrinsics
    p = occupied @ face_set.R_fc[face].T
    p = p[p[:, 2] > 0.3]
    j, i = ((fx * p[:, 0] / p[:, 2] + cx) // cell).astype(int), ((fy * p[:, 1] / p[:, 2] + cy) // cell).astype(int)
    inside = (i >= 0) & (j >= 0) & (i < taken.shape[0]) & (j < taken.shape[1])
    taken[i[inside], j[inside]] = True


def make_points(
    face_set: FaceSet, pyramid: list[NDArray[np.uint8]], bearings: Array, host: int, rho: Array, low: Array, high: Array
) -> PointCloud:
    """Points of one host keyframe with their patterns' intensities on all levels, without those at a border."""
    colour = np.empty((len(bearings), len(pyramid), SIZE))
    for level, image in enumerate(pyramid):
        scale = 1.0 / (1 << level)
        out = np.empty((len(bearings), SIZE))
        cut_colours(
            image, face_set.R_fc, face_set.intrinsics, scale, bearings, 1.0 / (face_set.focal * scale), PATTERN, out
        )
        colour[:, level] = out
    zero = np.zeros(len(bearings), np.int64)
    cloud = PointCloud(np.full(len(bearings), host), bearings, rho, low, high, colour, zero, zero.copy())
    whole: NDArray[np.bool_] = np.isfinite(colour[:, 0].sum(axis=1))
    return cloud.select(np.asarray(whole))


def add_candidates(window: Window) -> None:
    """Pixels of the newest keyframe, with a guess of their distance from the points around."""
    newest = window.keyframes[-1]
    known = window.positions(window.points) @ newest.T_cw[:3, :3].T + newest.T_cw[:3, 3]
    distance = np.linalg.norm(known, axis=1)
    seen = known / distance[:, None]
    bearings = choose_pixels(window.face_set, newest.pyramid[0], window.config.candidates, seen)
    if len(bearings) == 0 or len(seen) < 4:
        return
    _, near = cKDTree(seen).query(bearings, k=4)
    around = 1.0 / distance[near]
    rho = np.median(around, axis=1)
    fresh = make_points(
        window.face_set,
        newest.pyramid,
        bearings,
        len(window.keyframes) - 1,
        rho,
        0.3 * around.min(axis=1),
        2.5 * around.max(axis=1),
    )
    window.candidates = window.candidates.joined(fresh)


def trace_candidates(window: Window, pyramid: list[NDArray[np.uint8]], T_cw: Array, affine: Array) -> None:
    """Narrow the candidates' inverse distances with a tracked frame; remove those that are missed repeatedly."""
    c, face_set, p = window.config, window.face_set, window.candidates
    if len(p) == 0:
        return
    rel = T_cw @ invert_pose(window.poses())
    rho, sigma, status = p.rho.copy(), np.zeros(len(p)), np.zeros(len(p), np.int64)
    trace(
        pyramid[0], face_set.valid, face_set.R_fc, face_set.intrinsics,
        np.ascontiguousarray(rel[:, :3, :3]), np.ascontiguousarray(rel[:, :3, 3]),
        p.host, p.bearing, np.ascontiguousarray(p.colour[:, 0]), affine - window.affines(), p.low, p.high,
        face_set.focal,
        PATTERN, c.gradient_softening, c.huber, SIZE * (0.6 * c.outlier) ** 2, rho, sigma, status,
    )  # fmt: skip
    found = status == 1
    p.rho = np.where(found, rho, p.rho)
    p.low = np.where(found, np.maximum(rho - 2 * sigma, 1e-4), p.low)
    p.high = np.where(found, rho + 2 * sigma, p.high)
    p.hits = p.hits + found
    p.misses = np.where(found, 0, p.misses + (status == -1))
    window.candidates = p.select(p.misses < 3)


def activate(window: Window, rng: np.random.Generator) -> int:
    """Make points of the candidates whose depth is known; returns how many.

    If there are too many points, those of the keyframe with the most points are removed, so that the points are
    spread over the keyframes and no keyframe that leaves the window takes too many with it.
    """
    p, limit = window.candidates, window.config.points
    converged = (p.hits >= 2) & (p.high - p.low < 2 * MAX_UNCERTAINTY * p.rho) & (p.host < len(window.keyframes) - 1)
    index = np.flatnonzero(converged)
    most = max(limit - len(window.points), 2 * limit // window.config.window)
    if len(index) > most:
        index = np.sort(rng.choice(index, most, replace=False))
    excess = len(window.points) + len(index) - limit
    if excess > 0:
        _remove_points(window, excess, rng)
    window.points = window.points.joined(p.select(index))
    keep = np.ones(len(p), bool)
    keep[index] = False
    window.candidates = p.select(keep)
    return len(index)


def _remove_points(window: Window, excess: int, rng: np.random.Generator) -> None:
    """Remove ``excess`` points, each from the keyframe that has the most points."""
    host = window.points.host
    counts = np.bincount(host, minlength=len(window.keyframes))
    target = counts.copy()
    while target.sum() > counts.sum() - excess:
        target[np.argmax(target)] -= 1
    keep = np.ones(len(host), bool)
    for k in np.flatnonzero(target < counts):
        keep[rng.choice(np.flatnonzero(host == k), counts[k] - target[k], replace=False)] = False
    window.points = window.points.select(keep)
