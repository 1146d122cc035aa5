"""Relocalisation: descriptors of a lost frame against the map, P3P in RANSAC, then ordinary tracking.

Where a gyroscope knows which way the lost camera looks, it is tracked from places that it may be at first, and a place
that looks alike another way is none.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import invert_pose, make_pose
from panobench.inertial.prediction import looks_elsewhere
from panobench.methods.sparse.absolute import pose_ransac
from panobench.methods.sparse.descriptors import describe, match
from panobench.methods.sparse.detect import detect_corners
from panobench.methods.sparse.pointmap import ACTIVE, PointMap
from panobench.methods.sparse.tracking import Aligner, Pyramid, Tracked, track_frame

Array = NDArray[np.float64]

#: At most this many map points are compared with a lost frame: those that were found most often.
MAX_POINTS = 8000
#: A lost camera that looks a known way is tracked from so many keyframes' places.
PLACES = 6


def find_again(
    aligner: Aligner, pyramid: Pyramid, frame: int, rng: np.random.Generator, heading: Array | None
) -> Tracked | None:
    """The pose of a lost frame, None if it is not found.

    heading (4, 4): T_wc that looks the way that a gyroscope says, and lies roughly where the camera is; None without.
    """
    tracked = None if heading is None else _along_heading(aligner, pyramid, frame, heading)
    if tracked is not None:
        return tracked
    tracked = relocalise(aligner, pyramid, frame, rng)
    return None if tracked is None or looks_elsewhere(invert_pose(tracked.T_cw), heading) else tracked


def _along_heading(aligner: Aligner, pyramid: Pyramid, frame: int, heading: Array) -> Tracked | None:
    """Track the frame from the place of ``heading``, then from those of the keyframes around it, the nearest first."""
    places = invert_pose(np.stack([k.T_cw for k in aligner.map.keyframes]))[:, :3, 3]
    nearest = np.argsort(np.linalg.norm(places - heading[:3, 3], axis=1), kind="stable")[:PLACES]
    for place in [heading[:3, 3], *places[nearest]]:
        guess = invert_pose(make_pose(heading[:3, :3], place))
        tracked = track_frame(aligner, pyramid, guess, frame, _needed(aligner))
        if tracked is not None and not looks_elsewhere(invert_pose(tracked.T_cw), heading):
            return tracked
    return None


def _needed(aligner: Aligner) -> int:
    """Inliers of a pose that nothing predicts: a dozen may agree by chance, the patches of hundreds do not."""
    return max(2 * aligner.config.min_inliers, 30)


def relocalise(aligner: Aligner, pyramid: Pyramid, frame: int, rng: np.random.Generator) -> Tracked | None:
    """Track the frame from a pose that is found without a prediction. None if that fails."""
    m, face_set, config = aligner.map, aligner.face_set, aligner.config
    corners = detect_corners(face_set, pyramid[0], config.features, np.empty((0, 3)))
    if len(corners) < config.min_inliers:
        return None
    ids = points_to_match(m)
    found = describe(face_set.templates(pyramid, corners))
    a, b = match(found, m.descriptor[ids], ratio=0.92)
    if len(a) < 12:
        return None
    result = pose_ransac(m.position[ids[b]], corners[a], face_set.focal, rng, 4.0, 300, 10, face_set.lenses)
    if result is None:
        return None
    return track_frame(aligner, pyramid, result[0], frame, _needed(aligner))


def points_to_match(m: PointMap) -> NDArray[np.int64]:
    """Active points; those that were found most often if there are too many."""
    ids = np.flatnonzero(m.state == ACTIVE)
    if len(ids) > MAX_POINTS:
        ids = np.sort(ids[np.argsort(-m.found[ids], kind="stable")[:MAX_POINTS]])
    return ids
