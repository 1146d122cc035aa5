"""The last refinement of a session: every frame's pose from its own measurements, and the rows of a rolling shutter.

Metres are told by small motions, such as strides. Measurements that are far off are mostly of patches that did not
follow them, and make them too small, however little each of them counts. Where metres matter, what is left of them is
therefore left out at the end.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.rig import Rig
from panobench.geometry import invert_pose
from panobench.methods.sparse.bundle import bundle_adjust
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.mapping import adjust_window, observations
from panobench.methods.sparse.pointmap import ACTIVE, DEAD, FrameRecord, PointMap
from panobench.methods.sparse.pose import deviation, errors_in_views, pose_errors, solve_pose
from panobench.methods.sparse.rolling_shutter import Readout, RowBearings, estimate_readout
from panobench.methods.sparse.session import Session

Array = NDArray[np.float64]

#: Rounds of turning bearings by the trajectory's angular velocities and adjusting it.
SHUTTER_ROUNDS = 2
#: A frame's own measurement so many deviations from its point has no say in its pose, but each below the first and none
#: above the second number of pixels.
NEAR_SIGMAS, NEAR_PX = 3.0, (0.6, 4.0)
#: The same where metres matter, and rounds of choosing and adjusting.
EXACT_SIGMAS, EXACT_ROUNDS = 2.0, 2


def refined_poses(session: Session, config: SparseConfig, focal: float, *, exact: bool = False) -> dict[int, Array]:
    """T_wc (4, 4) by frame index, in that order. focal: pixels per radian. exact: see the module's docstring."""
    sigmas, rounds = (EXACT_SIGMAS, EXACT_ROUNDS) if exact else (NEAR_SIGMAS, 1)
    poses = {}
    for record in sorted(session.records, key=lambda r: r.index):
        T = session.pose_of(record)
        for _ in range(rounds if config.refit else 0):
            T = _refit(session.map, record, T, config, focal, sigmas)
        poses[record.index] = invert_pose(T)
    return poses


def adjust_exactly(m: PointMap, config: SparseConfig, focal: float) -> None:
    """Adjust all keyframes and points by the measurements that agree best; points without two of them are dropped."""
    for _ in range(EXACT_ROUNDS):
        seen = observations(m.keyframes, m.state == ACTIVE)
        if seen is None or len(m.keyframes) < 3:
            return
        kf, pt, b, _at = seen
        origins = m.lenses.origins(b)
        errors = errors_in_views(m.poses(), m.position, kf, pt, b, focal, origins)
        near = errors < EXACT_SIGMAS * deviation(errors)
        enough = np.bincount(pt[near], minlength=m.size) >= 2
        m.state[(m.state == ACTIVE) & ~enough] = DEAD
        near &= enough[pt]
        ids, local = np.unique(pt[near], return_inverse=True)
        fixed = np.zeros(len(m.keyframes), bool)
        fixed[: 2 if m.lenses.several else 1] = True  # the gauge
        kept = None if origins is None else origins[near]
        found = bundle_adjust(
            m.poses(), m.position[ids], kf[near], local, b[near], fixed, focal, config.huber_px, config.final_ba, kept
        )
        m.position[ids] = found.points
        for key, T, held in zip(m.keyframes, found.T_cw, fixed, strict=True):
            if not held:
                key.T_cw = T


def correct_shutter(
    session: Session,
    camera: Camera,
    config: SparseConfig,
    focal: float,
    log: Callable[[str], None],
    rig: Rig | None = None,
) -> float:
    """Readout in seconds; if it is not 0, bearings are turned to their frames' middle rows and adjusted again.

    rig: whose lenses' rows they are, where there are several; a readout that these say counts unless one is given.
    """
    given = config.readout_ms
    if rig is not None and given == 0 and rig.readout_s is not None:
        given = 1e3 * rig.readout_s
    if given == 0 or len(session.records) < 3:
        return 0.0

    def poses() -> Array:
        return np.stack(list(refined_poses(session, config, focal).values()))

    m = session.map
    rows = RowBearings(camera, m, session.records, rig)
    rows.follow(poses())
    readout = estimate_readout(rows, m, focal) if given is None else Readout(1e-3 * given)
    if given is None and readout.best_s:
        log(
            f"readout {1e3 * readout.best_s:.1f} ms explains {readout.gain:.1%} more: "
            + (f"a rolling shutter of {1e3 * readout.seconds:.1f} ms" if readout.seconds else "a global shutter")
        )
    for _ in range(SHUTTER_ROUNDS if readout.seconds else 0):
        rows.turn(readout.seconds)
        adjust_window(m, config, focal, [k.number for k in m.keyframes], max(config.final_ba, 1))
        rows.follow(poses())
    return readout.seconds


def _refit(m: PointMap, record: FrameRecord, T: Array, config: SparseConfig, focal: float, sigmas: float) -> Array:
    """T_cw (4, 4) from the frame's own measurements and the refined points."""
    alive = m.state[record.points] == ACTIVE
    X, b = m.position[record.points[alive]], record.bearings[alive].astype(np.float64)
    origins = m.lenses.origins(b)
    errors = pose_errors(T, X, b, focal, origins)
    near = errors < np.clip(sigmas * deviation(errors), *NEAR_PX)
    if int(near.sum()) < config.min_inliers:
        return T
    kept = None if origins is None else origins[near]
    return solve_pose(T, X[near], b[near], focal, config.huber_px, 10, kept)
