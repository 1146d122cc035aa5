"""NumPy's and SciPy's matrix products in one thread while a method works.

OpenBLAS's threads spin for a tenth of a second after a product, in case another follows. On two cores they take one
from whatever comes next, numba's kernels among it, and the time between calls of ``track`` looks like work.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Within, OpenBLAS works in the thread that calls it; other libraries (torch's among them) are left alone."""
    import scipy.linalg  # noqa: F401  # brings an OpenBLAS of its own, and only what is loaded can be limited
    from threadpoolctl import ThreadpoolController

    with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
        yield
