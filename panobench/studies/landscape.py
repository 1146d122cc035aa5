"""Measure the photometric loss around a true pose, and from which starts tracking converges, for ``basin``."""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.tracking.tracker import Tracker
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.splat.gaussians import GaussianMap
from panobench.splat.loss import photometric_loss, pixel_weights
from panobench.splat.render import Renderer

F64 = NDArray[np.float64]


@dataclass(frozen=True)
class Scene:
    """A map fitted to images with true poses and depths, and the frame to be found in it."""

    camera: Camera
    map: GaussianMap
    image: NDArray[np.uint8]
    T_wc: F64
    median_depth: float


@dataclass(frozen=True)
class Start:
    """A start pose's distance and direction (radians, in the X-Z plane) from the truth, and where tracking ended.

    distance, error: in median depths. rotation_deg: left over. converged: both are within the limits asked for.
    """

    distance: float
    direction: float
    error: float
    rotation_deg: float
    converged: bool


def fit_map(
    camera: Camera,
    images: Many[NDArray[np.uint8]],
    depths: Many[NDArray[np.float32]],
    poses: Many[F64],
    config: PanogsConfig,
    iterations: int,
    seed: int,
) -> tuple[GaussianMap, float]:
    """A map of views whose poses (4, 4) and radial depths (H, W) are true, and the median depth of the first."""
    renderer = Renderer(camera, "sphere", config.rendering.low_pass)
    mapper = Mapper(camera, renderer, config, AnchoredTrajectory(), seed)
    views = [View(i, image, T) for i, (image, T) in enumerate(zip(images, poses))]
    mapper.initialise(views[0], 0.0, depths[0])
    for i in range(1, len(views)):
        mapper.insert(views[i], renderer.forward(mapper.map.gaussians, views[i].T_wc), depths[i])
        mapper.add_keyframe(views[i], views[i::-1], float(i))
    mapper.optimiser.optimise(iterations, poses=False)
    mapper.optimiser.prune()
    return mapper.map.gaussians, mapper.scene_depth


def moved(T_wc: F64, x: float, z: float) -> F64:
    """The pose moved by x to its right and z forward, metres."""
    T = T_wc.copy()
    T[:3, 3] += T_wc[:3, :3] @ np.array([x, 0.0, z])
    return T


def loss_surface(scene: Scene, offsets: F64, config: PanogsConfig) -> F64:
    """(n, n) loss at offsets (n,), in median depths: [i, j] at z = offsets[i], x = offsets[j]."""
    renderer = Renderer(scene.camera, "sphere", config.rendering.low_pass)
    weights = pixel_weights(scene.camera, config.rendering.weights)
    out = np.empty((len(offsets), len(offsets)))
    for i, z in enumerate(offsets * scene.median_depth):
        for j, x in enumerate(offsets * scene.median_depth):
            render = renderer.forward(scene.map, moved(scene.T_wc, x, z))
            out[i, j] = photometric_loss(render.planes, scene.image, weights)[0]
    return out


def track_from(
    scene: Scene, distances: F64, directions: int, config: PanogsConfig, error_limit: float, rotation_limit_deg: float
) -> list[Start]:
    """Track the frame from starts on rings (radii in median depths) around the true pose, each with a fresh tracker."""
    renderer = Renderer(scene.camera, "sphere", config.rendering.low_pass, stop=1e-3)
    out = []
    for distance in distances:
        for angle in np.arange(directions) * 2 * np.pi / directions:
            r = distance * scene.median_depth
            tracker = Tracker(scene.camera, renderer, config)
            tracker.reset(moved(scene.T_wc, r * np.sin(angle), r * np.cos(angle)))
            found = tracker.track(scene.image, scene.map).T_wc
            delta = invert_pose(scene.T_wc) @ found
            error = float(np.linalg.norm(delta[:3, 3])) / scene.median_depth
            turn = float(np.degrees(np.arccos(np.clip((np.trace(delta[:3, :3]) - 1) / 2, -1, 1))))
            good = error < error_limit and turn < rotation_limit_deg
            out.append(Start(float(distance), float(angle), error, turn, good))
    return out


def pose_hessian(scene: Scene, config: PanogsConfig) -> F64:
    """(6, 6) Gauss-Newton Hessian of the mean residual over (translation, rotation) at the pose tracking converges to.

    Translations in median depths, rotations in radians, divided by the number of valid pixels: so fields of view and
    scenes of different size can be compared.
    """
    renderer = Renderer(scene.camera, "sphere", config.rendering.low_pass, stop=1e-3)
    tracker = Tracker(scene.camera, renderer, config)
    tracker.reset(scene.T_wc)
    alignment = tracker.track(scene.image, scene.map).alignment
    assert alignment is not None
    scale = np.diag([scene.median_depth] * 3 + [1.0] * 3)
    pixels = int(np.count_nonzero(scene.camera.valid_mask()))
    return np.asarray(scale @ alignment.hessian @ scale / pixels)
