"""The scale of a rig's map: it is that of the distances between the lenses, and it can be more or less certain.

A map begins at a guess, the median distance of two metres. The lenses' distances show in bundle adjustment as soon as
the rig has turned, or points have passed from one lens to another; then all keyframes are adjusted together, in which
the scale is one of the unknowns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from panobench.methods.lens_scale import BIAS_PX
from panobench.methods.sparse.bundle import pose_information
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.mapping import adjust_window, observations
from panobench.methods.sparse.pointmap import ACTIVE, PointMap
from panobench.methods.sparse.pose import deviation, pose_errors

Array = NDArray[np.float64]

#: All keyframes are adjusted when there are so many, and whenever they have become half as many again.
FIRST, GROWTH = 6, 1.5
#: Where the standard deviation is a larger share of the scale than this, it stays what it is.
FREE_SIGMA = 0.3
#: Huber threshold meanwhile, pixels: a change of scale moves all bearings, and a narrow threshold follows it slowly.
HUBER_PX = 1.0


def is_due(keyframes: int) -> bool:
    """Whether the scale is looked into when there are so many keyframes."""
    due = float(FIRST)
    while due < keyframes:
        due = np.ceil(GROWTH * due)
    return due == keyframes


def adjust_scale(m: PointMap, config: SparseConfig, focal: float, iterations: int = 15) -> float:
    """Adjust all keyframes, and the scale if it can be told. Returns the factor by which the map grew."""
    before = spread(m)
    free = scale_sigma(m, config, focal) < FREE_SIGMA
    wide = replace(config, huber_px=max(config.huber_px, HUBER_PX))
    adjust_window(m, wide, focal, [k.number for k in m.keyframes], iterations, free, settled=False)
    after = spread(m)
    return after / before if before > 0 else 1.0


def spread(m: PointMap) -> float:
    """Root of the summed squared distances of the keyframes from the first one."""
    centres = m.centres()
    return float(np.linalg.norm(centres - centres[0]))


def scale_sigma(m: PointMap, config: SparseConfig, focal: float) -> float:
    """Standard deviation of the map's scale as a share of it; infinite where nothing tells it.

    More than independent errors make it: all measurements of a point share the error of its template, so there are as
    many independent ones as points, and a bias of BIAS_PX is added, as a share of the lenses' parallax.
    """
    white = independent_sigma(m, config, focal)
    active = m.state == ACTIVE
    if not np.isfinite(white) or not active.any():
        return float("inf")
    each = max(1.0, float(m.observation_counts()[active].mean()))
    distance = float(np.median(np.linalg.norm(m.position[active] - m.centres().mean(axis=0), axis=1)))
    centres = m.lenses.centres
    parallax = focal * float(np.linalg.norm(centres - centres[0], axis=1).max()) / distance
    return float(np.hypot(white * np.sqrt(each), BIAS_PX / parallax)) if parallax > 0 else float("inf")


def independent_sigma(m: PointMap, config: SparseConfig, focal: float) -> float:
    """The same if the errors of all measurements were independent.

    From the information of all poses with the first one fixed, points eliminated; the scale is taken to be the
    logarithm of ``spread``. Residuals up to three deviations inform fully: Huber's estimate is nearly as good as least
    squares' is without outliers.
    """
    seen = observations(m.keyframes, m.state == ACTIVE)
    if seen is None or len(m.keyframes) < 3 or not m.lenses.several:
        return float("inf")
    kf, pt, b, _ = seen
    ids, local = np.unique(pt, return_inverse=True)
    T, origins = m.poses(), m.lenses.origins(b)
    assert origins is not None
    fixed = np.arange(len(T)) == 0
    errors = np.concatenate(
        [pose_errors(T[k], m.position[pt[kf == k]], b[kf == k], focal, origins[kf == k]) for k in range(len(T))]
    )
    sigma = deviation(errors)
    whole = max(config.huber_px, 3 * sigma)
    S = pose_information(T, m.position[ids], kf, local, b, fixed, focal, whole, origins)
    away = m.centres() - m.centres()[0]
    u = np.zeros((len(T), 6))
    u[:, :3] = -np.einsum("kij,kj->ki", T[:, :3, :3], away) / max(float((away**2).sum()), 1e-18)
    direction = u[1:].ravel()
    try:
        variance = float(direction @ np.linalg.solve(S, direction))
    except np.linalg.LinAlgError:
        return float("inf")
    return sigma * float(np.sqrt(variance)) if variance > 0 else float("inf")
