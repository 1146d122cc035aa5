"""Keep NumPy's and SciPy's matrix products in one thread while a method works.

OpenBLAS's threads spin for a tenth of a second after a product, in case another follows. On two cores they take one
from whatever runs next, such as Numba's kernels, and count as work between the calls of ``track``.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """A context in which OpenBLAS works in the calling thread only; other libraries, torch's too, stay as they are."""
    import scipy.linalg  # noqa: F401  # brings an OpenBLAS of its own, and only what is loaded can be limited
    from threadpoolctl import ThreadpoolController

    with ThreadpoolController().select(internal_api="openblas").limit(limits=1):
        yield
