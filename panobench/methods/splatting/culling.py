"""Visibility culling: a view's training steps leave out the Gaussians that contribute nothing to it.

Gaussians behind walls, under others or faded are every second one in a map of several rooms, and a step costs what
its Gaussians cost. Tiles do not end at a wall by themselves: between the wall's Gaussians a little light always
passes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

#: Steps that rely on one full render before the next full render.
STEPS = 8


@dataclass
class VisibilityCulling:
    """The Gaussians that one view can leave out, by id. Gaussians with later ids are never among them."""

    unused: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))
    steps: int = 0

    def hidden(self, ids: NDArray[np.int32]) -> NDArray[np.bool_] | None:
        """(N,): which Gaussians, given their ids (N,), the next step leaves out.

        None means that the next step must draw all of them and call ``update``.
        """
        if self.steps == 0:
            return None
        self.steps -= 1
        return self.unused_of(ids)

    def unused_of(self, ids: NDArray[np.int32]) -> NDArray[np.bool_] | None:
        """(N,): which Gaussians the last full render did not use, given their ids (N,); None without one."""
        if not len(self.unused):
            return None
        unused = np.unpackbits(self.unused).view(bool)
        return np.asarray(unused[np.minimum(ids, len(unused) - 1)])

    def update(self, ids: NDArray[np.int32], weights: NDArray[np.float32], least: float) -> None:
        """Mark the Gaussians whose summed blending weight (N,), in pixels, is below ``least`` in a full render.

        ``least`` should be small: even a hundredth of a pixel gives a Gaussian the gradient it needs to grow.
        """
        unused = np.zeros(int(ids.max(initial=-1)) + 2, bool)  # the last entry stands for all later ids
        unused[ids] = weights < least
        self.unused = np.packbits(unused)
        self.steps = STEPS
