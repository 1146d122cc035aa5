"""Finding the camera again: descriptors of a lost frame against the map, P3P in RANSAC, then ordinary tracking."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.methods.sparse.absolute import pose_ransac
from panobench.methods.sparse.descriptors import describe, match
from panobench.methods.sparse.detect import detect_corners
from panobench.methods.sparse.patches import cut_templates
from panobench.methods.sparse.pointmap import ACTIVE, PointMap
from panobench.methods.sparse.tracking import Aligner, Pyramid, Tracked, track_frame

Array = NDArray[np.float64]

#: Map points compared with a lost frame at most; beyond, the most reliably found ones.
MOST_POINTS = 8000


def relocalise(aligner: Aligner, pyramid: Pyramid, frame: int, rng: np.random.Generator) -> Tracked | None:
    """Track the frame from a pose found without any prediction, or None."""
    m, rig, config = aligner.map, aligner.rig, aligner.config
    corners = detect_corners(rig, pyramid[0], config.features, np.empty((0, 3)))
    if len(corners) < config.min_inliers:
        return None
    ids = recognisable(m)
    found = describe(cut_templates(pyramid, rig.R_fc, rig.intrinsics, corners, rig.focal))
    a, b = match(found, m.descriptor[ids], ratio=0.92)
    if len(a) < 12:
        return None
    result = pose_ransac(m.position[ids[b]], corners[a], rig.focal, rng, 4.0, 300, 10)
    if result is None:
        return None
    # A chance agreement of a dozen matches does not survive the alignment of hundreds of patches.
    return track_frame(aligner, pyramid, result[0], frame, max(2 * config.min_inliers, 30))


def recognisable(m: PointMap) -> NDArray[np.int64]:
    """Active points, the more reliable ones when there are too many."""
    ids = np.flatnonzero(m.state == ACTIVE)
    if len(ids) > MOST_POINTS:
        ids = np.sort(ids[np.argsort(-m.found[ids], kind="stable")[:MOST_POINTS]])
    return ids
