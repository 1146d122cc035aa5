"""Rotation-only alignment: how the camera rotated between two frames, from their smallest images alone.

Small blurred images are aligned by a rotation (Klein & Murray, "Improving the agility of keyframe-based SLAM", ECCV
2008). It serves as a guess where no motion model predicts the pose. Several yaw angles are tried as starts, because a
single start converges from a few pixels away only.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.photometric.align import align, mean_cost
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import AlignOptions, make_reference
from panobench.photometric.stereo import WorkingScale

#: Yaw angles (about the camera's y axis) that are tried as starts.
STARTS_DEG = (0.0, 12.0, -12.0, 24.0, -24.0)
#: Standard deviation of the blur of the small images, pixels.
BLUR_PX = 1.0
#: Huber threshold (residual of 1) under which starts are compared.
HUBER = 0.05
#: Least share of the reference that must be seen again.
OVERLAP_MIN = 0.4

_OPTIONS = AlignOptions(iterations=(15,), cut_levels=0, exposure=True, rotation_only=True)


class RotationOnlyAligner:
    """Aligns the smallest levels of two pyramids of one camera. levels: how many levels a pyramid has."""

    def __init__(self, camera: Camera, levels: int) -> None:
        self.scale = WorkingScale.of(camera, camera.width >> (levels - 1))
        self.level = self.scale.level

    def rotation(self, before: list[F32], after: list[F32]) -> NDArray[np.float64] | None:
        """T (4, 4) without translation, from the camera ``before`` to that ``after``; None if nothing fits.

        before, after: luma pyramids, level 0 full size.
        """
        first, second = _blurred(before[self.level]), _blurred(after[self.level])
        depth = np.where(self.scale.valid, np.float32(1), np.float32(np.nan))
        reference = make_reference(self.scale.camera, first, depth, 1, _OPTIONS)
        if len(reference.levels[0].value) < 50:
            return None
        best, best_cost = None, np.inf
        for angle in np.deg2rad(STARTS_DEG):
            T = np.eye(4)
            T[0, 0], T[0, 2], T[2, 0], T[2, 2] = np.cos(angle), np.sin(angle), -np.sin(angle), np.cos(angle)
            found = align(reference, [second], T, _OPTIONS)
            cost, seen = mean_cost(reference, [second], found, HUBER)
            if cost < best_cost and seen >= OVERLAP_MIN:
                best, best_cost = found.T_fr, cost
        return best


def _blurred(image: F32) -> F32:
    """Gaussian blur of (H, W) that leaves NaN out of every average and keeps it where it is."""
    known = np.isfinite(image)
    total = cv2.GaussianBlur(np.where(known, image, 0).astype(np.float32), (0, 0), BLUR_PX)
    weight = cv2.GaussianBlur(known.astype(np.float32), (0, 0), BLUR_PX)
    return np.where(known, total / np.maximum(weight, 1e-6), np.nan).astype(np.float32)
