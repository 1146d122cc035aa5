"""MonoGS's back-end: new Gaussians at keyframes, joint steps over the window, pruning by co-visibility."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.monogs.config import MonogsConfig
from panobench.methods.monogs.tracker import CameraAdam, bright, camera_rates
from panobench.methods.splatting.covisibility import update_window
from panobench.methods.splatting.densify import fade, grow, logit, prune
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.trainer import GaussianTrainer
from panobench.methods.splatting.views import SeenGaussians, View
from panobench.splat.adam import LearningRates
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.render import Render, Renderer

Array = NDArray[np.float64]

#: Pixels with less opacity have no depth worth keeping.
OPAQUE = 0.95
#: Opacity given to what no keyframe of the window sees, from time to time.
UNSEEN_OPACITY = 0.4
#: Rows of the images whose settings were published.
ROWS = 480
#: Most Gaussians per pixel: a guard, not part of the method.
MOST_PER_PIXEL = 2.0


@dataclass
class Keyframe(View):
    """number: counts keyframes. weights (H, W): uniform on what the image shows."""

    number: int = 0
    weights: F32 = field(default_factory=lambda: np.zeros((0, 0), np.float32))


def median_depth(render: Render, shown: NDArray[np.bool_]) -> tuple[float, float]:
    """Median and standard deviation of the rendered depth where it can be trusted; NaN if nowhere."""
    depth = render.expected_depth(OPAQUE)
    known = depth[shown & np.isfinite(depth) & (depth > 0)]
    return (float(np.median(known)), float(np.std(known))) if len(known) else (float("nan"), float("nan"))


class MonogsMapper:
    """Owns the map and the window (newest first). initialised: the window has been full once."""

    def __init__(self, camera: Camera, renderer: Renderer, config: MonogsConfig, rng: np.random.Generator) -> None:
        self.camera, self.config, self.rng = camera, config, rng
        self.valid, self.rays = camera.valid_mask(), camera.rays()
        self.map = TrainableMap()
        self.trainer = GaussianTrainer(renderer, self.map, isotropy=config.isotropy)
        self.window: list[Keyframe] = []
        self.keyframes: list[Keyframe] = []
        self.initialised = False
        self.steps = 0

    def keyframe(self, index: int, image: NDArray[np.uint8], T_wc: Array, gain: float, offset: float) -> Keyframe:
        """The next keyframe; it becomes one of the map's with ``begin`` or ``extend``."""
        weights = bright(self.config, image, self.valid) / np.float32(image.shape[0] * image.shape[1])
        number = self.keyframes[-1].number + 1 if self.keyframes else 0
        return Keyframe(index, image, T_wc, gain, offset, number=number, weights=weights.astype(np.float32))

    # -- growing -----------------------------------------------------------------------------------------------

    def begin(self, view: Keyframe) -> None:
        """The first map: a fronto-parallel layer of noisy depth, and many steps on this view alone."""
        c = self.config
        z = c.first_depth + c.first_depth_noise * self.rng.standard_normal(self.valid.shape)
        self._insert(view, (z / np.maximum(self.rays[..., 2], 0.1)).astype(np.float32), c.first_share)
        self.keyframes.append(view)
        self.window = [view]
        for step in range(1, c.initial_iterations + 1):
            self.trainer.step([view], self._rates())
            if step % c.initial_update == 0:
                self._densify(0.005, 30 * c.extent, None)
            if step == c.initial_fade:
                fade(self.map, 0.01)
        self.steps = c.initial_iterations
        self._look()

    def extend(self, view: Keyframe, render: Render) -> bool:
        """A further keyframe; False when one left (``update_window``) before the window was full for the first time."""
        depth = render.expected_depth(OPAQUE)
        middle, spread = median_depth(render, view.weights > 0)
        if not np.isfinite(middle):
            middle, spread = self.config.first_depth, self.config.first_depth_noise
        with np.errstate(invalid="ignore"):
            wild = ~(np.abs(depth - middle) <= spread)  # also where it is not known
        noise = self.rng.standard_normal(depth.shape) * np.where(wild, 0.5 * spread, 0.2 * spread)
        depth = np.maximum(np.where(wild, middle, depth) + noise, 0.05 * middle)
        before = len(self.window)
        least = self.config.window_overlap if self.initialised else self.config.window_overlap_start
        self.window = update_window(self.window, view, self.config.window, self.map.ids, least)
        self.keyframes.append(view)
        self._insert(view, depth.astype(np.float32), self.config.later_share)
        return self.initialised or len(self.window) > before

    def _insert(self, view: Keyframe, depth: F32, share: int) -> None:
        """Gaussians at one in ``share`` of the pixels shown, at radial ``depth`` (H, W)."""
        c = self.config
        shown = np.flatnonzero(view.weights > 0)
        count = min(len(shown), max(16, len(shown) // share))
        if count == 0:
            return
        row, column = np.unravel_index(np.sort(self.rng.choice(shown, count, replace=False)), self.valid.shape)
        d = depth[row, column].astype(np.float64)
        points = (self.rays[row, column] * d[:, None]) @ view.T_wc[:3, :3].T + view.T_wc[:3, 3]
        gaps, _ = cKDTree(points).query(points, k=min(4, count))
        squared = np.mean(np.atleast_2d(gaps.reshape(count, -1)[:, 1:]) ** 2, axis=1) if count > 1 else np.ones(1)
        size = min(0.05, c.point_size * float(np.median(d)))
        log_scale = 0.5 * np.log(np.maximum(squared, 1e-7) * size)
        new = GaussianMap(
            points,
            np.repeat(log_scale[:, None], 3, axis=1),
            np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)),
            np.full(count, logit(c.initial_opacity)),
            view.image[row, column] / np.float32(255),
        )
        self.map.append(new, view.number)

    # -- optimising --------------------------------------------------------------------------------------------

    def optimise(self) -> float:
        """The steps of one keyframe, then pruning by co-visibility; returns the mean loss of the last step."""
        c = self.config
        others = [k for k in self.keyframes if k not in self.window]
        first = self.keyframes[0]
        cameras = {
            id(k): CameraAdam(
                camera_rates(c, 0.5 if i < c.refined_poses else 0.0), invert_pose(k.T_wc), np.array([k.gain, k.offset])
            )
            for i, k in enumerate(self.window)
            if k is not first
        }
        loss = 0.0
        fills = not self.initialised and len(self.window) == c.window
        for _ in range(c.joint_iterations if fills else c.mapping_iterations):
            self.steps += 1
            views = self._chosen(self.window, c.window_views, newest=True) + self._chosen(others, c.random_views)
            results = self.trainer.step(views, self._rates())
            loss = float(np.mean([r.loss for r in results]))
            for view, result in zip(views, results):
                adam = cameras.get(id(view))
                if adam is not None:
                    adam.step(result.gradients.pose, result.d_exposure)
                    view.T_wc = invert_pose(adam.T_cw)
                    view.gain, view.offset = (float(e) for e in adam.exposure)
            if self.steps % c.update_every == c.update_offset % c.update_every:
                self._densify(c.prune_opacity, c.extent, c.prune_pixels)
            elif self.steps % c.fade_every == 0:
                fade(self.map, UNSEEN_OPACITY, self._seen_by_window().sum(axis=0) == 0)
        self._prune_unconfirmed()
        self._look()
        return loss

    def refine_colours(self, iterations: int) -> None:
        """Steps on random keyframes, poses fixed."""
        for _ in range(iterations if self.keyframes else 0):
            view = self.keyframes[int(self.rng.integers(len(self.keyframes)))]
            self.trainer.step([view], self._rates())

    def _chosen(self, views: list[Keyframe], most: int, newest: bool = False) -> list[Keyframe]:
        """At most that many, at random; ``newest``: the first is always among them."""
        if len(views) <= most:
            return list(views)
        if newest:
            return [views[0], *(views[1 + i] for i in self.rng.choice(len(views) - 1, most - 1, replace=False))]
        return [views[i] for i in self.rng.choice(len(views), most, replace=False)]

    def _rates(self) -> LearningRates:
        c = self.config
        share = min(1.0, self.steps / c.rate_steps)
        position = float(np.exp((1 - share) * np.log(c.position_rate) + share * np.log(c.position_rate_end)))
        return LearningRates(position * c.extent, c.scale_rate * c.extent, c.turn_rate, c.opacity_rate, c.colour_rate)

    def _densify(self, opacity: float, extent: float, pixels: float | None) -> None:
        most = int(MOST_PER_PIXEL * np.count_nonzero(self.valid))
        pull = self.config.pull * ROWS / self.camera.height
        grow(self.map, pull, 0.01 * extent, self.rng, most)
        huge = None if pixels is None else self._radii() > pixels
        prune(self.map, opacity, 0.1 * extent if pixels is not None else np.inf, huge)

    def _radii(self) -> Array:
        """Largest radius (three standard deviations) in pixels over the window's keyframes that may see it (N,)."""
        size = 3 * np.exp(self.map.gaussians.log_scales.max(axis=1)) / self.trainer.renderer.view.pixel_angle
        out = np.zeros(len(self.map))
        for view in self.window:
            T = invert_pose(view.T_wc)
            p = self.map.gaussians.means @ T[:3, :3].T + T[:3, 3]
            out = np.maximum(out, np.where(p[:, 2] > 0, size / np.maximum(np.linalg.norm(p, axis=1), 1e-6), 0.0))
        return out

    # -- visibility --------------------------------------------------------------------------------------------

    def _seen_by_window(self) -> NDArray[np.bool_]:
        """(K, N): which Gaussians each keyframe of the window touches."""
        rows = []
        for view in self.window:
            out = self.trainer.renderer.forward(self.map.gaussians, view.T_wc, count_touched=True)
            assert out.touched is not None
            rows.append(out.touched > 0)
        return np.stack(rows)

    def seen(self, touched: NDArray) -> SeenGaussians:
        """The Gaussians of the map (N,) that a render of it touches."""
        return SeenGaussians.of(touched, self.map.ids, self.map.next_id)

    def _look(self) -> None:
        """Remember what the window sees, for the next overlap."""
        for view, seen in zip(self.window, self._seen_by_window()):
            view.seen = self.seen(seen)

    def _prune_unconfirmed(self) -> None:
        """With a full window, Gaussians of its newest three keyframes that at most three of the window see go.

        When it is full for the first time, all those that at most three see.
        """
        if len(self.window) < self.config.window or not len(self.map):
            return
        seen = self._seen_by_window().sum(axis=0)
        young = self.map.anchors >= sorted((k.number for k in self.window), reverse=True)[min(2, len(self.window) - 1)]
        if not self.initialised:
            young[:] = True
            self.initialised = True
        drop = young & (seen <= self.config.prune_seen)
        if drop.any() and not drop.all():
            self.map.keep(~drop)
