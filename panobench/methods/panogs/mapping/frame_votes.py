"""The last frames vote on what the scene looks like somewhere: which of two surfaces would most of them show?

Twelve frames cannot tell somebody who stands in the view from the wall she stands before. But the wall was seen for
longer, and if it was not, it will be.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.photometric.stereo import WorkingScale
from panobench.splat.render import Render
from panobench.types import Frame

#: Width of the images kept, and how many.
WIDTH, FRAMES = 128, 80
#: Largest mean difference of the colours (of 1) of the same thing.
ALIKE = 0.07
#: Frames asked whether something has changed, and the fewest that can tell; the share that must have seen it as it was,
#: and the most that may have seen it as it is.
SAMPLE, FEWEST, OFTEN = 20, 6, 0.3
#: If the camera passed by further than this within the fewest frames, in depths, they cannot tell: a young map whose
#: depth is still wrong looked right from where it was made, and looks different a few steps on.
PASSED_DEPTHS = 0.25


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
        area = np.where(self.scale.valid, self.scale.camera.solid_angle(), 0.0)
        self._area = area / area.sum()

    def __len__(self) -> int:
        return len(self._frames)

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

    def moved(
        self, T_wc: NDArray[np.float64], render: Render, image: NDArray[np.uint8], where: NDArray[np.bool_]
    ) -> float:
        """Share of the view, within ``where`` (H, W), that frames have shown as the map has it, and now look different.

        Where the map is merely wrong they never did. render: from ``T_wc``; image (H, W, 3): seen from there.
        """
        every = max(len(self._frames) // SAMPLE, 1)
        count = len(range(0, len(self._frames), every))
        small = self.small(where.view(np.uint8)) > 0
        if count < FEWEST or not small.any():
            return 0.0
        depth, drawn = self.small(render.expected_depth(0.5)), self.soft(np.ascontiguousarray(255 * render.colour))
        if self._passed(T_wc, depth):
            return 0.0
        as_drawn = self.count(T_wc, small, depth, drawn, every)
        as_seen = self.count(T_wc, small, depth, self.soft(image), every)
        changed = (as_drawn > OFTEN * count) & (as_seen < OFTEN * count)
        return float(self._area[small][changed].sum())

    def _passed(self, T_wc: NDArray[np.float64], depth: NDArray[np.float32]) -> bool:
        """Whether the camera has come far within the last frames. depth (h, w): what it sees now."""
        before = self.trajectory.get(self._frames[-FEWEST].index)
        known = depth[np.isfinite(depth)]
        if before is None or not known.size:
            return False
        return float(np.linalg.norm(T_wc[:3, 3] - before[:3, 3])) > PASSED_DEPTHS * float(np.median(known))

    def count(
        self,
        T_wc: NDArray[np.float64],
        where: NDArray[np.bool_],
        depth: NDArray[np.float32],
        image: NDArray,
        every: int = 1,
    ) -> NDArray[np.int32]:
        """(n,): for each pixel ``where`` (h, w), how many frames show there what a view from ``T_wc`` does.

        depth, image (h, w[, 3]): of that view, radial and of 0..255. every: only one of so many frames is asked.
        """
        distance = depth[where].astype(np.float64)
        known = np.isfinite(distance)
        rays = self.scale.rays[where].astype(np.float64)
        points = (rays * np.where(known, distance, 1.0)[:, None]) @ T_wc[:3, :3].T + T_wc[:3, 3]
        colour = image[where].astype(np.float32)
        votes = np.zeros(len(points), np.int32)
        h, w = where.shape
        for kept in islice(self._frames, 0, None, every):
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
