"""A block of Gaussians side by side: parameter i of the Gaussian in slot j is at buf[j + P[i]].

Kernels work on blocks because a loop over slots is vectorised; over the map's arrays, a row per Gaussian, it is not.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from panobench.splat.kernel_options import INLINE

#: Gaussians in a block.
BLOCK = 64
#: Parameters of a Gaussian: mean 0-2, log_scales 3-5, quat 6-9, opacity_logit 10, colour 11-13.
PARAMETERS = 14


def channels(first: int, count: int) -> tuple[np.uint64, ...]:
    """Offsets of ``count`` channels in a block's buffer after ``first`` others. Unsigned: no check for a negative."""
    return tuple(np.uint64(BLOCK * (first + k)) for k in range(count))


#: Offsets of the parameters.
P = channels(0, PARAMETERS)


@njit(**INLINE)
def load_parameters(buf, j, k, means, log_scales, quats, logits, colours):  # type: ignore[no-untyped-def]
    """Parameters of Gaussian k into slot j."""
    for i in range(3):
        buf[j + P[i]], buf[j + P[3 + i]], buf[j + P[11 + i]] = means[k, i], log_scales[k, i], colours[k, i]
    for i in range(4):
        buf[j + P[6 + i]] = quats[k, i]
    buf[j + P[10]] = logits[k]
