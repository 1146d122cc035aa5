"""Conformance of mask estimators."""

from __future__ import annotations

import numpy as np

from panobench.masks.base import MaskEstimate, MaskEstimator
from panobench.specs import MaskSpec
from panobench.testing.conformance import Checks, Options, require
from panobench.testing.sequences import TinySequence


def mask_checks(spec: MaskSpec, options: Options) -> Checks:
    """The checks of one mask estimator (made with an empty argument)."""
    cls = spec.load()

    def estimate(frames: int = 12) -> MaskEstimate:
        estimator: MaskEstimator = cls("")
        return estimator.estimate(TinySequence(n=frames), options.seed)

    return [
        ("implementation", lambda: require(issubclass(cls, MaskEstimator), "it is not a MaskEstimator")),
        ("answer", lambda: _answer(estimate(), TinySequence(n=12))),
        ("determinism", lambda: _determinism(estimate(), estimate())),
        ("short", lambda: _short(estimate(1), TinySequence(n=1))),
    ]


def _answer(found: MaskEstimate, sequence: TinySequence) -> str:
    require(isinstance(found, MaskEstimate), f"estimate() returned {type(found).__name__}, expected a MaskEstimate")
    shape = (sequence.camera.height, sequence.camera.width)
    for name, mask in [("valid", found.valid), *((f"frame {i}", m) for i, m in found.frames.items())]:
        require(mask.shape == shape, f"{name} has shape {mask.shape}, the camera {shape}")
        require(mask.dtype == np.bool_, f"{name} is {mask.dtype}, must be bool")
    require(all(0 <= i < len(sequence) for i in found.frames), "it has masks of frames that there are not")
    require("\n" not in found.message, "the message has more than one line")
    seen = sequence.camera.valid_mask()
    return f"{(seen & ~found.valid).sum() / max(1, seen.sum()):.1%} of the test room is hidden; ok={found.ok}"


def _determinism(a: MaskEstimate, b: MaskEstimate) -> None:
    require(np.array_equal(a.valid, b.valid), "two estimates with the same seed differ")


def _short(found: MaskEstimate, sequence: TinySequence) -> None:
    _answer(found, sequence)
    require(not found.ok or found.valid.all(), "one frame says nothing of what moves: it must hide nothing or say so")
