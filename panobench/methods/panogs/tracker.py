"""The front-end: the pose of a frame against the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose, renormalise
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.views import PoseAdam
from panobench.photometric.align import Alignment, AlignOptions, align, make_reference
from panobench.photometric.pyramid import F32, luma_of_frame, luma_of_planes, pyramid
from panobench.splat.gaussians import GaussianMap
from panobench.splat.loss import photometric_loss, pixel_weights
from panobench.splat.render import Renderer, RenderOutput

#: Pixels with less opacity have no trustworthy depth.
OPACITY_MIN = 0.9


@dataclass
class Tracked:
    """T_wc (4, 4), the last render, mean robust cost, iterations and whether the result can be trusted."""

    T_wc: NDArray[np.float64]
    render: RenderOutput
    cost: float
    iterations: int
    good: bool
    alignment: Alignment | None = None


class Tracker:
    """Renders the map at the predicted pose and aligns the frame to it; re-renders once and refines."""

    def __init__(self, camera: Camera, renderer: Renderer, config: PanogsConfig) -> None:
        self.camera, self.renderer, self.config = camera, renderer, config
        self.valid = camera.valid_mask()
        self.weights = pixel_weights(camera, config.loss)
        self.options = AlignOptions(exposure=config.exposure)
        self.T_last: NDArray[np.float64] | None = None
        self.velocity = np.eye(4)
        self.costs: list[float] = []
        self.pyramid: list[F32] = []

    def reset(self, T_wc: NDArray[np.float64], velocity: NDArray[np.float64] | None = None) -> None:
        """Restart from a known pose; ``velocity`` is T_last^-1 T_next, identity if unknown."""
        self.T_last = T_wc
        self.velocity = np.eye(4) if velocity is None else velocity

    def predict(self) -> NDArray[np.float64]:
        """Constant velocity. Composed poses drift off SO(3), hence the renormalisation."""
        assert self.T_last is not None
        return renormalise(self.T_last @ self.velocity)

    def frame_pyramid(self, image: NDArray[np.uint8]) -> list[F32]:
        return pyramid(luma_of_frame(image, self.valid))

    def track(self, image: NDArray[np.uint8], gaussians: GaussianMap) -> Tracked:
        """Pose of ``image`` near the prediction."""
        start = self.predict()
        self.pyramid = self.frame_pyramid(image)
        if self.config.solver == "adam":
            result = self._track_adam(image, gaussians, start)
        else:
            result = self.align_to_map(self.pyramid, gaussians, start)
        self.costs.append(result.cost)
        self.velocity = invert_pose(self.T_last) @ result.T_wc  # type: ignore[arg-type]
        self.T_last = result.T_wc
        return result

    def align_to_map(self, frame: list[F32], gaussians: GaussianMap, T_wc: NDArray[np.float64]) -> Tracked:
        """Gauss-Newton from ``T_wc``: coarse to fine on the first render, the finest levels on the later ones."""
        T, iterations = T_wc, 0
        renders = max(self.config.tracking_renders, 1)
        for k in range(renders):
            render = self.renderer.forward(gaussians, T, count_touched=k == renders - 1)
            luma = luma_of_planes(render.planes)
            reference = make_reference(self.camera, luma, render.expected_depth(OPACITY_MIN), len(frame), self.options)
            a = align(reference, frame, np.eye(4), self.options, coarsest=None if k == 0 else 1)
            T = renormalise(T @ invert_pose(a.T_fr))
            iterations += a.iterations
        return Tracked(T, render, a.cost, iterations, bool(np.isfinite(a.cost)) and a.overlap > 0.5, a)

    def _track_adam(self, image: NDArray[np.uint8], gaussians: GaussianMap, T_wc: NDArray[np.float64]) -> Tracked:
        """The paper's solver: Adam on the pose through the renderer's gradient."""
        T_cw, adam = invert_pose(T_wc), PoseAdam()
        best, best_T = np.inf, T_cw
        for _ in range(self.config.tracking_iterations):
            out = self.renderer.forward(gaussians, invert_pose(T_cw))
            loss, gradient, _ = photometric_loss(out.planes, image, self.weights)
            if loss < best:
                best, best_T = loss, T_cw
            T_cw = adam.step(T_cw, self.renderer.backward(gradient, planar=True).pose, (0.001, 0.003))
        T = invert_pose(best_T)
        render = self.renderer.forward(gaussians, T, count_touched=True)
        return Tracked(T, render, best, self.config.tracking_iterations, bool(np.isfinite(best)))
