"""Pairs of frames and the camera's motion between them, from corners followed through the frames in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from panobench.geometry import so3_exp, so3_log
from panobench.methods.sparse.detect import detect_corners
from panobench.methods.sparse.faces import FaceSet
from panobench.methods.sparse.twoview import essential_ransac, triangulate

Array = NDArray[np.float64]
Faces = NDArray[np.uint8]

CORNERS = 400
#: Fewer corners than these are no evidence of a motion.
FEWEST = 40
#: A pair ends where the scene moved by the first angle and the camera turned by the second, degrees: the less it turns
#: the more parallax it takes to tell the scene from what moves with the camera.
ENOUGH_MOTION = ((3.0, 2.5), (6.0, 1.0), (12.0, 0.0))
#: A rotation alone is evidence from here, degrees.
TURNED = 1.5
MOST_FRAMES = 24
#: Corners within this of the motion found belong to the rigid scene, in face pixels.
INLIER_PX = 1.0
#: Where most corners turn as one, the others are a scene behind a carrier if they lie all around (their mean direction
#: is shorter than this) and so many of them have one motion.
ALL_AROUND, OF_OTHERS = 0.85, 0.6
RANSAC_CORNERS, RANSAC_TRIALS = 200, 80
_LK: dict[str, Any] = {"winSize": (13, 13), "maxLevel": 3, "criteria": (3, 20, 0.02), "minEigThreshold": 1e-4}


@dataclass(frozen=True)
class Pair:
    """Frames ``first`` and ``second`` and x2 ~ R x1 + t, |t| = 1, or t = 0 for a rotation alone.

    bearings (N, 3): corners of the scene in the first camera; inverse (N,): their inverse depths there, in units of
    the baseline. moved (N,): angle between a corner's directions in the two pictures, radians. behind: most corners
    turn as one, and are left out: what carries the camera, with the scene behind it.
    """

    first: int
    second: int
    R: Array
    t: Array
    bearings: Array
    inverse: Array
    moved: Array
    behind: bool = False

    def reversed(self) -> Pair:
        """Seen from the second frame."""
        seen = self.bearings @ self.R.T + self.inverse[:, None] * self.t
        length = np.maximum(np.linalg.norm(seen, axis=1), 1e-9)
        return Pair(
            self.second,
            self.first,
            self.R.T,
            -self.R.T @ self.t,
            seen / length[:, None],
            self.inverse / length,
            self.moved,
            self.behind,
        )


def find_pair(
    face_set: FaceSet, faces: Callable[[int], Faces], first: int, count: int, rng: np.random.Generator
) -> Pair | None:
    """The motion from frame ``first`` on, over as many frames as it takes; None: there is none to tell.

    ``faces(i)`` are frame i's pictures (F, H, W) by ``face_set``; ``count`` is the number of frames.
    """
    found = _find_pair(face_set, faces, first, count, rng)
    if found is not None and _has_parallax(found, 0.5 * INLIER_PX / face_set.focal):
        return found
    # What carries the camera may be most of the view. It turns as one, and has no parallax.
    return _find_pair(face_set, faces, first, count, np.random.default_rng(first), others=True) or found


def _has_parallax(pair: Pair, least: float) -> bool:
    return bool(pair.t.any()) and len(pair.inverse) > 0 and float(np.median(pair.inverse)) > least


def _find_pair(
    face_set: FaceSet,
    faces: Callable[[int], Faces],
    first: int,
    count: int,
    rng: np.random.Generator,
    *,
    others: bool = False,
) -> Pair | None:
    """As ``find_pair``; others: only by corners that do not turn as most of them do, and with parallax alone."""
    before = faces(first)
    start = detect_corners(face_set, before, CORNERS, np.empty((0, 3)))
    if len(start) < FEWEST:
        return None
    here, alive = start.copy(), np.arange(len(start))
    best: tuple[int, Array, Array, Array] | None = None
    for index in range(first + 1, min(first + MOST_FRAMES, count - 1) + 1):
        now = faces(index)
        moved, found = follow(face_set, before, now, here[alive])
        here[alive] = moved
        alive, before = alive[found], now
        if len(alive) < max(FEWEST, 0.35 * len(start)):
            break
        a, b = start[alive], here[alive]
        if others:
            mine = behind_carrier(a, b, 1.5 * INLIER_PX / face_set.focal, rng)
            if not mine.any():
                continue
            a, b = a[mine], b[mine]
        R, _ = robust_rotation(a, b, 3 * INLIER_PX / face_set.focal, rng)
        best = (index, a, b.copy(), R)
        parallax = float(np.degrees(np.median(_angles(a @ R.T, b))))
        turned = float(np.degrees(np.linalg.norm(so3_log(R))))
        if any(parallax > enough and turned >= least for enough, least in ENOUGH_MOTION):
            break
    if best is None:
        return None
    index, a, b, R = best
    pair = _motion(face_set, first, index, a, b, R, rng)
    if pair is None or not others:
        return pair
    one = len(pair.bearings) >= OF_OTHERS * len(a) and _has_parallax(pair, INLIER_PX / face_set.focal)
    return replace(pair, behind=True) if one else None


def behind_carrier(a: Array, b: Array, limit: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which corners (N,), seen at a and then at b (N, 3), do not turn with most of them; limit in radians.

    None of them if they are few, or do not lie all around.
    """
    _, near = robust_rotation(a, b, limit, rng)
    others = ~near
    enough = int(others.sum()) >= FEWEST and near.mean() > 0.5
    return others if enough and np.linalg.norm(a[others].mean(axis=0)) < ALL_AROUND else np.zeros_like(others)


def _motion(
    face_set: FaceSet, first: int, second: int, a: Array, b: Array, R: Array, rng: np.random.Generator
) -> Pair | None:
    some = rng.permutation(len(a))[:RANSAC_CORNERS]
    limit = INLIER_PX / face_set.focal
    two = essential_ransac(a[some], b[some], 1.2 * limit, rng, RANSAC_TRIALS, np.deg2rad(0.5))
    if two is not None:
        R, t, off = refined(two.R, two.t, a, b, limit)
        near = off < 3 * limit
        if int(near.sum()) >= FEWEST:
            R, t, _ = refined(R, t, a[near], b[near], limit)
            off = epipolar_distance(R, t, a, b)
        near = off < 2 * limit
        if int(near.sum()) >= max(FEWEST // 2, 0.3 * len(a)):
            a, b = a[near], b[near]
            _, s1, _ = triangulate(a, b, R, t)
            inverse = 1 / np.where(np.abs(s1) < 1e-9, 1e-9, s1)
            ahead = inverse > -0.05
            a, b, inverse = a[ahead], b[ahead], np.maximum(inverse[ahead], 0.0)
            return Pair(first, second, R, t, a, inverse, _angles(a, b))
    R, near = robust_rotation(a, b, 2 * limit, rng, 100)
    turned = float(np.degrees(np.linalg.norm(so3_log(R))))
    if near.mean() < 0.5 or turned < TURNED:
        return None
    a, b = a[near], b[near]
    return Pair(first, second, R, np.zeros(3), a, np.zeros(len(a)), _angles(a, b))


def follow(face_set: FaceSet, before: Faces, now: Faces, bearings: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Where corners (N, 3) of one frame are in the next, and which were found (there and back again)."""
    out, found = bearings.copy(), np.zeros(len(bearings), dtype=bool)
    face = np.argmax(bearings @ face_set.R_fc[:, 2].T, axis=1)
    fx, fy, cx, cy = face_set.intrinsics
    height, width = face_set.size
    for k in range(face_set.count):
        mine = np.flatnonzero(face == k)
        if len(mine) == 0:
            continue
        p = bearings[mine] @ face_set.R_fc[k].T
        pixels = np.column_stack([fx * p[:, 0] / p[:, 2] + cx - 0.5, fy * p[:, 1] / p[:, 2] + cy - 0.5])
        start = pixels.astype(np.float32)[:, None]
        end, there, _ = cv2.calcOpticalFlowPyrLK(before[k], now[k], start, start.copy(), **_LK)
        back, again, _ = cv2.calcOpticalFlowPyrLK(now[k], before[k], end, start.copy(), **_LK)
        q = end[:, 0].astype(np.float64)
        inside = (q > 3).all(axis=1) & (q[:, 0] < width - 4) & (q[:, 1] < height - 4)
        same = np.linalg.norm(back - start, axis=2)[:, 0] < 0.7
        out[mine] = face_set.rays(k, q + 0.5)
        found[mine] = inside & same & (there[:, 0] > 0) & (again[:, 0] > 0)
    return out, found


def robust_rotation(
    a: Array, b: Array, limit: float, rng: np.random.Generator, trials: int = 40
) -> tuple[Array, NDArray[np.bool_]]:
    """R (3, 3) with b = R a for most of the unit vectors (N, 3), and which (N,); ``limit`` in radians."""
    best, most = np.eye(3), -1.0
    for _ in range(trials):
        pick = rng.choice(len(a), 2, replace=False)
        R = _kabsch(a[pick], b[pick])
        score = float(np.maximum(0.0, 1 - (np.linalg.norm(a @ R.T - b, axis=1) / limit) ** 2).sum())
        if score > most:
            best, most = R, score
    for _ in range(5):
        near = np.linalg.norm(a @ best.T - b, axis=1) < limit
        if int(near.sum()) < 3:
            break
        best = _kabsch(a[near], b[near])
    return best, np.linalg.norm(a @ best.T - b, axis=1) < limit


def _kabsch(a: Array, b: Array) -> Array:
    U, _, Vt = np.linalg.svd(b.T @ a)
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt)


def refined(R: Array, t: Array, a: Array, b: Array, limit: float) -> tuple[Array, Array, Array]:
    """R and t that bring matched bearings (N, 3) onto their epipolar planes, robustly; and how far (N,) each is off."""
    across = np.linalg.svd(t[None])[2][1:]

    def at(x: Array) -> tuple[Array, Array]:
        direction = t + x[3:] @ across
        return so3_exp(x[:3]) @ R, direction / np.linalg.norm(direction)

    def off(x: Array) -> Array:
        return epipolar_distance(*at(x), a, b)

    answer = least_squares(off, np.zeros(5), loss="soft_l1", f_scale=0.5 * limit, max_nfev=30).x
    return *at(answer), off(answer)


def epipolar_distance(R: Array, t: Array, a: Array, b: Array) -> Array:
    """Angle (N,) between b and the plane of t and R a, radians; less near the epipoles, where any plane is near."""
    normal = np.cross(t, a @ R.T)
    return np.asarray(np.abs(np.sum(normal * b, axis=1)) / np.maximum(np.linalg.norm(normal, axis=1), 0.05))


def _angles(a: Array, b: Array) -> Array:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))
