"""Mapping: keyframes, new Gaussians where the map is thin or wrong, and finer ones where it is too coarse."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import Sim3
from panobench.methods.ground import height_above_ground
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapping.keyframes import is_keyframe
from panobench.methods.panogs.mapping.map_optimiser import MapOptimiser
from panobench.methods.panogs.mapping.seed_pattern import EVEN, LEVELS, SeedPattern
from panobench.methods.panogs.mapping.split import SplitRule, halves, too_coarse
from panobench.methods.panogs.tracking.tracker import Tracked
from panobench.methods.panogs.trajectory import AnchoredTrajectory, WorldMotion
from panobench.methods.splatting.covisibility import overlap, update_window
from panobench.methods.splatting.occlusion import OccludedMap
from panobench.methods.splatting.seeding import fill_depth, seed_gaussians
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.transients import Transients
from panobench.methods.splatting.views import SeenGaussians, View
from panobench.photometric.overlap import ViewWidth
from panobench.splat.gaussians import F32
from panobench.splat.loss import colour_error
from panobench.splat.render import Render, Renderer
from panobench.types import Frame

Mask = NDArray[np.bool_]


class Mapper:
    """Owns the map and decides what goes into it; ``optimiser`` trains it."""

    def __init__(
        self,
        camera: Camera,
        renderer: Renderer,
        config: PanogsConfig,
        trajectory: AnchoredTrajectory,
        seed: int,
    ) -> None:
        self.camera, self.renderer, self.config, self.trajectory = camera, renderer, config, trajectory
        self.rng = np.random.default_rng(seed)
        self.map = TrainableMap(config.rates.beta1, config.rates.beta2, renderer.device)
        self.optimiser = MapOptimiser(camera, renderer, config, self.map, trajectory, self.rng)
        self.weights, self.width = self.optimiser.weights, ViewWidth.of(camera)
        self.occluded = OccludedMap(self.map, self.weights, config.mapping.culling_px, config.tracking.opacity_min)
        self._rays = np.nan_to_num(camera.rays()[::4, ::4])
        self.split_count = 0
        valid = int(np.count_nonzero(camera.valid_mask()))
        self.seeds_per_image = max(int(valid / config.seeding.pixels_per_gaussian), 16)
        self.split_rule = SplitRule(
            config.density.split_error, config.density.split_size_px, config.density.split_share
        )
        self.pattern = SeedPattern(camera, self.seeds_per_image, LEVELS if config.density.adaptive else EVEN)

    @property
    def scene_depth(self) -> float:
        """Median depth of the first map."""
        return self.optimiser.scene_depth

    @property
    def transients(self) -> Transients:
        """What contradicts the map."""
        return self.optimiser.transients

    @property
    def window(self) -> list[View]:
        """Keyframes that are optimised together, newest first."""
        return self.optimiser.window

    def world_moved(self, motion: WorldMotion) -> None:
        """As ``WorldFollower.world_moved``: Gaussians go along with the keyframes that brought them."""
        self.map.follow(motion.keyframes)

    def adopt(self, other: Mapper, motion: Sim3, numbers: list[int]) -> None:
        """Take over another map, of whose world ``motion`` is the motion into this one, and go on with its window.

        numbers: those that its keyframes have in this trajectory.
        """
        self.map.append(other.map.gaussians.transformed(motion), np.array(numbers, np.int32)[other.map.anchors])
        self._set_window(other.window)
        for view in self.window:
            view.seen = self._seen(self.renderer.forward(self.map.gaussians, view.T_wc, count_touched=True))

    # -- frames ------------------------------------------------------------------------------------------------------

    def initialise(self, view: View, time: float, depth_map: F32, seen: Mask | None = None) -> None:
        """The first map, from the first keyframe and its radial depth (H, W); only where ``seen`` (H, W), if given."""
        depth_map = fill_depth(depth_map, self.camera.kind == "erp")
        self.optimiser.scene_depth = float(np.nanmedian(depth_map))
        wanted = view.visible if seen is None else seen if view.visible is None else view.visible & seen
        self.seed(view, depth_map, *self.pattern.seeds(view.image, wanted, self.rng))
        render = self.renderer.forward(self.map.gaussians, view.T_wc, count_touched=True)
        view.seen = self._seen(render)
        self.add_keyframe(view, [view], time)
        self.optimiser.optimise(self.config.start.iterations, poses=False)

    def add_frame(self, frame: Frame, tracked: Tracked) -> tuple[bool, float]:
        """Map a tracked frame: make it a keyframe, or keep it for training.

        Returns whether it is a keyframe, and the share of it that the map did not know or drew wrong.
        """
        c, render = self.config, tracked.render
        last = self.window[0]
        view = View(frame.index, frame.image, tracked.T_wc, seen=self._seen(render), visible=frame.mask)
        assert view.seen is not None
        assert last.seen is not None
        self.optimiser.update_culling(view, render)
        unknown = self.unknown(view, render)
        new_share = float(self.weights[unknown].sum())
        distance = float(np.linalg.norm(view.position - last.position)) / self.local_depth(render)
        if self.width is ViewWidth.WIDE:
            distance /= c.keyframes.wide
        window_full = len(self.window) >= c.keyframes.window
        since = abs(frame.index - last.index)
        if not is_keyframe(
            c.keyframes, overlap(view.seen, last.seen, self.map.ids), distance, since, window_full, new_share
        ):
            self.remember(view)
            return False, new_share
        self.add_keyframe(view, update_window(self.window, view, c.keyframes.window, self.map.ids))
        if c.density.adaptive and new_share < c.density.split_new_share:
            self.split(view, render, ~unknown if view.visible is None else ~unknown & view.visible)
        before = len(self.map)
        self.optimiser.plan(c.mapping.iterations)
        if not c.fixed_lag.sweep:
            self.insert(view, render)
            self.plan_for_new(before)
            self.optimiser.work_all()
        return True, new_share

    def add_keyframe(self, view: View, window: list[View], time: float | None = None) -> None:
        """``window`` is the new one; keyframes that leave it are kept like other frames."""
        self._set_window(window)
        self.trajectory.add_keyframe(view, time)

    def _set_window(self, window: list[View]) -> None:
        for old in self.window:
            if old not in window:
                self.remember(old)
        self.optimiser.window = window

    def remember(self, view: View) -> None:
        """Keep a frame for training. Beyond ``frame_pool`` a random one loses its image, which bounds the memory."""
        frames, view.seen = self.trajectory.frames, None  # only those in the window are asked for co-visibility
        frames.append(view)
        if len(frames) > self.config.mapping.frame_pool:
            self.optimiser.forget_image(frames.pop(int(self.rng.integers(len(frames)))))

    def replace_image(self, index: int, image: NDArray[np.uint8]) -> None:
        """Another image (H, W, 3) of a frame that still has one, by its index in the sequence."""
        for view in (*self.window, *self.trajectory.frames):
            if view.index == index and view.image.size:
                view.image = image

    def plan_for_new(self, before: int) -> None:
        """Steps at once for what the map has gained on ``before`` Gaussians: the next frames are tracked on it."""
        gained = max(len(self.map) - before, 0) / self.seeds_per_image
        self.optimiser.plan(round(self.config.mapping.iterations * min(4.0 * gained, 1.0)), first=True)

    def _seen(self, render: Render) -> SeenGaussians:
        assert render.touched is not None
        return SeenGaussians.of(render.touched, self.map.ids, self.map.next_id)

    # -- what the map lacks ------------------------------------------------------------------------------------------

    def local_depth(self, render: Render) -> float:
        """Median rendered depth, from every fourth row and column; the first map's where nothing is drawn."""
        depth = render.depth[::4, ::4][self._known(render)]
        return float(np.median(depth)) if depth.size else self.scene_depth

    def height(self, render: Render) -> float:
        """The camera's height above what a render shows below it, from every fourth row and column; NaN if unknown."""
        known = self._known(render)
        return height_above_ground(self._rays[known], render.depth[::4, ::4][known])

    def _known(self, render: Render) -> Mask:
        """Where a render has a depth, in every fourth row and column."""
        return np.asarray((render.opacity[::4, ::4] > 0.5) & (self.weights[::4, ::4] > 0))

    def thin(self, render: Render) -> Mask:
        """(H, W): valid pixels whose rendered opacity is below ``seeding.opacity_below``."""
        return (render.opacity < self.config.seeding.opacity_below) & (self.weights > 0)

    def wrong(self, view: View, render: Render) -> Mask:
        """(H, W): valid pixels whose colour the map misses by more than ``seeding.error_above``, over 5 x 5 pixels."""
        return (cv2.blur(self._error(view, render), (5, 5)) > self.config.seeding.error_above) & (self.weights > 0)

    def unknown(self, view: View, render: Render) -> Mask:
        """(H, W): where the map is thin or wrong."""
        unknown = self.thin(render) | self.wrong(view, render)
        return unknown if view.visible is None else unknown & view.visible

    @staticmethod
    def _error(view: View, render: Render) -> F32:
        """(H, W): mean absolute difference of render and image over the colours, of 1."""
        return np.asarray(colour_error(render.planes, view.image))

    # -- growing -----------------------------------------------------------------------------------------------------

    def insert(
        self,
        view: View,
        render: Render,
        swept: F32 | None = None,
        disproved: Mask | None = None,
        confirmed: Mask | None = None,
    ) -> int:
        """New Gaussians where the map is thin or wrong in ``view``, of which ``render`` is; returns how many.

        Depth is ``swept`` (H, W) from the last frames if given. Else it is the rendered depth, or that of the nearest
        pixel that has one (across the seam) plus a small perturbation (DGIS); without ``depth_guided`` it is the median
        depth, perturbed as in MonoGS. disproved (H, W): where the swept depth also replaces what the map has.
        confirmed (H, W): nothing is replaced elsewhere.
        """
        wanted = self.thin(render)
        if swept is not None:
            wrong = self.wrong(view, render)
            if disproved is not None:
                wrong |= disproved & (self.weights > 0)
            if confirmed is not None:
                wrong &= confirmed
            if view.visible is not None:
                wrong &= view.visible
            wanted |= wrong
            if self.config.seeding.carve:
                self.carve(view, render, wrong, swept)
        if view.visible is not None:
            wanted &= view.visible
        pixels, spacing = self.pattern.seeds(view.image, wanted, self.rng)
        if len(pixels) == 0:
            return 0
        depth_map = self._guessed_depth(render) if swept is None else swept
        return self.seed(view, depth_map, pixels, spacing)

    def insert_where(self, view: View, wanted: Mask, depth_map: F32) -> int:
        """New Gaussians where ``wanted`` (H, W) and ``depth_map`` (H, W) has a depth; returns how many."""
        wanted = wanted & np.isfinite(depth_map)
        if view.visible is not None:
            wanted &= view.visible
        pixels, spacing = self.pattern.seeds(view.image, wanted, self.rng)
        return self.seed(view, depth_map, pixels, spacing) if len(pixels) else 0

    def _guessed_depth(self, render: Render) -> F32:
        """(H, W): the rendered depth, perturbed where it is a guess."""
        known = render.expected_depth(0.5)
        if self.config.seeding.depth_guided:
            depth_map, noise = fill_depth(known, self.camera.kind == "erp"), 0.02
            guessed = ~np.isfinite(known)
        else:
            depth_map, noise = np.full_like(known, self.scene_depth), 0.15
            guessed = np.ones(known.shape, bool)
        perturbed = depth_map * (1 + noise * self.rng.standard_normal(depth_map.shape))
        return np.where(guessed, perturbed, depth_map).astype(np.float32)

    def carve(self, view: View, render: Render, wrong: Mask, swept: F32) -> int:
        """Drop what stands well in front of the swept surface where the map is wrong; returns how many.

        New Gaussians behind it would never be seen. A large Gaussian may cover an opening from beside it, so what
        counts is where it is seen (in ``render``, of ``view``), not where its centre lies.
        """
        o = self.config.seeding
        distance = np.linalg.norm(self.map.gaussians.means - view.position, axis=1)
        known = wrong & np.isfinite(swept)
        shares = np.stack([known, self.weights > 0, np.where(known, swept, 0)]).astype(np.float32)
        there, anywhere, deep = render.weighted_sums(shares).T
        surface = deep / np.maximum(there, 1e-6)
        in_front = (there > o.carve_share * anywhere) & (there > 1e-3) & (distance < o.carve_depth * surface)
        return self.map.drop(in_front)

    def split(self, view: View, render: Render, known: Mask | None = None) -> int:
        """Halve what is too coarse for ``view``, of which ``render`` is; returns how many.

        known (H, W): pixels where the map's surface is believed to be right. All splits together add at most as many
        Gaussians as one image is seeded with.
        """
        error = self._error(view, render)
        # What is thin gets new Gaussians instead; exactly no error is rare enough to mean "not looked at".
        error = np.where((self.weights > 0) & (render.opacity > 0.9), error, 0).astype(np.float32)
        if known is not None:
            error *= known
        room = self.seeds_per_image - self.split_count
        which = too_coarse(render, self.map.gaussians, view.position, error, self.split_rule)[:room]
        if len(which) == 0:
            return 0
        self.split_count += len(which)
        parents = self.map.ids[which]
        children = self.map.append(halves(self.map.gaussians, which), np.tile(self.map.anchors[which], 2))
        for other in self.window:
            if other.seen is not None:
                other.seen.inherit(np.tile(parents, 2), children, self.map.next_id)
        gone = np.zeros(len(self.map), bool)
        gone[which] = True
        return self.map.drop(gone)

    def seed(self, view: View, depth_map: F32, pixels: NDArray[np.float64], spacing: NDArray[np.float64]) -> int:
        """New Gaussians at ``pixels`` (M, 2) of ``view``, ``spacing`` (M,) pixels apart; returns how many."""
        o = self.config.seeding
        new = seed_gaussians(
            self.camera, view.image, depth_map, pixels, view.T_wc, spacing,
            flatten=o.flatten, scale_factor=o.scale_factor, opacity=o.opacity,
        )  # fmt: skip
        self.map.append(new, max(len(self.trajectory.keyframes) - 1, 0))
        return len(new)
