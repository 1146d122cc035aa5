"""Tracking: the pose of a frame, by aligning it to renders of the map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, renormalise
from panobench.inertial.rotation_prior import RotationPrior
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.trajectory import WorldMotion
from panobench.methods.splatting.occlusion import OccludedMap
from panobench.methods.splatting.transients import Transients
from panobench.methods.splatting.views import PoseAdam
from panobench.photometric.align import Alignment, align
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pyramid import F32, luma_of_frame, luma_of_planes, pyramid
from panobench.photometric.reference import AlignOptions, Reference, make_reference, reject_moving
from panobench.photometric.weighting import reweighted
from panobench.splat.gaussians import GaussianMap
from panobench.splat.loss import photometric_loss, pixel_weights
from panobench.splat.render import Render, Renderer

#: Share of the view from which it is the pose that is wrong, and not the map.
MOST_CONTRADICTED = 0.6


@dataclass
class Tracked:
    """T_wc (4, 4), the last render, mean robust cost, iterations and whether the result can be trusted."""

    T_wc: NDArray[np.float64]
    render: Render
    cost: float
    iterations: int
    good: bool
    alignment: Alignment | None = None


class Tracker:
    """Renders the map at the predicted pose and aligns the frame to it; re-renders once and refines."""

    def __init__(self, camera: Camera, renderer: Renderer, config: PanogsConfig) -> None:
        self.camera, self.renderer, self.config, self.options = camera, renderer, config, config.tracking
        self.valid = camera.valid_mask()
        self.outside = ~self.valid
        self.weights = pixel_weights(camera, config.rendering.weights)
        pixels = None if ViewWidth.of(camera) is ViewWidth.NARROW else self.options.pixels
        fine = AlignOptions(
            exposure=self.options.exposure,
            gradient_min=self.options.gradient_min,
            step_m=6e-5,
            step_rad=3e-5,
            pixels=pixels,
        )
        fine = reject_moving(camera, fine)
        self.align_options, self.coarse_options = fine, replace(fine, step_m=6e-4, step_rad=3e-4)
        self.pixel = float(np.sqrt(np.median(camera.solid_angle()[self.valid])))
        self.transients: Transients | None = None
        self.occluded: OccludedMap | None = None
        self.hidden: NDArray[np.bool_] | None = None  # what contradicted the map in the last frame, if anything did
        self.reference: Reference | None = None
        self.T_reference = np.eye(4)
        self.T_last: NDArray[np.float64] | None = None
        self.velocity = np.eye(4)
        self.costs: list[float] = []
        self.image: NDArray[np.uint8] | None = None  # what was tracked last
        self.pyramid: list[F32] = []

    def reset(self, T_wc: NDArray[np.float64], velocity: NDArray[np.float64] | None = None) -> None:
        """Restart from a known pose; ``velocity`` is T_last^-1 T_next, identity if unknown."""
        self.T_last = T_wc
        self.velocity = np.eye(4) if velocity is None else velocity

    def restart(self, T_wc: NDArray[np.float64]) -> None:
        """As ``reset``, somewhere else than the last render."""
        self.reset(T_wc)
        self.reference = None

    def world_moved(self, motion: WorldMotion) -> None:
        """As ``WorldFollower.world_moved``."""
        self.T_reference = renormalise(motion.newest @ self.T_reference)
        if self.T_last is not None:
            self.T_last = renormalise(motion.newest @ self.T_last)

    def expect(self, T_wc: NDArray[np.float64]) -> None:
        """The next frame is expected at this pose."""
        if self.T_last is not None:
            self.velocity = invert_pose(self.T_last) @ T_wc

    def coast(self) -> None:
        """A frame that cannot be tracked: its motion is taken to be that of the frame before."""
        if self.T_last is not None:
            self.T_last = self.predict()

    def predict(self) -> NDArray[np.float64]:
        """Constant velocity. Composed poses drift off SO(3), hence the renormalisation."""
        assert self.T_last is not None
        return renormalise(self.T_last @ self.velocity)

    def frame_pyramid(self, image: NDArray[np.uint8], visible: NDArray[np.bool_] | None = None) -> list[F32]:
        """Luma of ``image`` (H, W, 3), NaN outside the view and where it does not show the scene (``visible``)."""
        return pyramid(luma_of_frame(image, self.valid if visible is None else self.valid & visible))

    def track(
        self,
        image: NDArray[np.uint8],
        gaussians: GaussianMap,
        visible: NDArray[np.bool_] | None = None,
        prior: RotationPrior | None = None,
    ) -> Tracked:
        """Pose of ``image`` near the prediction. prior: of the rotation of T_wc, which solver adam leaves out."""
        start = self.predict()
        self.image, self.pyramid = image, self.frame_pyramid(image, visible)
        if self.options.solver == "adam":
            result = self._track_adam(image, gaussians, start)
        else:
            seen = self.pyramid if self.hidden is None else self._without_hidden(image, visible)
            result = self.align_to_map(seen, gaussians, start, image, prior)
        self.costs.append(result.cost)
        self.velocity = invert_pose(self.T_last) @ result.T_wc  # type: ignore[arg-type]
        self.T_last = result.T_wc
        return result

    def align_to_map(
        self,
        frame: list[F32],
        gaussians: GaussianMap,
        T_wc: NDArray[np.float64],
        image: NDArray[np.uint8] | None = None,
        prior: RotationPrior | None = None,
    ) -> Tracked:
        """Gauss-Newton from ``T_wc``: the coarse levels against the last render, then a fresh render for the finest.

        Another render follows only if the frame turned out to be further than ``render_again_px`` from the last. image:
        of the frame, which is not aligned to where it contradicts the map. prior: of the rotation of T_wc.
        """
        T, iterations = T_wc, 0
        if self.reference is not None:
            start = invert_pose(T) @ self.T_reference
            held = None if prior is None else prior.seen_from(self.T_reference)
            a = align(
                self.reference, frame, start, self.coarse_options, finest=1, device=self.renderer.device, prior=held
            )
            T = renormalise(self.T_reference @ invert_pose(a.T_fr))
            iterations += a.iterations
        for k in range(max(self.options.renders, 1)):
            known = k > 0 or self.reference is not None
            render = self._draw(gaussians, T)
            self.reference, self.T_reference = self.make_reference(render, len(frame), image), T
            coarsest, device = 1 if known else None, self.renderer.device
            held = None if prior is None else prior.seen_from(T)
            a = align(
                self.reference, frame, np.eye(4), self.align_options, coarsest=coarsest, device=device, prior=held
            )
            T = renormalise(T @ invert_pose(a.T_fr))
            iterations += a.iterations
            if self.moved_px(a.T_fr, render) < self.options.render_again_px:
                break
        return Tracked(T, render, a.cost, iterations, bool(np.isfinite(a.cost)) and a.overlap > 0.5, a)

    def _draw(self, gaussians: GaussianMap, T_wc: NDArray[np.float64]) -> Render:
        if self.occluded is not None and gaussians is self.occluded.map.gaussians:
            return self.occluded.follow(self.renderer, T_wc)
        return self.renderer.forward(gaussians, T_wc, count_touched=True, sloped=True)

    def make_reference(self, render: Render, levels: int, image: NDArray[np.uint8] | None = None) -> Reference:
        # What is outside the field of view could only be looked for in vain, and would count as not found.
        depth, luma = render.expected_depth(self.options.opacity_min), luma_of_planes(render.planes)
        depth[self.outside] = luma[self.outside] = np.nan
        if image is not None and self.transients is not None and self.transients.active:
            contradicted = self.transients.contradicted(image, render)
            if float(self.weights[contradicted].sum()) < MOST_CONTRADICTED:
                depth[contradicted] = luma[contradicted] = np.nan
        reference = make_reference(self.camera, luma, depth, levels, self.align_options)
        return reweighted(reference, self.config.rendering.weights)

    def _without_hidden(self, image: NDArray[np.uint8], visible: NDArray[np.bool_] | None) -> list[F32]:
        """The frame's pyramid without what hid the map a frame ago: on coarse levels its border would mix in."""
        assert self.hidden is not None
        if float(self.weights[self.hidden].sum()) > MOST_CONTRADICTED:
            return self.pyramid
        return self.frame_pyramid(image, ~self.hidden if visible is None else visible & ~self.hidden)

    def moved_px(self, T: NDArray[np.float64], render: Render) -> float:
        """How far the motion ``T`` moves a pixel at the median depth, roughly."""
        depth = float(np.median(render.depth[self.valid]))
        return float(np.linalg.norm(T[:3, 3]) / max(depth, 1e-9) + np.linalg.norm(T[:3, :3] - np.eye(3))) / self.pixel

    def _track_adam(self, image: NDArray[np.uint8], gaussians: GaussianMap, T_wc: NDArray[np.float64]) -> Tracked:
        """The paper's solver: Adam on the pose through the renderer's gradient."""
        T_cw, adam = invert_pose(T_wc), PoseAdam()
        best, best_T = np.inf, T_cw
        for _ in range(self.options.iterations):
            out = self.renderer.forward(gaussians, invert_pose(T_cw))
            loss, gradient, _ = photometric_loss(out.planes, image, self.weights)
            if loss < best:
                best, best_T = loss, T_cw
            T_cw = adam.step(T_cw, out.backward(gradient, planar=True).pose, (0.001, 0.003))
        T = invert_pose(best_T)
        render = self.renderer.forward(gaussians, T, count_touched=True)
        return Tracked(T, render, best, self.options.iterations, bool(np.isfinite(best)))
