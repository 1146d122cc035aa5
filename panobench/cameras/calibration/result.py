"""What a calibration file says."""

from __future__ import annotations

from dataclasses import dataclass, field

from panobench.cameras.base import Array, Camera


@dataclass(frozen=True)
class Calibration:
    """A camera and where it came from.

    notes:         what was found or decided while reading (orders, signs, ignored parts), one line each.
    body_T_cam:    (4, 4) pose of the camera on the body (IMU axes), if the file has one.
    time_offset_s: IMU time minus camera time of the same instant, if the file has one.
    doubts:        what was assumed for want of a word in the file, and may be wrong: the user is told.
    """

    camera: Camera
    format: str
    notes: list[str] = field(default_factory=list)
    body_T_cam: Array | None = None
    time_offset_s: float | None = None
    doubts: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ReadOptions:
    """camera: which one of a file with several. annulus: (r_min, r_max) in pixels about the model's centre."""

    camera: str | None = None
    annulus: tuple[float, float] | None = None
