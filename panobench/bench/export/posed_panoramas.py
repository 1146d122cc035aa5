"""Panoramas of a run with their poses and a depth, at first that of its map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.photometric.pyramid import halve, luma_of_frame, pyramid
from panobench.photometric.stereo import WorkingScale

if TYPE_CHECKING:
    from panobench.bench.run.views import ChosenFrames

Float = NDArray[np.float32]
Array = NDArray[np.float64]

#: Frames that one is compared with, and their distances from it over the scene's median depth.
OTHERS, NEAREST, FARTHEST = 7, 0.05, 0.7


@dataclass(frozen=True)
class PosedPanoramas:
    """luma (K, H, W), of 1, NaN where a frame has nothing; depth (K, H, W): radial, of the map, all finite; T_wc
    (K, 4, 4); scale: the camera of ``luma``.
    """

    luma: Float
    depth: Float
    T_wc: Array
    scale: WorkingScale

    def __len__(self) -> int:
        return len(self.luma)

    @cached_property
    def median_depth(self) -> float:
        return float(np.median(self.depth))

    def halved(self) -> PosedPanoramas | None:
        """The same at half the size; None where a side has an odd number of pixels."""
        height, width = self.luma.shape[1:]
        if height % 2 or width % 2:
            return None
        luma = np.stack([halve(luma) for luma in self.luma])
        return PosedPanoramas(luma, self.depth[:, ::2, ::2], self.T_wc, WorkingScale.of(self.scale.camera, width // 2))

    def others(self, k: int, most: int = OTHERS, nearest: float = NEAREST, farthest: float = FARTHEST) -> list[int]:
        """Views to compare view ``k`` with, spread over the useful baselines; none where the camera stood still.

        nearest, farthest: over the median depth.
        """
        baselines = np.linalg.norm(self.T_wc[:, :3, 3] - self.T_wc[k, :3, 3], axis=1) / self.median_depth
        useful = [j for j in np.argsort(baselines) if nearest < baselines[j] < farthest]
        if not useful:
            return []
        return [int(useful[i]) for i in np.unique(np.linspace(0, len(useful) - 1, most).round().astype(int))]

    def rays(self, k: int) -> Array:
        """Unit rays (H, W, 3) of view ``k`` in the world."""
        return np.asarray(self.scale.rays, np.float64) @ self.T_wc[k, :3, :3].T


def posed_panoramas(
    sequence: ChosenFrames, frames: list[int], T_wc: Array, depths: Float, widest: int
) -> PosedPanoramas:
    """Frames of a panoramic sequence beside depths (K, H, W) of any size; pixels without depth get the median.

    Frames that are wider than ``widest`` pixels are halved until they are not.
    """
    scale = WorkingScale.of(sequence.camera, widest)
    valid = sequence.camera.valid_mask()
    levels = (pyramid(luma_of_frame(sequence.image(i), valid), smallest_width=16) for i in frames)
    luma = np.stack([found[scale.level] for found in levels])
    size = luma.shape[2], luma.shape[1]
    small = np.stack([cv2.resize(d, size, interpolation=cv2.INTER_NEAREST) for d in depths])
    filled = np.where(np.isfinite(small), small, np.nanmedian(small)).astype(np.float32)
    return PosedPanoramas(luma, filled, T_wc, scale)
