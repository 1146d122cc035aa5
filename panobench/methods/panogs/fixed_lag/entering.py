"""Depth of what has just entered a narrow view, swept over the frames that saw it enter.

A narrow view that turns is filled with new things long before later frames could tell their depth, and poses tracked on
guessed depth stay wrong when the guess is replaced. But most of what is new at a keyframe came in over the frames since
the last one: where some of these see it from far enough apart, its depth is known at once. Where they do not, nothing
is put into the map, unless too little of the view would be known.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.panogs.config import FixedLagOptions
from panobench.methods.panogs.fixed_lag.frame_buffer import FrameBuffer
from panobench.methods.panogs.fixed_lag.swept_depth import DepthSweep, SweptDepth
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.photometric.stereo import WorkingScale
from panobench.splat.gaussians import F32
from panobench.splat.render import Render
from panobench.types import Frame

#: Frames swept over, and how many of them must see a pixel.
FRAMES, SEEN_BY = 8, 3


class EnteringDepth:
    """Seeds a keyframe of a narrow view, and owns which Gaussians have a guessed depth."""

    def __init__(
        self,
        options: FixedLagOptions,
        buffer: FrameBuffer,
        depth_sweep: DepthSweep,
        mapper: Mapper,
        trajectory: AnchoredTrajectory,
    ) -> None:
        self.options, self.buffer, self.depth_sweep = options, buffer, depth_sweep
        self.mapper, self.trajectory = mapper, trajectory
        self.guessed = np.zeros(0, np.int32)  # ids

    def insert(self, frame: Frame, scene_depth: float) -> None:
        """Put what a keyframe sees new into the map, by swept depth where it is sure; and train the map on it.

        scene_depth: median depth of what the frame sees.
        """
        m = self.mapper
        view = View(frame.index, frame.image, self.trajectory[frame.index], visible=frame.mask)
        added, swept = 0, self._sweep(frame.index, scene_depth)
        if swept is not None:
            sure = self._sure(swept)
            self._drop_guessed(view, sure)
            added = m.insert_where(view, m.thin(self._render(view)), sure)
        render = self._render(view)
        if float(m.weights[m.thin(render)].sum()) > m.config.seeding.guess_share:
            first = m.map.next_id
            added += m.insert(view, render)
            self.guessed = np.concatenate([self.guessed, np.arange(first, m.map.next_id, dtype=np.int32)])
        m.plan_for_new(len(m.map) - added)
        m.optimiser.work_all()

    def _render(self, view: View) -> Render:
        return self.mapper.occluded.look(self.mapper.renderer, view.T_wc, sloped=True)

    def _sweep(self, index: int, scene_depth: float) -> SweptDepth | None:
        """The newest frame's depth over those before it; None if it hardly moved, or these are too few or too near."""
        frames = self.buffer.newest(FRAMES + 1)
        if len(frames) <= SEEN_BY or frames[-1].index != index:
            return None
        target, others = frames[-1], frames[:-1]
        T_fr = self.trajectory.relative(index, [f.index for f in others])
        return self.depth_sweep.sweep(target, others, T_fr, scene_depth)

    def _sure(self, swept: SweptDepth) -> F32:
        """Its depth (H, W) at the camera's size, NaN where too few frames see it, or from too near one another."""
        angle, count = parallax(self.buffer.sweep_scale, swept)
        seen = (angle >= self.options.parallax_min) & (count >= SEEN_BY)
        return self.depth_sweep.full_size(swept, seen)

    def _drop_guessed(self, view: View, sure: F32) -> None:
        """Drop guessed Gaussians that ``view`` sees where its depth is ``sure`` (H, W) by now."""
        m, camera = self.mapper, self.mapper.camera
        which = np.flatnonzero(np.isin(m.map.ids, self.guessed, assume_unique=True))
        self.guessed = m.map.ids[which]
        if not len(which):
            return
        T = invert_pose(view.T_wc)
        x, y, inside = _pixels(camera, m.map.gaussians.means[which].astype(np.float64) @ T[:3, :3].T + T[:3, 3])
        known = inside & np.isfinite(sure[y, x])
        gone = np.zeros(len(m.map), bool)
        gone[which[known]] = True
        m.map.drop(gone)


def parallax(scale: WorkingScale, swept: SweptDepth) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Largest angle (h, w), in radians, between the rays to a pixel's point from the reference and from a frame that
    sees it, and the number (h, w) of such frames.
    """
    h, w = swept.depth.shape
    points = (scale.rays * swept.depth[..., None]).reshape(-1, 3).astype(np.float64)
    length = np.linalg.norm(points, axis=1)
    largest, count = np.zeros(h * w), np.zeros(h * w, int)
    for T in swept.T_fr:
        turned = points @ T[:3, :3].T
        local = turned + T[:3, 3]
        x, y, inside = _pixels(scale.camera, local)
        seen = inside & scale.valid[y, x]
        cosine = np.sum(turned * local, axis=1) / np.maximum(length * np.linalg.norm(local, axis=1), 1e-9)
        largest = np.maximum(largest, np.where(seen, np.arccos(np.clip(cosine, -1, 1)), 0))
        count += seen
    return largest.reshape(h, w), count.reshape(h, w)


def _pixels(
    camera: Camera, points: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Columns and rows (N,) of the pixels that show points (N, 3) of the camera's frame, 0 where none does, and where
    one does.
    """
    pixels, valid = camera.project(points)
    x, y = np.floor(np.where(valid[:, None], pixels, -1)).astype(int).T
    inside = (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
    return np.where(inside, x, 0), np.where(inside, y, 0), inside
