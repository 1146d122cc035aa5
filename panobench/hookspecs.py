"""The hooks a plugin may implement. Built-ins implement the same ones (see panobench/builtins.py)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pluggy

if TYPE_CHECKING:
    import numpy as np

    from panobench.datasets.base import FrameSequence
    from panobench.methods.base import OnlineMethod
    from panobench.specs import (
        CameraSpec,
        DatasetSpec,
        DepthSpec,
        MaskSpec,
        MethodSpec,
        MetricSpec,
        StudySpec,
    )
    from panobench.types import Frame

hookspec = pluggy.HookspecMarker("panobench")
hookimpl = pluggy.HookimplMarker("panobench")


@hookspec
def register_cameras() -> Sequence[CameraSpec]:
    """Camera models."""
    return ()


@hookspec
def register_datasets() -> Sequence[DatasetSpec]:
    """Dataset adapters and generators."""
    return ()


@hookspec
def register_methods() -> Sequence[MethodSpec]:
    """SLAM and reconstruction methods."""
    return ()


@hookspec
def register_depth_estimators() -> Sequence[DepthSpec]:
    """Depth estimators that start a map."""
    return ()


@hookspec
def register_mask_estimators() -> Sequence[MaskSpec]:
    """Mask estimators: what moves with the camera (since contract 1.1)."""
    return ()


@hookspec
def register_metrics() -> Sequence[MetricSpec]:
    """Metrics computed from a finished run."""
    return ()


@hookspec
def register_studies() -> Sequence[StudySpec]:
    """Studies: `panobench study NAME`."""
    return ()


@hookspec
def run_started(spec: dict[str, Any], sequence: FrameSequence) -> None:
    """A run begins; ``spec`` is what run.json will hold under "spec". Called in the run's process.

    ``sequence``: what the method is going to see, with its ground truth, which the method does not see.
    """


@hookspec
def frame_done(frame: Frame, T_wc: np.ndarray | None, latency_s: float, method: OnlineMethod) -> None:
    """A frame was tracked (pose) or not (None). Not counted in the method's time.

    ``method`` is there to be looked at, by ``live_map`` and ``render``.
    """


@hookspec
def run_finished(folder: Path, run: dict[str, Any]) -> None:
    """The run folder is complete; ``run`` is the content of its run.json."""
