"""Loop closure: place recognition, Sim(3) of the drift, pose graph optimisation, and merging of points.

Candidates are found by descriptor matches between the new keyframe's points and points that only old keyframes saw,
with votes per keyframe. A Sim(3) from 3-D matches (RANSAC over Umeyama's solution) is verified by patch alignment
against the old points. The pose graph has the covisibility edges and the loop edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, invert_pose, make_pose, umeyama
from panobench.methods.sparse.descriptors import match
from panobench.methods.sparse.pointmap import ACTIVE, DEAD, FrameRecord, Keyframe, PointMap
from panobench.methods.sparse.posegraph import Similarities, optimise_pose_graph
from panobench.methods.sparse.tracking import Aligner, Pyramid, Tracked, track_frame

Array = NDArray[np.float64]

#: Neither the RECENT newest keyframes nor those that share this many points with the new one can close a loop.
RECENT, SHARED = 10, 15
VOTES, INLIERS, GROUP, VERIFIED = 10, 7, 10, 30


@dataclass
class Loop:
    """A loop from keyframe ``newest`` to ``old``; ``correction`` moves the newest keyframe onto the old map."""

    newest: int
    old: int
    correction: Sim3
    seen: Tracked


def shared_counts(m: PointMap, keyframe: Keyframe) -> NDArray[np.int64]:
    """For each keyframe (K,), how many active points it shares with ``keyframe``."""
    mine = np.zeros(m.size, bool)
    mine[keyframe.points] = True
    mine &= m.state == ACTIVE
    return np.array([int(mine[k.points].sum()) for k in m.keyframes])


def detect_loop(
    aligner: Aligner, pyramid: Pyramid, keyframe: Keyframe, rng: np.random.Generator, *, keep_scale: bool = False
) -> Loop | None:
    """The loop that closes at this keyframe, or None. keep_scale: the correction is rigid."""
    m, focal = aligner.map, aligner.face_set.focal
    shared = shared_counts(m, keyframe)
    numbers = np.arange(len(shared))
    known = (shared >= SHARED) | (numbers > keyframe.number - RECENT)
    if known.all():
        return None
    # Points that neighbours of the new keyframe see say nothing about a loop.
    seen_by_neighbours = np.zeros(m.size, bool)
    votes_from = np.zeros(m.size, bool)
    for k, near in zip(m.keyframes, known):
        (seen_by_neighbours if near else votes_from)[k.points] = True
    old = np.flatnonzero(votes_from & ~seen_by_neighbours & (m.state == ACTIVE))
    mine = keyframe.points[m.state[keyframe.points] == ACTIVE]
    # No ratio test: a corner that was detected twice is in the map twice, and neither copy would pass.
    _, b = match(m.descriptor[mine], m.descriptor[old], ratio=1.01)
    matched = np.zeros(m.size, bool)
    matched[old[b]] = True
    votes = np.array([0 if near else int(matched[k.points].sum()) for k, near in zip(m.keyframes, known)])
    best = int(np.argmax(votes))
    if votes[best] < VOTES:
        return None
    around = (shared_counts(m, m.keyframes[best]) >= SHARED) & ~known
    group = np.zeros(m.size, bool)
    for k in np.flatnonzero(around)[:GROUP]:
        group[m.keyframes[k].points] = True
    place = old[group[old]]
    a, b = match(m.descriptor[mine], m.descriptor[place], ratio=0.9)
    new_ids, old_ids = mine[a], place[b]
    if len(a) < INLIERS:
        return None
    centres = m.centres()
    S = _sim3_ransac(
        m.position[new_ids], m.position[old_ids], centres[keyframe.number], centres[best], 4.0 / focal, rng
    )
    if S is None:
        return None
    T_wc = S.apply_poses(invert_pose(keyframe.T_cw))
    seen = track_frame(aligner, pyramid, invert_pose(T_wc), keyframe.frame, VERIFIED, only=old)
    if seen is None:
        return None
    # Rotation and translation are taken from the alignment, which is more accurate; the scale from the matches, but for
    # rigs and where there is an IMU: their scale does not drift, or is mended elsewhere.
    scale = 1.0 if keep_scale else S.scale
    T_now = invert_pose(seen.T_cw)
    R = T_now[:3, :3] @ keyframe.T_cw[:3, :3]
    t = T_now[:3, 3] - scale * R @ centres[keyframe.number]
    return Loop(keyframe.number, best, Sim3(scale, R, t), seen)


def _sim3_ransac(
    new: Array, old: Array, new_eye: Array, old_eye: Array, threshold: float, rng: np.random.Generator
) -> Sim3 | None:
    """Similarity that takes new points (N, 3) to old ones; inliers by their angles seen from both cameras."""

    def agree(S: Sim3) -> NDArray[np.bool_]:
        there = S.apply_points(new)
        back = S.inverse().apply_points(old)
        return np.asarray(_angle(there - old_eye, old - old_eye) < threshold) & (
            _angle(back - new_eye, new - new_eye) < threshold
        )

    samples = np.array([rng.choice(len(new), 3, replace=False) for _ in range(300)])
    scale, R, t = _umeyama_triples(new[samples], old[samples])
    there = scale[:, None, None] * np.einsum("hij,nj->hni", R, new) + t[:, None]
    back = np.einsum("hji,hnj->hni", R, old[None] - t[:, None]) / scale[:, None, None]
    fits = (_angle(there - old_eye, old - old_eye) < threshold) & (_angle(back - new_eye, new - new_eye) < threshold)
    fits[(scale < 0.2) | (scale > 5.0)] = False
    winner = int(np.argmax(fits.sum(axis=1)))
    best, most = fits[winner], int(fits[winner].sum())
    if most < INLIERS:
        return None
    for _ in range(3):
        S = umeyama(new[best], old[best])
        best = agree(S)
        if int(best.sum()) < INLIERS:
            return None
    return S


def _umeyama_triples(p: Array, q: Array) -> tuple[Array, Array, Array]:
    """Similarities that take triples p (H, 3, 3) to q: scale (H,), R (H, 3, 3), t (H, 3); see ``geometry.umeyama``."""
    mp, mq = p.mean(axis=1), q.mean(axis=1)
    pc, qc = p - mp[:, None], q - mq[:, None]
    U, S, Vt = np.linalg.svd(np.swapaxes(qc, 1, 2) @ pc)
    sign = np.sign(np.linalg.det(U) * np.linalg.det(Vt))
    U[:, :, 2] *= sign[:, None]
    S[:, 2] *= sign
    R = U @ Vt
    scale = S.sum(axis=1) / np.maximum((pc**2).sum(axis=(1, 2)), 1e-18)
    return scale, R, mq - scale[:, None] * np.einsum("hij,hj->hi", R, mp)


def _angle(a: Array, b: Array) -> Array:
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def close_loop(m: PointMap, loop: Loop, records: list[FrameRecord], focal: float) -> Array:
    """Correct keyframes, points and the frames' relative poses, and merge duplicate points. Returns scales (K,)."""
    T_wk = invert_pose(m.poses())
    count = len(T_wk)
    before = Similarities(np.ones(count), T_wk[:, :3, :3].copy(), T_wk[:, :3, 3].copy())
    i, j, weights = _covisibility_edges(m)
    measured = before.between(i, j)
    moved = loop.correction.apply_poses(T_wk[loop.newest])
    ends = Similarities(
        np.array([1.0, loop.correction.scale]),
        np.stack([before.R[loop.old], moved[:3, :3]]),
        np.stack([before.t[loop.old], moved[:3, 3]]),
    )
    across = ends.between(np.array([0]), np.array([1]))
    after = optimise_pose_graph(
        before,
        np.append(i, loop.old),
        np.append(j, loop.newest),
        Similarities(
            np.append(measured.scale, across.scale),
            np.concatenate([measured.R, across.R]),
            np.concatenate([measured.t, across.t]),
        ),
        np.append(weights, weights.sum()),  # the loop edge was verified; the covisibility edges have the drift
    )
    anchor = m.anchor
    local = np.einsum("nji,nj->ni", before.R[anchor], m.position - before.t[anchor])
    m.position[:] = after.scale[anchor][:, None] * np.einsum("nij,nj->ni", after.R[anchor], local) + after.t[anchor]
    for k in m.keyframes:
        k.T_cw = invert_pose(make_pose(after.R[k.number], after.t[k.number]))
    for record in records:
        record.T_ck[:3, 3] *= after.scale[record.keyframe]
    _merge_points(m, loop, focal)
    return after.scale


def _covisibility_edges(m: PointMap) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Edges from each keyframe to the one before it, and to earlier ones that share many points with it."""
    pairs, weights = [], []
    for k in m.keyframes[1:]:
        shared = shared_counts(m, k)[: k.number]
        close = np.flatnonzero(shared >= 50)[-8:]
        for other in sorted({k.number - 1, *close.tolist()}):
            pairs.append((other, k.number))
            weights.append(max(1.0, shared[other] / 50))
    table = np.array(pairs, np.int64).reshape(-1, 2)
    return table[:, 0], table[:, 1], np.array(weights, np.float64)


def _merge_points(m: PointMap, loop: Loop, focal: float) -> None:
    """Add observations of old points to the newest keyframe; they replace new points at the same place."""
    key = m.keyframes[loop.newest]
    mine = np.flatnonzero(m.state[key.points] == ACTIVE)
    seen = loop.seen
    if len(mine) == 0:
        return
    cosine = seen.bearings @ key.bearings[mine].T
    nearest = np.argmax(cosine, axis=1)
    same = np.sum((seen.bearings - key.bearings[mine[nearest]]) ** 2, axis=1) < (1.5 / focal) ** 2
    # After the correction both must also lie at about the same distance.
    centre = invert_pose(key.T_cw)[:3, 3]
    d_old = np.linalg.norm(m.position[seen.points] - centre, axis=1)
    d_new = np.linalg.norm(m.position[key.points[mine[nearest]]] - centre, axis=1)
    same &= np.abs(np.log(d_old / d_new)) < 0.2
    become = {int(key.points[mine[nearest[n]]]): int(seen.points[n]) for n in np.flatnonzero(same)}
    have = set(key.points.tolist())
    extra = [n for n in np.flatnonzero(~same) if int(seen.points[n]) not in have]
    key.points = np.concatenate([key.points, seen.points[extra]])
    key.bearings = np.concatenate([key.bearings, seen.bearings[extra]])
    lookup = np.arange(m.size)
    for new, old in become.items():
        if new != old:
            lookup[new] = old
            m.state[new] = DEAD
    for k in m.keyframes:
        renamed = lookup[k.points]
        _, first = np.unique(renamed, return_index=True)
        first.sort()
        k.points, k.bearings = renamed[first], k.bearings[first]
