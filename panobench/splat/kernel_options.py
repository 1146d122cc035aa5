"""One set of Numba options for all kernels, and the sizes they share."""

from __future__ import annotations

import os
from typing import Any

import numba

# OpenMP workers would otherwise spin between kernels for milliseconds: they burn a core while a method rests, and stall
# each other when several runs share a machine. Not spinning at all costs 60 us a kernel, which is what many kernels
# take; libgomp is therefore told to spin for about 0.2 ms. Read once, when the first parallel kernel loads the runtime.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
os.environ.setdefault("GOMP_SPINCOUNT", "5000")

# The same layer whether or not a machine happens to have TBB, whose workers spin for a while after each kernel.
if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # type: ignore[attr-defined]

#: Kernels are cached on disk after the first compilation. Reassociation lets loops vectorise; NaN and infinity keep
#: their meaning, since maps and images from strangers contain them.
JIT: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "fastmath": {"reassoc", "contract", "nsz", "arcp", "afn"},
    "error_model": "numpy",
    "boundscheck": False,
}
PARALLEL: dict[str, Any] = {**JIT, "parallel": True}
#: For what inner loops call: a call that is left is a loop that is not vectorised.
INLINE: dict[str, Any] = {**JIT, "forceinline": True}
#: For inner loops that only ever see finite numbers.
JIT_FINITE: dict[str, Any] = {**JIT, "fastmath": True}
INLINE_FINITE: dict[str, Any] = {**INLINE, "fastmath": True}

#: Tile size in pixels: one tile row is one AVX-512 or two AVX2 registers.
TILE_W = 16
TILE_H = 16

#: Columns of the packed instance array, see ``project``.
PACK = 20
#: Columns of the gradient moments, see ``blend_backward``.
MOMENTS = 12

ALPHA_MIN = 1.0 / 255.0
ALPHA_MAX = 0.99
#: cos of the largest angle between a Gaussian's direction and a pixel it may colour (about 84 deg).
COS_MIN = 0.1
