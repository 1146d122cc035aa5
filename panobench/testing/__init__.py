"""Helpers for a plugin's tests: a tiny sequence, a fake camera, runs, fixtures and the conformance suite.

In ``conftest.py``: ``from panobench.testing import fake_camera, rotating_sequence, tiny_sequence``.
"""

from __future__ import annotations

import importlib
from typing import Any

_EXPORTS = {
    "panobench.testing.check_metrics": ("made_up_run",),
    "panobench.testing.conformance": ("Check", "Options", "check_spec", "assert_conforms"),
    "panobench.cameras.factory": ("camera_from_dict",),
    "panobench.testing.cameras": ("FakeCamera", "annular_camera", "fisheye_camera", "pinhole_camera"),
    "panobench.testing.fixtures": ("fake_camera", "rotating_sequence", "tiny_sequence"),
    "panobench.testing.programs": ("pose_rows", "write_program"),
    "panobench.testing.ros_workspace": ("IDLE", "write_ros_workspace"),
    "panobench.testing.running": ("MethodRun", "ate_rmse", "make_method", "rotation_error_deg", "run_method"),
    "panobench.testing.sequences": (
        "BlindSequence",
        "GivenImages",
        "TinySequence",
        "erp_camera",
        "rotating_pose",
        "smooth_pose",
        "two_lenses",
    ),
}
_WHERE = {name: module for module, names in _EXPORTS.items() for name in names}
__all__ = sorted(_WHERE)


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'panobench.testing' has no attribute '{name}'")
    return getattr(importlib.import_module(_WHERE[name]), name)
