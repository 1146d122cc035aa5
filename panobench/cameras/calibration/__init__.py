"""Calibration files: ``read_calibration(path)`` and ``write_calibration(camera, path, format)``."""

from panobench.cameras.calibration.dispatch import (
    FORMATS,
    builtin_calibration,
    inspect_builtin,
    inspect_calibration,
    read_calibration,
    require_size,
    write_calibration,
)
from panobench.cameras.calibration.result import Calibration

__all__ = [
    "FORMATS",
    "Calibration",
    "builtin_calibration",
    "inspect_builtin",
    "inspect_calibration",
    "read_calibration",
    "require_size",
    "write_calibration",
]
