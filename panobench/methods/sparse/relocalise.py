"""Relocalisation: descriptors of a lost frame against the map, P3P in RANSAC, then ordinary tracking."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.methods.sparse.absolute import pose_ransac
from panobench.methods.sparse.descriptors import describe, match
from panobench.methods.sparse.detect import detect_corners
from panobench.methods.sparse.pointmap import ACTIVE, PointMap
from panobench.methods.sparse.tracking import Aligner, Pyramid, Tracked, track_frame

Array = NDArray[np.float64]

#: At most this many map points are compared with a lost frame: those that were found most often.
MAX_POINTS = 8000


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
    # A dozen matches may agree by chance, the alignment of hundreds of patches does not.
    return track_frame(aligner, pyramid, result[0], frame, max(2 * config.min_inliers, 30))


def points_to_match(m: PointMap) -> NDArray[np.int64]:
    """Active points; those that were found most often if there are too many."""
    ids = np.flatnonzero(m.state == ACTIVE)
    if len(ids) > MAX_POINTS:
        ids = np.sort(ids[np.argsort(-m.found[ids], kind="stable")[:MAX_POINTS]])
    return ids
