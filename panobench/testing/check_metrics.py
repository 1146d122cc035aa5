"""Conformance of metrics, on made-up runs: perfect, noisy, without truth, and with nothing tracked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.geometry import se3_exp
from panobench.metrics.base import MetricInput
from panobench.specs import MetricSpec
from panobench.testing.conformance import Checks, require
from panobench.testing.sequences import GivenImages, TinySequence
from panobench.types import Estimate, Trajectory


def made_up_run(
    sequence: FrameSequence, noise_m: float = 0.0, n: int | None = None, folder: Path | None = None
) -> MetricInput:
    """A finished run whose poses are the truth plus noise; the first ``n`` frames are tracked (default all)."""
    count = len(sequence) if n is None else n
    truth = sequence.groundtruth
    rng = np.random.default_rng(1)
    T = np.tile(np.eye(4), (len(sequence), 1, 1)) if truth is None else truth.T_wc.copy()
    T = T @ se3_exp(rng.normal(size=(len(sequence), 6)) * noise_m)

    def render(camera: Any, T_wc: NDArray[np.float64]) -> NDArray[np.float32]:
        if isinstance(sequence, TinySequence):
            image = sequence.image_from(T_wc, camera).astype(np.float32) / 255
            return image + np.float32(noise_m) * rng.normal(size=image.shape).astype(np.float32)
        return np.zeros((camera.height, camera.width, 3), np.float32)

    return MetricInput(
        sequence,
        Estimate(Trajectory(sequence.times[:count], T[:count]), keyframes=list(range(0, count, 4))),
        frames=list(range(len(sequence))),
        holdout=[len(sequence) - 1] if len(sequence) else [],
        latency=[0.05] * len(sequence),
        render=render,
        renders=folder,
    )


def metric_checks(spec: MetricSpec) -> Checks:
    """The checks of one metric."""
    function = spec.load()
    sequence = TinySequence(n=6)
    blind = GivenImages(sequence.camera, [sequence.image(i) for i in range(6)])
    return [
        ("declaration", lambda: _declaration(spec)),
        ("numbers", lambda: _numbers(spec, function(made_up_run(sequence, 0.02)))),
        ("repeatable", lambda: _repeatable(function, sequence)),
        ("direction", lambda: _direction(spec, function, sequence)),
        ("no ground truth", lambda: _numbers(spec, function(made_up_run(blind)))),
        ("nothing tracked", lambda: _numbers(spec, function(made_up_run(sequence, n=0)))),
        ("one pose", lambda: _numbers(spec, function(made_up_run(sequence, n=1)))),
    ]


def _declaration(spec: MetricSpec) -> None:
    require(spec.keys, "keys is empty: name what it writes and whether lower or higher is better")
    bad = {k: v for k, v in spec.keys.items() if v not in ("lower", "higher", "none")}
    require(not bad, f"keys {bad}: must be 'lower', 'higher' or 'none'")


def _numbers(spec: MetricSpec, result: Any) -> str:
    require(isinstance(result, Mapping), f"it returns a {type(result).__name__}, not a mapping")
    unknown = set(result) - set(spec.keys)
    require(not unknown, f"it writes {sorted(unknown)}, which its spec does not name")
    for key, value in result.items():
        number = isinstance(value, (int, float, np.floating, np.integer)) and not isinstance(value, bool)
        require(value is None or number, f"{key} is {value!r}, must be a number or None")
        require(value is None or np.isfinite(float(value)), f"{key} is {value}; what cannot be measured is None")
    return ", ".join(f"{k} {'-' if v is None else format(float(v), '.3g')}" for k, v in list(result.items())[:3])


def _repeatable(function: Any, sequence: TinySequence) -> None:
    a, b = (dict(function(made_up_run(sequence, 0.02))) for _ in range(2))
    require(a == b, f"the same run gives {a} and then {b}")


def _direction(spec: MetricSpec, function: Any, sequence: TinySequence) -> None:
    good, bad = function(made_up_run(sequence)), function(made_up_run(sequence, 0.05))
    for key, better in spec.keys.items():
        a, b = good.get(key), bad.get(key)
        if a is None or b is None or better == "none":
            continue
        require(a <= b if better == "lower" else a >= b, f"{key}: the perfect run gets {a:.4g}, the noisy one {b:.4g}")
