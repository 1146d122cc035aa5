"""While a method works OpenBLAS does not keep a core busy; afterwards it has its threads again."""

from __future__ import annotations

import time

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from panobench.bench.run.blas import one_blas_thread


def threads() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["internal_api"] == "openblas"]


def test_one_thread_within_and_as_many_as_before_after() -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    import scipy.linalg  # noqa: F401  # as within, which loads it

    before = threads()
    if not before:
        pytest.skip("NumPy does not use OpenBLAS here")
    time.sleep(0.3)  # threads that earlier tests have woken
    with one_blas_thread():
        assert threads() == [1] * len(before)
        np.ones((600, 600)) @ np.ones((600, 600))
        cpu = time.process_time()
        time.sleep(0.05)
        assert time.process_time() - cpu < 0.025
    assert threads() == before
