"""``direct``: direct sparse odometry on the sphere (360VO's family).

The camera becomes a set of perspective faces, as in ``sparse`` (``faces``). The first depth comes from the depth
estimator. Every frame is aligned directly to the points of a sliding window (``tracking``). Keyframes add candidate
pixels, which are traced along their epipolar curves until their depth is known (``points``). Photometric bundle
adjustment refines the newest keyframes and all points; the oldest keyframes are fixed (``window``). There are no
loops and no relocalisation: this is odometry.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.depth.base import DepthEstimator
from panobench.geometry import invert_pose, make_pose, renormalise
from panobench.methods.base import MethodContext, OnlineMethod
from panobench.methods.direct.config import DirectConfig
from panobench.methods.direct.points import activate, add_candidates, choose_pixels, make_points, trace_candidates
from panobench.methods.direct.tracking import Alignment, align
from panobench.methods.direct.window import DirectKeyframe, PointCloud, Window
from panobench.methods.sparse.faces import build_faces, levels_for
from panobench.methods.sparse.rotation import RotationFinder
from panobench.methods.stereo_camera import StereoCamera
from panobench.types import DepthEstimate, Estimate, Frame, Trajectory

Array = NDArray[np.float64]
Pyramid = list[NDArray[np.uint8]]

MAX_LEVELS = 5


@dataclass
class _Tracked:
    """A tracked frame; T_ck (4, 4) is its pose relative to a keyframe."""

    index: int
    time: float
    keyframe: int
    T_ck: Array


class DirectMethod(OnlineMethod):
    """See the module's docstring. Poses are in the first frame's axes, in the depth estimator's unit."""

    config: DirectConfig

    def __init__(self, config: DirectConfig | None = None) -> None:
        super().__init__(config or DirectConfig())

    def start(self, camera: Camera, context: MethodContext) -> None:
        self.context, self.camera = context, camera
        self.face_set = build_faces(camera, self.config.face_pixels, MAX_LEVELS)
        self.levels = levels_for(self.face_set.focal)
        self.rng = np.random.default_rng(context.seed)
        self.finder = RotationFinder(self.face_set, self.levels)
        self.stereo = StereoCamera(camera)
        self.depth: DepthEstimator = _estimator(context)
        self.depth.start(self.stereo.camera, context.seed)
        self.first: DepthEstimate | None = None
        self.waiting: list[tuple[Frame, Pyramid]] = []
        self.window: Window | None = None
        self.poses: list[Array] = []  # T_cw of all keyframes, also of those that have left the window
        self.keyframes: list[int] = []
        self.records: list[_Tracked] = []
        self.numbers: dict[int, dict[str, float]] = {}
        self.T_cw, self.velocity, self.affine = np.eye(4), np.eye(4), np.zeros(2)
        self.lost = 0
        self.mean_rms = 0.0

    def track(self, frame: Frame) -> Array | None:
        pyramid = self.face_set.pyramid(frame.image, self.levels)
        if self.window is not None:
            self.finder.push(pyramid)
            return self._track(frame, pyramid)
        if not self.waiting and int(np.ptp(pyramid[-1][:, 1:-1, 1:-1])) < 10:
            return None  # a blank image cannot start anything
        self.waiting.append((frame, pyramid))
        first = self.depth.add(self.stereo.frame(frame))
        return None if first is None else self._begin(first)

    # -- the first window --------------------------------------------------------------------------------------

    def _begin(self, first: DepthEstimate) -> Array | None:
        """Make points of the first frame at the estimated depth, then track the frames that were waiting for it."""
        self.first = first
        waiting, self.waiting = self.waiting, []
        start = next((i for i, (f, _) in enumerate(waiting) if f.index == first.frame_index), 0)
        frame, pyramid = waiting[start]
        bearings = choose_pixels(self.face_set, pyramid[0], self.config.points, np.empty((0, 3)))
        distance = self.stereo.depth_along(first.depth, bearings)
        use = np.isfinite(distance) & (distance > 0)
        rho = 1.0 / distance[use]
        window = Window(self.config, self.face_set, self.levels)
        window.points = make_points(self.face_set, pyramid, bearings[use], 0, rho, 0.5 * rho, 2 * rho)
        window.candidates = PointCloud.empty(self.levels)
        if len(window.points) < 50:
            self.context.log(f"frame {frame.index}: only {len(window.points)} usable points, no start")
            return None
        self.window = window
        self._add(frame, pyramid, np.eye(4), np.zeros(2))
        self.records.append(_Tracked(frame.index, frame.time, 0, np.eye(4)))
        self.context.log(f"frame {frame.index}: {len(window.points)} points; {first.message}")
        last: Array | None = np.eye(4)
        for other, other_pyramid in waiting[start + 1 :]:
            guess = first.T_wc.get(other.index)
            self.finder.push(other_pyramid)
            last = self._track(other, other_pyramid, None if guess is None else invert_pose(guess))
        return last

    # -- every frame -------------------------------------------------------------------------------------------

    def _track(self, frame: Frame, pyramid: Pyramid, guess: Array | None = None) -> Array | None:
        window = self.window
        assert window is not None
        found = self._align(window, pyramid, guess)
        if found is None:
            if self.lost == 0:
                self.context.log(f"frame {frame.index}: lost")
            self.lost += 1
            self.velocity = np.eye(4)
            return None
        self.velocity = np.eye(4) if self.lost else renormalise(found.T_cw @ invert_pose(self.T_cw))
        self.lost = 0
        self.T_cw, self.affine = found.T_cw, found.affine
        self.mean_rms = found.rms if self.mean_rms == 0 else 0.9 * self.mean_rms + 0.1 * found.rms
        self.numbers[frame.index] = {"rms": found.rms, "in_view": found.seen, "used": found.used}
        if frame.mappable:
            trace_candidates(window, pyramid, self.T_cw, self.affine)
            if self._wants_keyframe(window, found):
                self._add(frame, pyramid, self.T_cw, self.affine)
                self._refine(window)
        number = len(self.poses) - 1
        self.records.append(_Tracked(frame.index, frame.time, number, self.T_cw @ invert_pose(self.poses[number])))
        return invert_pose(self.T_cw)

    def _align(self, window: Window, pyramid: Pyramid, guess: Array | None) -> Alignment | None:
        """The alignment from the first initial pose that gives a residual similar to those of the frames before."""
        limit = min(self.config.lost_residual, max(8.0, 2.0 * self.mean_rms))
        best = None
        for T in (
            guess if guess is not None else self.velocity @ self.T_cw,
            make_pose(self.finder.rotation(), np.zeros(3)) @ self.T_cw,
        ):
            found = align(window, pyramid, renormalise(T), self.affine)
            if found is None or found.used < 0.5:
                continue
            if found.rms < limit:
                return found
            if best is None or found.rms < best.rms:
                best = found
        return best if best is not None and best.rms < self.config.lost_residual and best.used > 0.7 else None

    def _wants_keyframe(self, window: Window, found: Alignment) -> bool:
        last = window.keyframes[-1]
        moved = np.linalg.norm(invert_pose(found.T_cw)[:3, 3] - invert_pose(last.T_cw)[:3, 3])
        depth = 1.0 / float(np.median(window.points.rho))
        few = found.seen * found.used < self.config.keyframe_overlap and moved > 0.01 * depth
        return bool(moved > self.config.keyframe_distance * depth or few)

    def _add(self, frame: Frame, pyramid: Pyramid, T_cw: Array, affine: Array) -> None:
        assert self.window is not None
        self.window.keyframes.append(DirectKeyframe(len(self.poses), frame.index, T_cw, pyramid, affine))
        self.poses.append(T_cw)
        self.keyframes.append(frame.index)

    def _refine(self, window: Window) -> None:
        """Activate points, adjust the window, and drop the oldest keyframe if the window is full."""
        activate(window, self.rng)
        window.adjust(self.config.iterations)
        if len(window.keyframes) > self.config.window:
            window.drop_oldest()
        add_candidates(window)
        for keyframe in window.keyframes:
            self.poses[keyframe.number] = keyframe.T_cw
        self.T_cw, self.affine = window.keyframes[-1].T_cw, window.keyframes[-1].affine

    # -- the end -----------------------------------------------------------------------------------------------

    def finish(self) -> Estimate:
        if self.window is None and self.waiting:
            first = self.depth.finish()
            if first is not None and first.ok:
                self._begin(first)
        if not self.records:
            return Estimate(Trajectory(np.empty(0), np.empty((0, 4, 4))), depth=self._depth_map())
        poses = [invert_pose(renormalise(r.T_ck @ self.poses[r.keyframe])) for r in self.records]
        return Estimate(
            Trajectory(np.array([r.time for r in self.records]), np.stack(poses)),
            keyframes=self.keyframes,
            metric=bool(self.first and self.first.metric),
            frames=self.numbers,
            depth=self._depth_map(),
        )

    def _depth_map(self) -> DepthEstimate | None:
        """The first depth at the original camera's pixels."""
        if self.first is None:
            return None
        return dataclasses.replace(self.first, depth=self.stereo.depth_map(self.first.depth), confidence=None)


def _estimator(context: MethodContext) -> DepthEstimator:
    if context.make_depth is not None:
        return context.make_depth()
    from panobench.depth.bootstrap import BootstrapDepth

    return BootstrapDepth()
