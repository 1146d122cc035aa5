"""How wide a camera's view is, and how much of what one pose sees another sees too."""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera

#: Rays tried, down and across.
GRID = (12, 24)
#: Solid angle, in steradians, below which a view is narrow.
NARROW_SR = 2 * np.pi


class ViewWidth(Enum):
    """A narrow view is soon filled by what enters it, and needs every pixel to tell rotation from translation."""

    NARROW = "narrow"
    WIDE = "wide"

    @classmethod
    def of(cls, camera: Camera, narrow_sr: float = NARROW_SR) -> ViewWidth:
        """By the solid angle of the camera's valid pixels; below ``narrow_sr`` steradians it is narrow."""
        steradians = float((camera.solid_angle() * camera.valid_mask()).sum())
        return cls.NARROW if steradians < narrow_sr else cls.WIDE


class ViewShare:
    """Shares of the view of a camera."""

    def __init__(self, camera: Camera) -> None:
        self.camera, self.valid = camera, camera.valid_mask()
        solid_angle = camera.solid_angle() * self.valid
        y, x = (max(n // k, 1) for n, k in zip(self.valid.shape, GRID))
        some = np.s_[y // 2 :: y, x // 2 :: x]
        self.rays, self.weights = camera.rays()[some][self.valid[some]], solid_angle[some][self.valid[some]]

    def of(self, T_fr: NDArray[np.float64], depth: float) -> float:
        """Share of the solid angle of the reference's view that the camera at ``T_fr`` (frame from reference
        camera) sees again, if everything is ``depth`` away.
        """
        if not len(self.rays):
            return 0.0
        pixels, valid = self.camera.project(depth * self.rays @ T_fr[:3, :3].T + T_fr[:3, 3])
        x, y = np.floor(np.where(valid[:, None], pixels, -1)).astype(int).T
        inside = (x >= 0) & (y >= 0) & (x < self.camera.width) & (y < self.camera.height)
        seen = inside & self.valid[np.where(inside, y, 0), np.where(inside, x, 0)]
        return float(self.weights[seen].sum() / self.weights.sum())
