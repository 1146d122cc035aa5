"""Columns of arrays and channels of blocks by name: each has its own place, and kernels read what was put there."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numba import njit

from panobench.kernels import columns
from panobench.kernels.block import BLOCK, P, load3, load4, load_parameters, offsets, store3, store4
from panobench.kernels.jit import JIT


def flat(value: Any) -> Iterator[int]:
    for part in value:
        yield from flat(part) if isinstance(part, tuple) else [int(part)]


@pytest.mark.parametrize(
    ("names", "count"),
    [
        (columns.PARAMETER, columns.PARAMETERS),
        (columns.FOOTPRINT, columns.FOOTPRINT_COLUMNS),
        (columns.MOMENT, columns.MOMENTS),
        (columns.CAM, 8),
    ],
)
def test_every_column_has_one_name(names: Any, count: int) -> None:
    assert list(flat(names)) == list(range(count))


def test_channels_of_a_block_do_not_overlap() -> None:
    first, second = offsets(columns.PARAMETER, 0), offsets(columns.MOMENT, columns.PARAMETERS)
    starts = [*flat(first), *flat(second)]
    assert starts == [BLOCK * k for k in range(columns.PARAMETERS + columns.MOMENTS)]
    assert type(second) is columns.MomentColumns


def test_a_span_is_the_slice_of_its_columns() -> None:
    row = np.arange(columns.PARAMETERS)
    assert row[columns.span(columns.PARAMETER.quat)].tolist() == [6, 7, 8, 9]


@njit(**{**JIT, "cache": False})
def _doubled(buf, j, means, log_scales, quats, logits, colours):  # type: ignore[no-untyped-def]
    load_parameters(buf, j, 1, means, log_scales, quats, logits, colours)
    x, y, z = load3(buf, j, P.mean)
    store3(buf, j, P.mean, (2 * x, 2 * y, 2 * z))
    a, b, c, d = load4(buf, j, P.quat)
    store4(buf, j, P.quat, (2 * a, 2 * b, 2 * c, 2 * d))


def test_a_kernel_finds_a_parameter_by_its_name() -> None:
    rng = np.random.default_rng(0)
    shapes = ((2, 3), (2, 3), (2, 4), (2,), (2, 3))
    means, log_scales, quats, logits, colours = (rng.normal(size=s).astype(np.float32) for s in shapes)
    buf = np.zeros(columns.PARAMETERS * BLOCK, np.float32)
    _doubled(buf, np.uint64(5), means, log_scales, quats, logits, colours)
    want = [*(2 * means[1]), *log_scales[1], *(2 * quats[1]), logits[1], *colours[1]]
    np.testing.assert_array_equal(buf.reshape(-1, BLOCK)[:, 5], want)
    assert np.count_nonzero(buf) == columns.PARAMETERS
