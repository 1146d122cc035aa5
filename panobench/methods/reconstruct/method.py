"""``reconstruct``: a Gaussian map from images with given poses, the setting of offline panoramic reconstruction.

As ODGS (Lee et al., NeurIPS 2024) and OmniGS (Li et al., WACV 2025) do for panoramas, with differences: depth to start
from is swept from the images instead of a point cloud from structure from motion, and any camera the renderer takes
will do. Poses are the data's ground truth or a trajectory file, and stay as they are.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_io import read_tum
from panobench.datasets.files.trajectory_match import match_to_times
from panobench.errors import InputError, UnsupportedError
from panobench.methods.base import BatchMethod, MethodContext
from panobench.methods.reconstruct.config import ReconstructConfig
from panobench.methods.splatting.densify import grow, prune
from panobench.methods.splatting.seeding import equal_area_pixels, fill_depth, seed_gaussians
from panobench.methods.splatting.sweeping import DepthSweeper
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.trainer import GaussianTrainer, PosedImage
from panobench.splat.adam import LearningRates
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer
from panobench.types import DepthEstimate, Estimate, Trajectory

Array = NDArray[np.float64]

#: Depth assumed when the images show no parallax.
WITHOUT_PARALLAX = 2.0


class ReconstructMethod(BatchMethod):
    """Sweeps depth at frames that see something new, seeds Gaussians there, and fits them to all frames."""

    config: ReconstructConfig

    def __init__(self, config: ReconstructConfig | None = None) -> None:
        super().__init__(config or ReconstructConfig())
        self.trainer: GaussianTrainer | None = None

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """Raises UnsupportedError without poses, InputError when the trajectory file fits no frame."""
        poses = self._poses(sequence, context)
        camera = sequence.camera
        self.rng = np.random.default_rng(context.seed)
        views = self._load(sequence, poses, camera)
        indices = sorted(poses)
        trajectory = Trajectory(
            np.array([sequence.times[i] for i in indices]), np.array([poses[i] for i in indices]).reshape(-1, 4, 4)
        )
        if not views:
            return Estimate(trajectory)
        c = self.config
        self.trainer = GaussianTrainer(
            Renderer(camera, "sphere", c.low_pass), TrainableMap(beta2=0.99), knee=c.loss_knee
        )
        seeds, first, z = self._seed(self.trainer, camera, views, context)
        loss = self._fit(self.trainer, camera, views, z)
        context.log(f"{len(views)} frames, {len(seeds)} seeds, {len(self.trainer.map)} Gaussians, loss {loss:.4f}")
        return Estimate(
            trajectory,
            keyframes=seeds,
            metric=not c.trajectory,
            map=self.trainer.gaussians if len(self.trainer.map) else None,
            depth=first,
            extra={
                "gaussians": len(self.trainer.map),
                "views": len(views),
                "loss": loss,
                "trajectory": bool(c.trajectory),
            },
        )

    # -- input -------------------------------------------------------------------------------------------------

    def _poses(self, sequence: FrameSequence, context: MethodContext) -> dict[int, Array]:
        """Camera-to-world poses by frame index."""
        if self.config.trajectory:
            path = Path(self.config.trajectory)
            if not path.is_file():
                raise InputError(f"trajectory={path}: no such file; name a TUM file with camera-to-world poses")
            found = match_to_times(read_tum(path), sequence.times, self.config.max_time_difference)
            if not len(found):
                raise InputError(
                    f"{path}: no pose within {self.config.max_time_difference:g} s of a frame; "
                    "check its times or set max_time_difference"
                )
            return {int(i): T for i, T in zip(np.searchsorted(sequence.times, found.times), found.T_wc)}
        if context.poses is None:
            raise UnsupportedError("reconstruct needs poses: data with ground truth, or --set trajectory=FILE")
        return {i: T for i, T in context.poses.items() if 0 <= i < len(sequence)}

    def _load(self, sequence: FrameSequence, poses: dict[int, Array], camera: Camera) -> list[PosedImage]:
        weights = pixel_weights(camera)
        wanted = sorted(poses)
        if len(wanted) > self.config.views:
            wanted = [wanted[k] for k in np.linspace(0, len(wanted) - 1, self.config.views).round().astype(int)]
        chosen, out = set(wanted), []
        for frame in sequence.frames():
            if frame.index in chosen and frame.mappable:
                out.append(PosedImage(frame.index, frame.image, poses[frame.index], weights))
        return out

    # -- the map -----------------------------------------------------------------------------------------------

    def _seed(
        self, trainer: GaussianTrainer, camera: Camera, views: list[PosedImage], context: MethodContext
    ) -> tuple[list[int], DepthEstimate, float]:
        """Gaussians where views see something no Gaussian covers yet. Returns their frames, the first depth and its
        median."""
        c = self.config
        sweeper = DepthSweeper(camera, c.sweep_width, c.sweep_views)
        for view in views:
            sweeper.add(view.image, view.T_wc)
        valid = camera.valid_mask()
        count = max(int(np.count_nonzero(valid) / c.pixels_per_gaussian), 16)
        spacing = float(np.sqrt(camera.solid_angle().sum() / count))
        seeds: list[int] = []
        first: DepthEstimate | None = None
        tried = np.unique(np.linspace(0, len(views) - 1, min(c.seeds, len(views))).round().astype(int))
        for k in tried:
            view = views[k]
            unknown = valid
            if len(trainer.map):
                unknown = valid & (trainer.renderer.forward(trainer.gaussians, view.T_wc).opacity < 0.5)
                if np.count_nonzero(unknown) < c.new_share * np.count_nonzero(valid):
                    continue
            depth = sweeper.depth(int(k))
            if depth is None:
                if first is not None:
                    continue
                depth = np.where(valid, WITHOUT_PARALLAX, np.nan).astype(np.float32)
                context.log(f"frame {view.index}: no parallax, depth {WITHOUT_PARALLAX:g} everywhere")
            depth = fill_depth(depth, camera.kind == "erp")
            if first is None:
                first = DepthEstimate(
                    np.where(valid, depth, np.nan).astype(np.float32), view.index, metric=not c.trajectory
                )
            pixels = equal_area_pixels(camera, count, self.rng)
            column = np.clip(pixels[:, 0].astype(int), 0, camera.width - 1)
            row = np.clip(pixels[:, 1].astype(int), 0, camera.height - 1)
            trainer.map.append(self._gaussians(camera, view, depth, pixels[unknown[row, column]], spacing), len(seeds))
            seeds.append(view.index)
        assert first is not None  # the first view always becomes one
        z = float(np.nanmedian(first.depth))
        trainer.scale_bounds = (1e-4 * z, 0.5 * z)
        return seeds, first, z

    def _gaussians(self, camera: Camera, view: PosedImage, depth: F32, pixels: Array, spacing: float) -> GaussianMap:
        c = self.config
        return seed_gaussians(
            camera, view.image, depth, pixels, view.T_wc, spacing,
            flatten=c.flatten, scale_factor=c.scale_factor, opacity=c.initial_opacity,
        )  # fmt: skip

    def _fit(self, trainer: GaussianTrainer, camera: Camera, views: list[PosedImage], z: float) -> float:
        """Returns the mean loss of the last pass."""
        c = self.config
        most = int(c.most_per_pixel * np.count_nonzero(camera.valid_mask()))
        losses: list[float] = []
        for number in range(c.passes):
            for done, k in enumerate(self.rng.permutation(len(views))):
                decay = c.decay ** ((number + done / len(views)) / c.passes)
                rates = LearningRates(
                    c.position_rate_rel * z * decay,
                    c.scale_rate * decay,
                    c.rotation_rate * decay,
                    c.opacity_rate * decay,
                    c.colour_rate * decay,
                )
                losses.append(trainer.step([views[k]], rates)[0].loss)
            if c.densify_every and (number + 1) % c.densify_every == 0 and number < c.densify_until * c.passes:
                grow(trainer.map, c.pull, 0.01 * z, self.rng, most)
                prune(trainer.map, c.prune_opacity, c.largest_rel * z)
        prune(trainer.map, c.prune_opacity, c.largest_rel * z)
        return float(np.mean(losses[-len(views) :])) if losses else float("nan")

    def render(self, camera: Camera, T_wc: Array) -> F32 | None:
        """As ``BatchMethod.render``."""
        if self.trainer is None or not len(self.trainer.map):
            return None
        renderer = Renderer(camera, "sphere", self.config.low_pass)
        return np.ascontiguousarray(np.clip(renderer.forward(self.trainer.gaussians, T_wc).colour, 0.0, 1.0))
