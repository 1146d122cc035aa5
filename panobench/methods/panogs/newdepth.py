"""Depth of a new keyframe from the frames just tracked, for regions the map does not know yet."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import SweepOptions, WorkingScale, multi_view_depth, resize_panorama

#: Working width of the sweep.
SWEEP_WIDTH = 256
#: Sweeping needs at least this translation over the median depth.
PARALLAX_MIN = 0.03


class RecentFrames:
    """The last tracked frames, and the plane sweep over them."""

    def __init__(self, camera: Camera, size: int) -> None:
        self.camera = camera
        self.scale = WorkingScale.of(camera, SWEEP_WIDTH)
        self._frames: deque[tuple[F32, NDArray[np.float64]]] = deque(maxlen=2 * size)

    def add(self, pyramid: list[F32], T_wc: NDArray[np.float64]) -> None:
        """Remember a tracked frame by its luma pyramid and pose."""
        self._frames.append((pyramid[min(self.scale.level, len(pyramid) - 1)], T_wc))

    def sweep(self, near: float, far: float, median_depth: float) -> F32 | None:
        """Depth (H, W) of the newest frame in the map's unit, or None without enough parallax."""
        if len(self._frames) < 4:
            return None
        luma, T_wc = self._frames[-1]
        others = list(self._frames)[:-1][::2] if len(self._frames) > 8 else list(self._frames)[:-1]
        T_fr = np.stack([invert_pose(T) @ T_wc for _, T in others])
        if np.linalg.norm(T_fr[:, :3, 3], axis=1).max() < PARALLAX_MIN * median_depth:
            return None
        images = np.stack([image for image, _ in others])
        if images.shape[1:] != luma.shape or luma.shape != self.scale.valid.shape:
            return None
        depth, _ = multi_view_depth(luma, self.scale, images, T_fr, near, far, SweepOptions())
        return resize_panorama(depth, (self.camera.height, self.camera.width), self.camera.kind == "erp")
