"""Panoramas stitched from two lenses: bearings as the lenses saw them.

Frames are tracked as if they had one centre. At the end every bearing is led back to the lens that saw it, and the map
is adjusted as that of a rig with these two lenses, so that its scale is that of the distance between them. What is as
far away as most of the scene is taken to be stitched without a seam, unless it is known better: with that distance
free as well, the adjustment hardly tells it from the scale.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.two_lenses import BLEND, TwoLenses
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.lenses import Lenses
from panobench.methods.sparse.pointmap import ACTIVE, FrameRecord, PointMap
from panobench.methods.sparse.scale import adjust_scale, scale_sigma

Array = NDArray[np.float64]

#: The map's scale and the distance that follows from it are found in so many rounds.
ROUNDS = 4


def in_seam(bearings: Array) -> NDArray[np.bool_]:
    """Whether bearings (N, 3) are where both lenses are seen at once."""
    return np.asarray(np.abs(bearings[:, 2]) < np.sin(BLEND))


def undo_stitching(
    m: PointMap, records: list[FrameRecord], config: SparseConfig, focal: float, extra: dict[str, Any]
) -> float:
    """Adjust the map as seen by the two lenses; returns the factor by which it grew.

    extra: told what was used, and how certain the scale is. It does not count as metric, for it depends on the distance
    for which the panorama was stitched, which is seldom known well.
    """
    given, grown = config.stitch_m, 1.0
    for key in m.keyframes:
        key.drop(in_seam(key.bearings))
        key.measured = key.bearings
    m.lenses = Lenses(
        TwoLenses(1e-3 * config.stitch_mm, 0.0).centres(), np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]), np.arange(2)
    )
    lenses = TwoLenses(0.0, 0.0)
    for _ in range(1 if given is not None else ROUNDS):
        distance = usual_distance(m) if given is None else given
        lenses = TwoLenses(1e-3 * config.stitch_mm, 1 / distance if distance else 0.0)
        for key in m.keyframes:
            assert key.measured is not None
            key.bearings = lenses.seen(key.measured)
        grown *= adjust_scale(m, config, focal)
    for key in m.keyframes:
        key.measured = None
    for record in records:
        bearings = record.bearings.astype(np.float64)
        clear = ~in_seam(bearings)
        record.points, record.bearings = record.points[clear], lenses.seen(bearings[clear]).astype(np.float32)
    sigma = scale_sigma(m, config, focal)
    extra["stitch_m"] = 1 / lenses.inverse_distance if lenses.inverse_distance else None
    extra["scale_sigma_percent"] = 100 * sigma if np.isfinite(sigma) else None
    return grown


def usual_distance(m: PointMap) -> float:
    """Median distance of the points from the keyframes that see them."""
    away = [
        np.linalg.norm(m.position[k.points[m.state[k.points] == ACTIVE]] - centre, axis=1)
        for k, centre in zip(m.keyframes, m.centres())
    ]
    return float(np.median(np.concatenate(away)))
