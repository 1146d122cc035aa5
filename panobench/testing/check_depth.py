"""Conformance of depth estimators."""

from __future__ import annotations

import numpy as np

from panobench.depth.base import DepthEstimator
from panobench.specs import DepthSpec
from panobench.testing.conformance import Checks, Options, require
from panobench.testing.sequences import TinySequence
from panobench.types import DepthEstimate, Frame


def depth_checks(spec: DepthSpec, options: Options) -> Checks:
    """The checks of one depth estimator (made with an empty argument)."""
    cls = spec.load()
    sequence = TinySequence(n=12)

    def estimate() -> DepthEstimate | None:
        estimator: DepthEstimator = cls("")
        estimator.start(sequence.camera, options.seed)
        for i, t in enumerate(sequence.times):
            depth = sequence.depth(i) if spec.needs_dataset_depth else None
            answer = estimator.add(Frame(i, float(t), sequence.image(i), depth=depth))
            if answer is not None:
                return answer
        return estimator.finish()

    return [
        ("implementation", lambda: require(issubclass(cls, DepthEstimator), "it is not a DepthEstimator")),
        ("answer", lambda: _answer(estimate(), sequence)),
        ("determinism", lambda: _determinism(estimate(), estimate())),
        (
            "no frames",
            lambda: _no_frames(
                cls(
                    "",
                ),
                sequence,
                options,
            ),
        ),
    ]


def _answer(estimate: DepthEstimate | None, sequence: TinySequence) -> str:
    require(estimate is not None, "after twelve frames and finish() there is still no depth")
    assert estimate is not None
    shape = (sequence.camera.height, sequence.camera.width)
    require(estimate.depth.shape == shape, f"depth has shape {estimate.depth.shape}, the camera {shape}")
    require(estimate.depth.dtype == np.float32, f"depth is {estimate.depth.dtype}, must be float32")
    require(not (estimate.depth <= 0).any(), "depth has values <= 0; unknown is NaN")
    require(np.isfinite(estimate.depth).any(), "depth is unknown everywhere")
    require(0 <= estimate.frame_index < len(sequence), f"frame_index {estimate.frame_index} is no input frame")
    if estimate.confidence is not None:
        require(estimate.confidence.shape == shape, f"confidence has shape {estimate.confidence.shape}")
        c = estimate.confidence
        require((c >= 0).all() and (c <= 1).all(), "confidence leaves 0..1")
    for index, T in estimate.T_wc.items():
        require(np.shape(T) == (4, 4) and np.isfinite(T).all(), f"the pose of frame {index} is no finite 4x4 matrix")
    true = sequence.depth(estimate.frame_index)
    assert true is not None
    known = np.isfinite(estimate.depth) & np.isfinite(true)
    ratio = estimate.depth[known] / true[known]
    error = float(np.median(np.abs(ratio / np.median(ratio) - 1)))
    return f"median error {error:.0%} after scaling, on the test room; ok={estimate.ok}"


def _determinism(a: DepthEstimate | None, b: DepthEstimate | None) -> None:
    same = a is not None and b is not None and np.array_equal(a.depth, b.depth, equal_nan=True)
    require(same, "two runs with the same seed differ")


def _no_frames(estimator: DepthEstimator, sequence: TinySequence, options: Options) -> None:
    estimator.start(sequence.camera, options.seed)
    require(estimator.finish() is None, "finish() without a frame must return None")
