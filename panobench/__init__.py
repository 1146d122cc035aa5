"""panobench: benchmarking visual SLAM with panoramic cameras. Everything a plugin author imports is here.

Names are imported on first use, so that `panobench --help` stays fast.
"""

from __future__ import annotations

import importlib
from typing import Any

from panobench import kernel_cache, openmp

kernel_cache.prepare()
openmp.prepare()

__version__ = "0.1.0"

_EXPORTS = {
    "panobench.api": ("Run", "Runs", "Score", "load", "run", "score"),
    "panobench.bench.run.request": ("RunRequest",),
    "panobench.bench.records.study_record": ("StudyResult",),
    "panobench.cameras.base": ("Camera",),
    "panobench.cameras.rig": ("Rig", "RigLens"),
    "panobench.datasets.base": ("Dataset", "FrameSequence", "Sequence"),
    "panobench.depth.base": ("DepthEstimator",),
    "panobench.errors": (
        "CalibrationError",
        "DatasetError",
        "InputError",
        "MethodError",
        "MethodTimeoutError",
        "PanobenchError",
        "UnavailableError",
        "UnknownNameError",
        "UnsupportedError",
        "UsageError",
    ),
    "panobench.hookspecs": ("hookimpl",),
    "panobench.masks.base": ("MaskEstimate", "MaskEstimator"),
    "panobench.methods.base": ("BatchMethod", "MethodContext", "OnlineMethod"),
    "panobench.metrics.base": ("MetricInput", "PROTOCOL_VERSION"),
    "panobench.options": ("OptionError", "Options", "option"),
    "panobench.specs": (
        "CONTRACT_VERSION",
        "CameraSpec",
        "DatasetSpec",
        "DepthSpec",
        "MaskSpec",
        "MethodSpec",
        "MetricSpec",
        "StudySpec",
    ),
    "panobench.studies.base": ("StudyRequest",),
    "panobench.types": (
        "DepthEstimate",
        "Estimate",
        "Frame",
        "Imu",
        "NovelView",
        "RunStatus",
        "Trajectory",
    ),
}
_WHERE = {name: module for module, names in _EXPORTS.items() for name in names}
__all__ = ["__version__", *sorted(_WHERE)]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'panobench' has no attribute '{name}'")
    return getattr(importlib.import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
