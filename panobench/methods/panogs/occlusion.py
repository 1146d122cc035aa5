"""What a view makes no use of, so that its next steps need not draw it: Gaussians behind walls, under others, faded.

In a map of several rooms that is every second one, and a step costs what its Gaussians cost. A tile does not end at a
wall by itself: between the wall's Gaussians a little light always passes.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

#: Steps that are taken on what one full render has found before there is another.
STEPS = 8


@dataclass
class Occlusion:
    """One view's Gaussians without use, by their serial numbers; those that came later are not among them."""

    unused: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))
    steps: int = 0

    def hidden(self, serial: NDArray[np.int32]) -> NDArray[np.bool_] | None:
        """(N,): which of the Gaussians ``serial`` (N,) the next step leaves out; None: draw all and ``note`` them."""
        if self.steps == 0:
            return None
        self.steps -= 1
        unused = np.unpackbits(self.unused).view(bool)
        return np.asarray(unused[np.minimum(serial, len(unused) - 1)])

    def note(self, serial: NDArray[np.int32], weights: NDArray[np.float32], least: float) -> None:
        """Of all Gaussians the pixels each makes up in the view (Render.weights); below ``least`` it has no use.

        What is as faint as to make up a hundredth of a pixel still has: its gradient lets it grow into a use.
        """
        unused = np.zeros(int(serial.max(initial=-1)) + 2, bool)  # the last stands for all that come later
        unused[serial] = weights < least
        self.unused = np.packbits(unused)
        self.steps = STEPS
