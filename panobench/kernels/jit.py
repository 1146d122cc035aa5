"""Numba's decorator and one set of options for all kernels.

Kernels take ``njit`` from here, and not from Numba, so that one that is in the cache is not loaded once it is stale,
and processes that fill the cache at once do not mix their kernels up.
"""

from __future__ import annotations

import os
from typing import Any

import numba
from numba import njit, prange

from panobench.kernels.cache_lock import guard_cache
from panobench.kernels.stamp import stamp_by_imports

# Prefer OpenMP even where a machine happens to have TBB, whose workers also spin for a while after each kernel.
if "NUMBA_THREADING_LAYER_PRIORITY" not in os.environ:
    numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # type: ignore[attr-defined]

guard_cache()
stamp_by_imports()
__all__ = ["INLINE", "INLINE_FINITE", "JIT", "JIT_FINITE", "PARALLEL", "njit", "prange"]

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
