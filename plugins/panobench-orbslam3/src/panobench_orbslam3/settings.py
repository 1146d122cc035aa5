"""ORB-SLAM3's settings file (version 1.0) from a panobench camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench import Camera, UnsupportedError
from panobench.external import ExternalConfig, opencv_fisheye, opencv_pinhole, pixels_ahead, require_pyramid

#: Pixels of each pyramid level, on both sides together, in which ORB-SLAM3 looks for no corners.
MARGIN = 32


@dataclass(frozen=True)
class OrbSlam3Config(ExternalConfig):
    """vocabulary: a DBoW2 text file ("": PANOBENCH_ORB_VOCABULARY, else one is trained on built-in rooms).

    pace: 1 waits for each frame's time as ORB-SLAM3's own programs do, 0 does not wait (the mapper may fall behind).
    The binary always waits.
    """

    vocabulary: str = ""
    features: int = 1000
    scale_factor: float = 1.2
    levels: int = 8
    ini_fast: int = 20
    min_fast: int = 7
    pace: float = 1.0


def seen(camera: Camera) -> NDArray[np.bool_] | None:
    """(H, W): what ORB-SLAM3 is shown of a fisheye's image; None for all of it.

    It carries keypoints to the plane z = 1: with all of a 190 degree image it never started a map.
    """
    return pixels_ahead(camera) if camera.kind == "fisheye" else None


def settings(camera: Camera, rate: float, config: OrbSlam3Config) -> dict[str, Any]:
    """Keys and values of the settings file. Raises UnsupportedError for a camera ORB-SLAM3 has no model of."""
    values: dict[str, Any] = {"File.version": "1.0"}
    if camera.kind == "fisheye":
        fisheye = opencv_fisheye(camera)
        values["Camera.type"] = "KannalaBrandt8"
        numbers: Any = fisheye
        values |= {f"Camera1.k{i + 1}": float(k) for i, k in enumerate(fisheye.k)}
    elif camera.kind == "pinhole":
        pinhole = opencv_pinhole(camera, "ORB-SLAM3")
        values["Camera.type"] = "PinHole"
        numbers = pinhole
        if any(pinhole.distortion):
            k1, k2, p1, p2, k3 = pinhole.distortion
            values |= {"Camera1.k1": k1, "Camera1.k2": k2, "Camera1.p1": p1, "Camera1.p2": p2}
            values |= {"Camera1.k3": k3} if k3 else {}
    else:
        raise UnsupportedError(f"ORB-SLAM3 has no {camera.kind} camera; give --camera pinhole or fisheye")
    require_pyramid(camera, config.levels, config.scale_factor, MARGIN, "ORB-SLAM3")
    values |= {f"Camera1.{key}": float(getattr(numbers, key)) for key in ("fx", "fy", "cx", "cy")}
    values |= {
        "Camera.width": camera.width,
        "Camera.height": camera.height,
        "Camera.fps": max(1, round(rate)),
        "Camera.RGB": 1,
        "ORBextractor.nFeatures": config.features,
        "ORBextractor.scaleFactor": float(config.scale_factor),
        "ORBextractor.nLevels": config.levels,
        "ORBextractor.iniThFAST": config.ini_fast,
        "ORBextractor.minThFAST": config.min_fast,
    }
    viewer = {"KeyFrameSize": 0.05, "KeyFrameLineWidth": 1.0, "GraphLineWidth": 0.9, "PointSize": 2.0}
    viewer |= {"CameraSize": 0.08, "CameraLineWidth": 3.0}
    viewer |= {"ViewpointX": 0.0, "ViewpointY": -0.7, "ViewpointZ": -3.5, "ViewpointF": 500.0}
    return values | {f"Viewer.{key}": value for key, value in viewer.items()}
