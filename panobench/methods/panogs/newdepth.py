"""Depth of newly seen regions from the frames that followed: a plane sweep over the last tracked frames.

What a frame is the first to see, no earlier frame shows: sweeping over those before it, or on both sides, is off by
tens of percent there. So the frame that receives depth lies some frames back, and only later ones are swept.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import SweepOptions, WorkingScale, multi_view_depth, resize_panorama

#: Working width of the sweep.
SWEEP_WIDTH = 256
#: A frame is remembered if it moved this far from the last remembered one, over the scene's depth.
STEP_MIN = 0.008
#: Sweeping needs at least this translation over the median depth.
PARALLAX_MIN = 0.03


@dataclass
class Remembered:
    """A tracked frame: its number, image and luma at the sweep's size."""

    index: int
    image: NDArray[np.uint8]
    luma: F32


class RecentFrames:
    """The last frames that moved, and the plane sweep over them."""

    def __init__(self, camera: Camera, size: int) -> None:
        self.camera = camera
        self.scale = WorkingScale.of(camera, SWEEP_WIDTH)
        self._frames: deque[Remembered] = deque(maxlen=2 * size)
        self._last = np.full(3, np.inf)

    def add(
        self, index: int, image: NDArray[np.uint8], pyramid: list[F32], position: NDArray[np.float64], depth: float
    ) -> None:
        """Remember a tracked frame unless it hardly moved; ``depth``: the scene's, in the unit of ``position``."""
        if np.linalg.norm(position - self._last) < STEP_MIN * depth:
            return
        self._last = position
        self._frames.append(Remembered(index, image, pyramid[min(self.scale.level, len(pyramid) - 1)]))

    def delayed(self, delay: int) -> Remembered | None:
        """The frame ``delay`` frames before the newest; None while there are too few."""
        return self._frames[-1 - delay] if len(self._frames) >= max(delay + 3, 4) else None

    def sweep(
        self,
        target: Remembered,
        pose: Callable[[int], NDArray[np.float64]],
        near: float,
        far: float,
        depth: float,
        confidence_min: float,
    ) -> F32 | None:
        """Radial depth (H, W) of ``target`` in the map's unit, or None without enough parallax.

        pose: frame number -> T_wc; near, far: range; depth: the scene's median. NaN where the confidence is below
        ``confidence_min``: better left for a later frame.
        """
        frames = list(self._frames)
        others = frames[next(i for i, f in enumerate(frames) if f is target) + 1 :]
        T_wc = pose(target.index)
        T_fr = np.stack([invert_pose(pose(f.index)) @ T_wc for f in others])
        if np.linalg.norm(T_fr[:, :3, 3], axis=1).max() < PARALLAX_MIN * depth:
            return None
        if target.luma.shape != self.scale.valid.shape:
            return None
        images = np.stack([f.luma for f in others])
        swept, confidence = multi_view_depth(target.luma, self.scale, images, T_fr, near, far, SweepOptions())
        swept = np.where(confidence >= confidence_min, swept, np.float32(np.nan))
        return resize_panorama(swept, (self.camera.height, self.camera.width), self.camera.kind == "erp")
