"""One set of Numba options for all kernels."""

from __future__ import annotations

import os
from typing import Any

import numba

# Prefer OpenMP even where a machine happens to have TBB, whose workers also spin for a while after each kernel.
if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # type: ignore[attr-defined]

#: Kernels are cached on disk after the first compilation. Reassociation lets loops vectorise. NaN and infinity keep
#: their meaning, because maps and images from strangers contain them.
JIT: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "fastmath": {"reassoc", "contract", "nsz", "arcp", "afn"},
    "error_model": "numpy",
    "boundscheck": False,
}
PARALLEL: dict[str, Any] = {**JIT, "parallel": True}
#: For functions that inner loops call: a loop with a call left in it is not vectorised.
INLINE: dict[str, Any] = {**JIT, "forceinline": True}
#: For inner loops that only ever see finite numbers.
JIT_FINITE: dict[str, Any] = {**JIT, "fastmath": True}
INLINE_FINITE: dict[str, Any] = {**INLINE, "fastmath": True}
