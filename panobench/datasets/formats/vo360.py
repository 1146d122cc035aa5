"""360VO: synthetic 360 sequences in SynPano's text layout, but in a left-handed frame.

Huang & Yeung, "360VO: Visual Odometry Using A Single 360 Camera" (ICRA 2022). World and camera axes are taken as
x right, y up, z forward (left-handed); mirroring y turns both into right-handed ones, and the camera's into
x right, y down, z forward: with S = diag(1, -1, 1), R = S R_left S and p = S p_left. Whichever axis is
mirrored, the trajectories differ by a rotation only, so position errors do not depend on that choice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.formats.synpano import SynPano

_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def left_to_right_handed(T_wc: NDArray[np.float64]) -> NDArray[np.float64]:
    """Poses (..., 4, 4) with y down instead of y up, for world and camera; x right and z forward stay."""
    return np.asarray(_MIRROR @ T_wc @ _MIRROR)


class Vo360(SynPano):
    """Sequences in SynPano's layout with mirrored axes."""

    name = "360vo"

    def axes(self, T_wc: NDArray[np.float64]) -> NDArray[np.float64]:
        return left_to_right_handed(T_wc)
