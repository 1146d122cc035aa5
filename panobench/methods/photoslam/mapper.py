"""The Gaussian map of one feature map: it grows at its keyframes and follows their corrections."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from panobench.cameras.base import Camera
from panobench.geometry import Sim3, invert_pose
from panobench.methods.photoslam.config import PhotoslamConfig
from panobench.methods.sparse.pointmap import ACTIVE, PointMap
from panobench.methods.splatting.densify import grow, prune
from panobench.methods.splatting.seeding import equal_area_pixels, fill_depth, seed_gaussians
from panobench.methods.splatting.sweeping import DepthSweeper
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.trainer import GaussianTrainer, PosedImage
from panobench.splat.adam import LearningRates
from panobench.splat.gaussians import F32
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer

Array = NDArray[np.float64]

#: Points around a pixel its depth is taken from.
NEIGHBOURS = 4
#: Keyframes whose Gaussians move by less than this (metres per metre, or radians) are left where they are.
STILL = 1e-4
#: Keyframes kept for sweeps.
SWEPT = 10
#: Steps in a row at which the newest keyframe is shown, out of this many.
NEWEST_EVERY = 3


@dataclass
class _Level:
    """One size of the image pyramid."""

    renderer: Renderer
    weights: F32


@dataclass
class MappedKeyframe:
    """A keyframe as the map knows it: its images per level, the pose and the median distance of its points."""

    number: int
    index: int
    images: list[NDArray[np.uint8]]
    T_wc: Array
    distance: float

    def view(self, level: int, weights: F32) -> PosedImage:
        return PosedImage(self.index, self.images[level], self.T_wc, weights)


class PhotoslamMapper:
    """Gaussians carry the number of the keyframe that made them (``map.anchors``)."""

    def __init__(self, camera: Camera, config: PhotoslamConfig, seed: int) -> None:
        self.camera, self.config = camera, config
        self.rng = np.random.default_rng(seed)
        self.valid, self.rays = camera.valid_mask(), np.nan_to_num(camera.rays())
        self.levels = [_Level(Renderer(camera, "sphere", config.low_pass), pixel_weights(camera))]
        for level in range(1, config.levels):
            if camera.width % (2 << level) or camera.height % (2 << level) or camera.width >> level < 32:
                break
            small = camera.scaled(camera.width >> level)
            self.levels.append(_Level(Renderer(small, "sphere", config.low_pass), pixel_weights(small)))
        self.map = TrainableMap(beta2=0.99)
        self.trainer = GaussianTrainer(self.levels[0].renderer, self.map, knee=config.loss_knee)
        self.count = max(int(np.count_nonzero(self.valid) / config.pixels_per_gaussian), 16)
        self.spacing = float(np.sqrt(camera.solid_angle().sum() / self.count))
        self.keyframes: dict[int, MappedKeyframe] = {}
        self.known = 0  # keyframes of the feature map handed over
        self.sweeper = DepthSweeper(camera, 256, 6) if config.depth == "sweep" else None
        self.swept: list[int] = []
        self.median_depth = 2.0

    # -- following the feature map -----------------------------------------------------------------------------

    def follow(self, points: PointMap) -> int:
        """Move Gaussians with their keyframes after bundle adjustment or a loop; returns how many keyframes moved."""
        moved = 0
        for k, mine in self.keyframes.items():
            T_wc = invert_pose(points.keyframes[k].T_cw)
            distance = _median_distance(points, k)
            scale = 1.0
            if distance > 0 and mine.distance > 0 and abs(np.log(distance / mine.distance)) > 0.02:
                scale = distance / mine.distance  # only a loop changes the scale this much
            off = invert_pose(mine.T_wc) @ T_wc
            if np.linalg.norm(off[:3, 3]) < STILL * self.median_depth and np.abs(off[:3, :3] - np.eye(3)).max() < STILL:
                continue
            which = self.map.anchors == k
            if which.any():
                R = T_wc[:3, :3] @ mine.T_wc[:3, :3].T
                self.map.move(which, Sim3(scale, R, T_wc[:3, 3] - scale * R @ mine.T_wc[:3, 3]))
            mine.T_wc, mine.distance = T_wc, distance
            if self.sweeper is not None and k in self.swept:
                self.sweeper.move(self.swept.index(k), T_wc)
            moved += 1
        return moved

    # -- growing -----------------------------------------------------------------------------------------------

    def add(self, points: PointMap, number: int, index: int, image: NDArray[np.uint8]) -> None:
        """A keyframe of the feature map with its image: new Gaussians where the map does not show it, then training."""
        images = [image]
        for _ in self.levels[1:]:
            h, w = images[-1].shape[:2]
            images.append(np.asarray(cv2.resize(images[-1], (w // 2, h // 2), interpolation=cv2.INTER_AREA), np.uint8))
        T_wc = invert_pose(points.keyframes[number].T_cw)
        keyframe = MappedKeyframe(number, index, images, T_wc, _median_distance(points, number))
        if keyframe.distance > 0:
            self.median_depth = keyframe.distance
        z = self.median_depth
        self.trainer.scale_bounds = (1e-4 * z, 0.5 * z)
        self._insert(points, keyframe)
        self.keyframes[number] = keyframe
        self._train(keyframe)
        if self.config.densify_every and len(self.keyframes) % self.config.densify_every == 0:
            grow(self.map, self.config.pull, 0.01 * z, self.rng, self._most())
        prune(self.map, self.config.prune_opacity, self.config.largest_rel * z)

    def _most(self) -> int:
        return int(self.config.most_per_pixel * np.count_nonzero(self.valid))

    def _insert(self, points: PointMap, keyframe: MappedKeyframe) -> None:
        c, image = self.config, keyframe.images[0]
        depth = self._depth(points, keyframe)
        if depth is None:
            return
        pixels = equal_area_pixels(self.camera, self.count, self.rng)
        if len(self.map):
            out = self.levels[0].renderer.forward(self.map.gaussians, keyframe.T_wc)
            error = cv2.blur(np.abs(out.colour - image / np.float32(255)).mean(axis=-1), (5, 5))
            wanted = self.valid & ((out.opacity < c.insert_opacity) | (error > c.insert_error))
            column = np.clip(pixels[:, 0].astype(int), 0, self.camera.width - 1)
            row = np.clip(pixels[:, 1].astype(int), 0, self.camera.height - 1)
            pixels = pixels[wanted[row, column]]
            pixels = pixels[: max(0, self._most() - len(self.map))]
        if len(pixels):
            new = seed_gaussians(
                self.camera, image, depth, pixels, keyframe.T_wc, self.spacing,
                flatten=c.flatten, scale_factor=c.scale_factor, opacity=c.initial_opacity,
            )  # fmt: skip
            self.map.append(new, keyframe.number)

    def _depth(self, points: PointMap, keyframe: MappedKeyframe) -> F32 | None:
        """Radial depth (H, W) of a keyframe; None when too little is known."""
        if self.sweeper is not None:
            self.sweeper.add(keyframe.images[0], keyframe.T_wc)
            self.swept.append(keyframe.number)
            if len(self.swept) > SWEPT:
                self.sweeper.forget(1)
                del self.swept[0]
            self.sweeper.median_depth = self.median_depth
            swept = self.sweeper.depth(len(self.swept) - 1)
            if swept is not None:
                return fill_depth(swept, self.camera.kind == "erp")
        return self._depth_from_points(points, keyframe)

    def _depth_from_points(self, points: PointMap, keyframe: MappedKeyframe) -> F32 | None:
        """Inverse depth of the points the keyframe sees, interpolated between the nearest ones by angle."""
        key = points.keyframes[keyframe.number]
        active = points.state[key.points] == ACTIVE
        if int(active.sum()) < NEIGHBOURS:
            return None
        distance = np.linalg.norm(points.position[key.points[active]] - keyframe.T_wc[:3, 3], axis=1)
        gap, near = cKDTree(key.bearings[active]).query(self.rays[self.valid], k=NEIGHBOURS)
        weight = 1.0 / (gap**2 + 1e-4)
        out = np.full(self.valid.shape, np.nan, np.float32)
        out[self.valid] = weight.sum(axis=1) / np.sum(weight / distance[near], axis=1)
        return out

    # -- training ----------------------------------------------------------------------------------------------

    def _rates(self, share: float = 1.0) -> LearningRates:
        c = self.config
        return LearningRates(
            c.position_rate_rel * self.median_depth * share,
            c.scale_rate * share,
            c.rotation_rate * share,
            c.opacity_rate * share,
            c.colour_rate * share,
        )

    def _train(self, newest: MappedKeyframe) -> None:
        """The newest keyframe often, others at random; coarse images first."""
        everyone = list(self.keyframes.values())
        for step in range(self.config.mapping_iterations if len(self.map) else 0):
            level = max(0, len(self.levels) - 1 - 2 * step * len(self.levels) // self.config.mapping_iterations)
            chosen = newest if step % NEWEST_EVERY == 0 else everyone[int(self.rng.integers(len(everyone)))]
            size = self.levels[level]
            self.trainer.step([chosen.view(level, size.weights)], self._rates(), size.renderer)

    def finish(self) -> None:
        """The last steps, on all keyframes in random order with falling rates."""
        everyone, steps = list(self.keyframes.values()), self.config.final_iterations
        for step in range(steps if everyone and len(self.map) else 0):
            chosen = everyone[int(self.rng.integers(len(everyone)))]
            rates = self._rates(0.1 ** (step / steps))
            self.trainer.step([chosen.view(0, self.levels[0].weights)], rates)
        if len(self.map):
            prune(self.map, self.config.prune_opacity, self.config.largest_rel * self.median_depth)


def _median_distance(points: PointMap, number: int) -> float:
    """Of the points a keyframe sees, 0 without any."""
    key = points.keyframes[number]
    seen = key.points[points.state[key.points] == ACTIVE]
    if len(seen) == 0:
        return 0.0
    centre = invert_pose(key.T_cw)[:3, 3]
    return float(np.median(np.linalg.norm(points.position[seen] - centre, axis=1)))
