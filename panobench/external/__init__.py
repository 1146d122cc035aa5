"""Base classes and helpers of adapters that run other people's programs as panobench methods.

They are part of the plugin contract (`docs/plugins.md`). Names are imported on first use, so that `panobench --help`
stays fast.
"""

from __future__ import annotations

import importlib
from typing import Any

_EXPORTS = {
    "panobench.external.adapter": (
        "ExternalConfig",
        "ExternalMethod",
        "ExternalProgramError",
        "ExternalTimeoutError",
        "Job",
    ),
    "panobench.external.annulus": ("Annulus", "fit_annulus"),
    "panobench.external.bag": ("BAG_START_S", "write_bag"),
    "panobench.external.findings": ("Finding", "library_finding", "missing_libraries"),
    "panobench.external.imu_noise": ("sample_noise",),
    "panobench.external.inputs": (
        "OpenCvFisheye",
        "OpenCvPinhole",
        "WrittenImages",
        "frame_rate",
        "intrinsics",
        "nanoseconds",
        "opencv_fisheye",
        "opencv_pinhole",
        "opencv_yaml",
        "pixels_ahead",
        "require_pyramid",
        "write_images",
        "write_mask",
    ),
    "panobench.external.launch": ("Place", "parse_place"),
    "panobench.external.orb_slam": ("MonoEurocMethod", "OrbSlamConfig", "OrbSlamMethod"),
    "panobench.external.python_package": ("PythonPackageMethod", "copy_script", "find_package"),
    "panobench.external.ros": ("find_node",),
    "panobench.external.stored_map": ("StoredMap", "read_stored_map"),
    "panobench.external.trajectory": ("TrajectoryFormat", "read_answer"),
    "panobench.external.vins": (
        "VinsConfig",
        "VinsMethod",
        "camodocal_camera",
        "vins_settings",
        "write_tracker_mask",
    ),
    "panobench.external.vocabulary": (
        "VOCABULARY_VARIABLE",
        "Vocabulary",
        "find_vocabulary",
        "named_vocabulary",
        "orb_descriptors",
        "train_vocabulary",
    ),
}
_WHERE = {name: module for module, names in _EXPORTS.items() for name in names}
__all__ = sorted(_WHERE)


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'panobench.external' has no attribute '{name}'")
    return getattr(importlib.import_module(_WHERE[name]), name)
