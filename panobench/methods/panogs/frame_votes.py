"""The last frames vote on what the scene looks like somewhere: which of two surfaces would most of them show?

Twelve frames cannot tell somebody who stands in the view from the wall she stands before. But the wall was seen for
longer, and if it was not, it will be.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.photometric.stereo import WorkingScale
from panobench.types import Frame

#: Width of the images kept, and how many.
WIDTH, FRAMES = 128, 80
#: Largest mean difference of the colours (of 1) of the same thing.
ALIKE = 0.07


@dataclass(frozen=True)
class _Kept:
    """image (h, w, 3) uint8, softened; visible (h, w) where it shows the scene, None everywhere."""

    index: int
    image: NDArray[np.uint8]
    visible: NDArray[np.bool_] | None


class FrameVotes:
    """Keeps the last frames that may be mapped, small."""

    def __init__(self, camera: Camera, trajectory: AnchoredTrajectory) -> None:
        self.scale, self.trajectory = WorkingScale.of(camera, WIDTH), trajectory
        self._frames: deque[_Kept] = deque(maxlen=FRAMES)

    def add(self, frame: Frame) -> None:
        """A frame that was tracked."""
        if frame.mappable:
            visible = None if frame.mask is None else self.small(frame.mask.view(np.uint8)) > 0
            self._frames.append(_Kept(frame.index, self.soft(frame.image), visible))

    def soft(self, image: NDArray) -> NDArray:
        """An image (H, W, 3) at the size of those kept, without its finest detail."""
        size = self.scale.valid.shape[::-1]
        return np.asarray(cv2.GaussianBlur(cv2.resize(image, size, interpolation=cv2.INTER_AREA), (3, 3), 0.8))

    def small(self, image: NDArray) -> NDArray:
        """An image or mask (H, W) at that size, by the nearest pixel."""
        return np.asarray(cv2.resize(image, self.scale.valid.shape[::-1], interpolation=cv2.INTER_NEAREST))

    def count(
        self, T_wc: NDArray[np.float64], where: NDArray[np.bool_], depth: NDArray[np.float32], image: NDArray
    ) -> NDArray[np.int32]:
        """(n,): for each pixel ``where`` (h, w), how many frames show there what a view from ``T_wc`` does.

        depth, image (h, w[, 3]): of that view, radial and of 0..255.
        """
        distance = depth[where].astype(np.float64)
        known = np.isfinite(distance)
        rays = self.scale.rays[where].astype(np.float64)
        points = (rays * np.where(known, distance, 1.0)[:, None]) @ T_wc[:3, :3].T + T_wc[:3, 3]
        colour = image[where].astype(np.float32)
        votes = np.zeros(len(points), np.int32)
        h, w = where.shape
        for kept in self._frames:
            T = self.trajectory.get(kept.index)
            if T is None:
                continue
            T_cw = invert_pose(T)
            pixels, inside = self.scale.camera.project(points @ T_cw[:3, :3].T + T_cw[:3, 3])
            pixels = np.nan_to_num(pixels)
            x, y = pixels[:, 0].astype(np.intp) % w, np.clip(pixels[:, 1].astype(np.intp), 0, h - 1)
            alike = np.abs(kept.image[y, x] - colour).mean(axis=1) < 255 * ALIKE
            if kept.visible is not None:
                alike &= kept.visible[y, x]
            votes += alike & inside & known
        return votes
