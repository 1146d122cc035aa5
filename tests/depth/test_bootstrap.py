"""Depth from the first frames alone, on the built-in rooms."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.depth.bootstrap import MEDIAN_DEPTH, BootstrapDepth
from panobench.depth.simple import ConstantDepth, OracleDepth
from panobench.errors import UnavailableError, UsageError
from panobench.types import Frame


@pytest.mark.slow
def test_bootstrap_finds_the_depth_of_a_room() -> None:
    sequence = RoomsDataset().open("tiny", width=256)
    estimator = BootstrapDepth()
    estimator.start(sequence.camera)
    estimate = None
    for frame in sequence.frames():
        estimate = estimator.add(frame)
        if estimate is not None:
            break
    assert estimate is not None
    assert estimate.ok
    truth = sequence.depth(estimate.frame_index)
    assert truth is not None
    ratio = estimate.depth / truth
    ratio /= np.nanmedian(ratio)
    assert np.nanmedian(np.abs(ratio - 1)) < 0.03
    assert np.nanmedian(estimate.depth) == pytest.approx(MEDIAN_DEPTH, rel=0.05)
    assert np.allclose(estimate.T_wc[estimate.frame_index], np.eye(4))


def test_one_frame_gives_constant_depth_and_says_so() -> None:
    estimator = BootstrapDepth()
    estimator.start(ErpCamera(64, 32))
    assert estimator.finish() is None
    assert estimator.add(Frame(0, 0.0, np.zeros((32, 64, 3), np.uint8))) is None
    estimate = estimator.finish()
    assert estimate is not None
    assert not estimate.ok
    assert "too few frames" in estimate.message


def test_oracle_without_depth_says_what_to_do() -> None:
    estimator = OracleDepth()
    estimator.start(ErpCamera(64, 32))
    image = np.zeros((32, 64, 3), np.uint8)
    for k in range(9):
        assert estimator.add(Frame(k, float(k), image)) is None
    with pytest.raises(UnavailableError, match="bootstrap"):
        estimator.add(Frame(9, 9.0, image))


@pytest.mark.parametrize("argument", ["abc", "-1", "nan"])
def test_constant_refuses_nonsense(argument: str) -> None:
    with pytest.raises(UsageError):
        ConstantDepth(argument).start(ErpCamera(64, 32))


def test_constant_is_reproducible() -> None:
    frame = Frame(0, 0.0, np.zeros((32, 64, 3), np.uint8))
    maps = []
    for _ in range(2):
        estimator = ConstantDepth("3")
        estimator.start(ErpCamera(64, 32), seed=5)
        maps.append(estimator.add(frame))
    assert np.array_equal(maps[0].depth, maps[1].depth)
    assert np.median(maps[0].depth) == pytest.approx(3.0, abs=0.1)
