"""Closing loops: noticing a return to a part of the map that sleeps, measuring the drift since, and spreading it.

The newest keyframe is aligned to the sleeping part alone, from where the camera is thought to be or from a keyframe
that looks alike. If that part explains it, the others of the window are aligned too, and the two sets of poses differ
by the drift, a similarity. A Sim(3) pose graph spreads it over the keyframes, and each Gaussian moves with the keyframe
that brought it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, invert_pose, matrix_from_quaternion, quaternion_from_matrix
from panobench.methods.panogs.agreement import agreement
from panobench.methods.panogs.dormant import Dormant, Numbers, anchors_of
from panobench.methods.panogs.mapper import Mapper
from panobench.methods.panogs.places import Places, Thumbnail, turned
from panobench.methods.panogs.tracker import OPACITY_MIN, Tracked, Tracker
from panobench.methods.panogs.views import View
from panobench.methods.posegraph import Similarities, optimise_pose_graph
from panobench.photometric.pyramid import F32
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Render

Pose = NDArray[np.float64]
#: Aligns a frame (pyramid) to a map from a pose; the render of the result is of the final pose.
Descend = Callable[[list[F32], GaussianMap, Pose], Tracked]

#: Keyframes between two looks, and after which a place is old.
BETWEEN_LOOKS, OLD = 2, 20
#: Likeness of a place that is worth a start, and how many are tried.
LIKENESS_MIN, PLACES = 0.3, 2
#: Of the blocks the sleeping map knows, those that must agree; share of the view it must know.
AGREE_MIN, KNOWN_MIN = 0.7, 0.15
#: Keyframes that must be explained, of how many; their positions' spread and misfit, over the scene's depth.
EXPLAINED_MIN, EXPLAINED_OF, SPREAD_MIN, MISFIT_MAX = 4, 8, 0.05, 0.01
#: Largest change of scale. Poses aligned to a map seen from elsewhere fall short by up to this (docs/panogs-lab.md).
STRETCH_MAX, SHORT = 1.5, 0.01
#: A drift below this is noise: translation over depth, angle, and log scale beyond ``SHORT``, together.
DRIFT_MIN = 0.004
#: A keyframe is tied to at most so many others whose Gaussians draw at least this share of it.
TIES, TIE_SHARE = 3, 0.1
#: Of what is drawn by the sleeping map, the share from which a keyframe's group wakes.
WAKE_SHARE = 0.005


class Anchored(Protocol):
    """A frame's pose (4, 4) relative to its keyframe."""

    anchor: View
    relative: Pose


@dataclass(frozen=True)
class Loop:
    """Keyframes ``old`` and ``new`` (numbers), and the drift: it takes the world at ``new`` onto the old one.

    size: of the drift, see ``DRIFT_MIN``. groups (K,): keyframes whose Gaussians were recognised.
    """

    old: int
    new: int
    drift: Sim3
    size: float
    groups: NDArray[np.bool_]


@dataclass
class LoopCloser:
    """``places`` has one thumbnail for each keyframe, in their order."""

    tracker: Tracker
    places: Places
    descend: Descend
    ties: list[tuple[int, int, float]] = field(default_factory=list)
    _looked: int = 0

    def tie(self, touched: NDArray[np.int32], anchors: Numbers, number: int) -> None:
        """Remember which keyframes' Gaussians draw keyframe ``number``; touched, anchors (N,): of the Gaussians."""
        if number > 0:
            self.ties.append((number - 1, number, 1.0))
        drawn = np.bincount(anchors[: len(touched)], weights=touched, minlength=number)[: max(number - 1, 0)]
        shares = np.asarray(drawn / max(float(touched.sum()), 1.0), np.float64)
        for k in np.argsort(-shares, kind="stable")[:TIES]:
            if shares[k] >= TIE_SHARE:
                self.ties.append((int(k), number, float(shares[k])))

    def look(self, thumbnail: Thumbnail, sleeping: GaussianMap, anchors: Numbers, mapper: Mapper) -> Loop | None:
        """The loop that closes at the newest keyframe, if one does. anchors (N,): of the sleeping Gaussians."""
        number = len(mapper.keyframes) - 1
        if not len(sleeping) or number - self._looked < BETWEEN_LOOKS:
            return None
        self._looked = number
        newest = mapper.window[0]
        among = np.arange(self.places.count) <= number - OLD
        alike = [m for m in self.places.find(thumbnail, PLACES, among) if m.score >= LIKENESS_MIN]
        starts = [newest.T_wc] if self._knows(self.tracker.renderer.forward(sleeping, newest.T_wc)) else []
        for start in [*starts, *(turned(mapper.keyframes[m.number].T_wc, m.yaw) for m in alike)]:
            frame = self.tracker.frame_pyramid(newest.image)
            found = self.descend(frame, sleeping, start)
            if self._explains(frame, found):
                return self._measure(found, sleeping, anchors, mapper)
        return None

    def _measure(self, newest: Tracked, sleeping: GaussianMap, anchors: Numbers, mapper: Mapper) -> Loop | None:
        """Align the rest of the window too; the drift is the similarity between the two sets of poses."""
        now, old = [mapper.window[0].T_wc], [newest.T_wc]
        across = newest.T_wc @ invert_pose(now[0])
        for view in mapper.window[1:EXPLAINED_OF]:
            frame = self.tracker.frame_pyramid(view.image)
            found = self.descend(frame, sleeping, across @ view.T_wc)
            if self._explains(frame, found):
                now.append(view.T_wc)
                old.append(found.T_wc)
        depth = float(np.nanmedian(newest.render.expected_depth(OPACITY_MIN)))
        fit = _similarity(np.stack(now), np.stack(old)) if len(now) >= EXPLAINED_MIN else None
        if fit is None or fit[1] < SPREAD_MIN * depth or fit[2] > MISFIT_MAX * depth:
            return None
        drift = fit[0]
        if not 1 / STRETCH_MAX < drift.scale < STRETCH_MAX:
            return None
        touched = newest.render.touched
        assert touched is not None
        drawn = np.bincount(anchors, weights=touched, minlength=len(mapper.keyframes))
        size = float(np.linalg.norm(old[0][:3, 3] - now[0][:3, 3])) / depth
        size += float(np.linalg.norm(drift.R - np.eye(3))) / np.sqrt(2) + max(abs(np.log(drift.scale)) - SHORT, 0.0)
        groups = drawn >= WAKE_SHARE * drawn.sum()
        return Loop(int(np.argmax(drawn)), len(mapper.keyframes) - 1, drift, size, groups)

    def _knows(self, render: Render) -> bool:
        weights = self.tracker.weights
        return float(weights[render.opacity > OPACITY_MIN].sum()) >= KNOWN_MIN * float(weights.sum())

    def _explains(self, frame: list[F32], found: Tracked) -> bool:
        explained = found.good and self._knows(found.render)
        return explained and agreement(frame, found.render, self.tracker.weights) >= AGREE_MIN

    def spread(self, loop: Loop, keyframes: list[View]) -> list[Sim3]:
        """What each keyframe and its Gaussians must move by (old world to new world) to close the loop."""
        T = np.stack([k.T_wc for k in keyframes])
        before = Similarities(np.ones(len(T)), T[:, :3, :3].copy(), T[:, :3, 3].copy())
        ties = self.ties
        i, j = np.array([t[0] for t in ties]), np.array([t[1] for t in ties])
        weights = np.array([t[2] for t in ties])
        measured = before.between(i, j)
        moved = loop.drift.apply_poses(T[loop.new])
        ends = Similarities(
            np.array([1.0, loop.drift.scale]),
            np.stack([before.R[loop.old], moved[:3, :3]]),
            np.stack([before.t[loop.old], moved[:3, 3]]),
        )
        across = ends.between(np.array([0]), np.array([1]))
        after = optimise_pose_graph(
            before, np.append(i, loop.old), np.append(j, loop.new),
            Similarities(
                np.append(measured.scale, across.scale),
                np.concatenate([measured.R, across.R]),
                np.concatenate([measured.t, across.t]),
            ),
            np.append(weights, weights.sum()),  # it was verified; the drift is in the others
        )  # fmt: skip
        self.ties.append((loop.old, loop.new, 1.0))
        moves = []
        for k in range(len(T)):
            R = after.R[k] @ before.R[k].T
            moves.append(Sim3(float(after.scale[k]), R, after.t[k] - after.scale[k] * R @ before.t[k]))
        return moves


def _similarity(now: Pose, old: Pose) -> tuple[Sim3, float, float]:
    """The similarity taking poses ``now`` (N, 4, 4) to ``old``, the positions' spread and their misfit (rms).

    The rotation is the mean of the cameras' own: positions on a line leave one undetermined.
    """
    U, _, Vt = np.linalg.svd((old[:, :3, :3] @ np.swapaxes(now[:, :3, :3], 1, 2)).sum(axis=0))
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    p, q = now[:, :3, 3] @ R.T, old[:, :3, 3]
    pc, qc = p - p.mean(axis=0), q - q.mean(axis=0)
    spread = float(np.sqrt((pc**2).sum(axis=1).mean()))
    scale = float((pc * qc).sum() / max(float((pc**2).sum()), 1e-18))
    misfit = float(np.sqrt(((scale * pc - qc) ** 2).sum(axis=1).mean()))
    return Sim3(scale, R, q.mean(axis=0) - scale * p.mean(axis=0)), spread, misfit


def move_gaussians(gaussians: GaussianMap, anchors: Numbers, moves: list[Sim3]) -> None:
    """Move each Gaussian, in place, by the similarity of its anchor (N,)."""
    scale = np.array([m.scale for m in moves])[anchors]
    R = np.stack([m.R for m in moves])[anchors]
    t = np.stack([m.t for m in moves])[anchors]
    gaussians.means[:] = scale[:, None] * np.einsum("nij,nj->ni", R, gaussians.means) + t
    gaussians.log_scales += np.log(scale)[:, None].astype(np.float32)
    turned_axes = R @ matrix_from_quaternion(gaussians.quats)
    gaussians.quats[:] = quaternion_from_matrix(turned_axes)


def carry_out(moves: list[Sim3], mapper: Mapper, dormant: Dormant, records: Mapping[int, Anchored]) -> None:
    """Move Gaussians, keyframes, and the frames tied to them (``records``, by frame number)."""
    move_gaussians(mapper.map, anchors_of(mapper.born), moves)
    move_gaussians(dormant.map, anchors_of(dormant.born), moves)
    number = {id(view): k for k, view in enumerate(mapper.keyframes)}
    for record in records.values():
        record.relative[:3, 3] *= moves[number[id(record.anchor)]].scale
    for view in mapper.frames:
        if id(view) not in number:
            view.T_wc = moves[number[id(records[view.index].anchor)]].apply_poses(view.T_wc)
    for view, move in zip(mapper.keyframes, moves):
        view.T_wc = move.apply_poses(view.T_wc)
