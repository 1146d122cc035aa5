"""The input of a metric. A metric is a function from ``MetricInput`` to named numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.types import Estimate

#: Version of the evaluation protocol (docs/protocol.md); in every run.json.
PROTOCOL_VERSION = "1.3"
#: A run that tracked a smaller share of its frames is lost.
MIN_TRACKED = 0.9
#: A run with a larger ATE is lost too. The largest error in the paper's tables is 2.66 m; beyond, they print "/".
FAILED_ATE_M = 3.0

Render = Callable[[Camera, NDArray[np.float64]], "NDArray[np.float32] | None"]


@dataclass
class MetricInput:
    """A finished run: the sequence with its truth, the estimate, and the method's renderer.

    frames:   indices (into ``sequence``) that were given to the method.
    holdout:  those of them that were never mapped.
    latency:  seconds per frame given, same order as ``frames``.
    renders:  folder where pictures for the report may be written (it may not exist yet), or None.
    notes:    key -> one line; a metric says here why a number is None.
    alignment: of the trajectory before ATE; "auto" is Sim(3).
    keyframes_only: the trajectory has the keyframes alone, and is judged as such.
    """

    sequence: FrameSequence
    estimate: Estimate
    frames: list[int]
    holdout: list[int] = field(default_factory=list)
    latency: list[float] = field(default_factory=list)
    render: Render | None = None
    renders: Path | None = None
    notes: dict[str, str] = field(default_factory=dict)
    alignment: Literal["auto", "sim3", "se3", "none"] = "auto"
    keyframes_only: bool = False
