"""The depth that a bundle-adjustment factor starts from, where a mask hides part of a wide view.

A factor leaves out the pixels that fit worst and takes few steps, so it keeps what is wrong with the depth it is given.
The map's depth at a reference may be that of the very first estimate, from few frames whose poses were not yet known
well, and with a mask there is little else to outvote it. The frames that the factor compares, up to a second before and
after, tell the depth better.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.fixed_lag.frame_buffer import SWEEP_WIDTH
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale, multi_view_depth, resize_panorama

#: So many frames are swept over, at most.
FRAMES = 12
#: Fewer frames tell less than the map does.
FEWEST = 6
#: What is swept begins before the nearest depth known and goes beyond the farthest.
NEARER, FARTHER = 0.7, 1.2


class FactorDepth:
    """Sweeps the depth of references at most ``SWEEP_WIDTH`` pixels wide. scale: that of the factors' images."""

    def __init__(self, scale: WorkingScale) -> None:
        self.scale, self.small = scale, WorkingScale.of(scale.camera, SWEEP_WIDTH)

    def sweep(self, luma: F32, images: list[F32], T_fr: NDArray[np.float64], known: F32) -> F32:
        """Radial depth (h, w) of the image ``luma`` (h, w) from others with the poses T_fr (F, 4, 4); 0 where unknown.

        known (h, w): the map's, 0 where unknown; it comes back where there is too little to sweep.
        """
        if len(images) < FEWEST or not (known > 0).any():
            return known
        chosen = np.unique(np.linspace(0, len(images) - 1, min(len(images), FRAMES)).round().astype(int))
        nearest, farthest = np.quantile(known[known > 0], (0.001, 1.0))
        others = np.stack([self.small.halved(images[n]) for n in chosen])
        near, far = NEARER * float(nearest), FARTHER * float(farthest)
        swept, _ = multi_view_depth(self.small.halved(luma), self.small, others, T_fr[chosen], near, far)
        full = resize_panorama(swept, known.shape, self.small.camera.kind == "erp")
        return np.where(self.scale.valid & np.isfinite(full), full, 0).astype(np.float32)
