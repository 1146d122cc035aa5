"""Calibration files: ``read_calibration(path)`` and ``write_calibration(camera, path, format)``."""

from panobench.cameras.calibration.dispatch import (
    FORMATS,
    WRITTEN,
    builtin_calibration,
    calibration_file,
    inspect_builtin,
    inspect_calibration,
    is_calibration,
    read_calibration,
    require_size,
    split_choice,
    write_calibration,
)
from panobench.cameras.calibration.result import Calibration

__all__ = [
    "FORMATS",
    "WRITTEN",
    "Calibration",
    "builtin_calibration",
    "calibration_file",
    "inspect_builtin",
    "inspect_calibration",
    "is_calibration",
    "read_calibration",
    "require_size",
    "split_choice",
    "write_calibration",
]
