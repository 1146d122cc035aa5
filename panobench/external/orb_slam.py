"""ORB-SLAM3 and its descendants: their settings file (version 1.0), vocabulary and command line.

The settings file's keys are those of ORB-SLAM3's `Examples` (Campos et al., T-RO 2021).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.errors import UnsupportedError
from panobench.external.adapter import ExternalConfig, ExternalMethod, Job
from panobench.external.findings import Finding
from panobench.external.inputs import (
    frame_rate,
    intrinsics,
    nanoseconds,
    opencv_fisheye,
    opencv_pinhole,
    opencv_yaml,
    pixels_ahead,
    require_pyramid,
    write_images,
)
from panobench.external.trajectory import TrajectoryFormat
from panobench.external.vocabulary import VOCABULARY_VARIABLE, find_vocabulary, named_vocabulary
from panobench.methods.base import MethodContext
from panobench.options import option

#: ORB-SLAM3 looks for no corners in a margin of every pyramid level; this many pixels on both sides together.
PYRAMID_MARGIN = 32
#: What the viewer is set to. ORB-SLAM3 reads these keys even when it runs without a viewer.
_VIEWER = {
    "KeyFrameSize": 0.05,
    "KeyFrameLineWidth": 1.0,
    "GraphLineWidth": 0.9,
    "PointSize": 2.0,
    "CameraSize": 0.08,
    "CameraLineWidth": 3.0,
    "ViewpointX": 0.0,
    "ViewpointY": -0.7,
    "ViewpointZ": -3.5,
    "ViewpointF": 500.0,
}


@dataclass(frozen=True)
class OrbSlamConfig(ExternalConfig):
    """ORB features and vocabulary."""

    vocabulary: str = option(
        "", "DBoW2 vocabulary in text format; empty: PANOBENCH_ORB_VOCABULARY, else one is trained on built-in rooms"
    )
    features: int = option(1000, "ORB features per image", above=0)
    scale_factor: float = option(1.2, "ratio of the sizes of two levels of the image pyramid", above=1.0)
    levels: int = option(8, "levels of the image pyramid", above=0)
    ini_fast: int = option(20, "FAST threshold", above=0)
    min_fast: int = option(7, "FAST threshold where the first one finds no corner", above=0)


def camera_settings(camera: Camera, program: str) -> dict[str, Any]:
    """The camera's keys: PinHole or KannalaBrandt8. Raises UnsupportedError for cameras of other kinds."""
    if camera.kind == "fisheye":
        fisheye = opencv_fisheye(camera)
        values: dict[str, Any] = {"Camera.type": "KannalaBrandt8"}
        values |= {f"Camera1.k{i + 1}": float(k) for i, k in enumerate(fisheye.k)}
        return values | {f"Camera1.{key}": v for key, v in intrinsics(fisheye).items()}
    if camera.kind == "pinhole":
        pinhole = opencv_pinhole(camera, program)
        values = {"Camera.type": "PinHole", **{f"Camera1.{key}": v for key, v in intrinsics(pinhole).items()}}
        if any(pinhole.distortion):
            values |= {f"Camera1.{key}": k for key, k in zip(("k1", "k2", "p1", "p2", "k3"), pinhole.distortion)}
            if not pinhole.distortion[4]:
                del values["Camera1.k3"]
        return values
    raise UnsupportedError(f"{program} has no {camera.kind} camera; give --camera pinhole or fisheye")


def extractor_settings(camera: Camera, rate: float, config: OrbSlamConfig, program: str) -> dict[str, Any]:
    """Image size, frame rate, ORB extractor and viewer. Raises UnsupportedError for images that are too small."""
    require_pyramid(camera, config.levels, config.scale_factor, PYRAMID_MARGIN, program)
    return {
        "Camera.width": camera.width,
        "Camera.height": camera.height,
        "Camera.fps": max(1, round(rate)),
        "Camera.RGB": 1,
        "ORBextractor.nFeatures": config.features,
        "ORBextractor.scaleFactor": float(config.scale_factor),
        "ORBextractor.nLevels": config.levels,
        "ORBextractor.iniThFAST": config.ini_fast,
        "ORBextractor.minThFAST": config.min_fast,
        **{f"Viewer.{key}": value for key, value in _VIEWER.items()},
    }


class OrbSlamMethod(ExternalMethod):
    """Base class of the family: a vocabulary, a settings file, images named by their times."""

    config_class: ClassVar[type[ExternalConfig]] = OrbSlamConfig
    config: OrbSlamConfig

    @abstractmethod
    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job: ...

    def set_up(self, sequence: FrameSequence, context: MethodContext) -> None:
        """Train a vocabulary if that is needed, which is not counted as the run's time."""
        find_vocabulary(self.config.vocabulary, sequence, context.log)

    def files(self) -> list[Path]:
        """The program, and the vocabulary if the user named one."""
        named = named_vocabulary(self.config.vocabulary)
        return [*super().files(), *([] if named is None else [named])]

    @classmethod
    def diagnose(cls) -> list[Finding]:
        """As the base class, and which vocabulary is used."""
        named = named_vocabulary("")
        detail = str(named) if named else f"none is named in {VOCABULARY_VARIABLE}: one is trained on built-in rooms"
        return [*super().diagnose(), Finding(True, "vocabulary", detail)]

    def camera_settings(self, camera: Camera) -> dict[str, Any]:
        """The camera's keys in the settings file. Raises UnsupportedError for a camera the program has no model of."""
        return camera_settings(camera, self.title)

    def settings(self, camera: Camera, rate: float) -> dict[str, Any]:
        """Keys and values of the settings file for images at ``rate`` frames per second."""
        head = {"File.version": "1.0", **self.camera_settings(camera)}
        return head | extractor_settings(camera, rate, self.config, self.title)

    def visible_pixels(self, camera: Camera) -> NDArray[np.bool_] | None:
        """(H, W): the pixels that the program is shown, None for all of them. All others are written black.

        Keypoints are carried to the plane z = 1: ORB-SLAM3 never started a map with the whole of a 190 degree image.
        """
        return pixels_ahead(camera) if camera.kind == "fisheye" else None

    def file_settings(self, camera: Camera, work: Path) -> dict[str, Any]:
        """Further keys of the settings file, for files that are written to the work folder here. By default none."""
        return {}

    def write_inputs(
        self, sequence: FrameSequence, work: Path, images: Path, further: Mapping[str, Any] | None = None
    ) -> Path:
        """Write settings.yaml, times.txt and the grey images, named by their times in ns; return the vocabulary.

        further: keys of the settings file besides those of the camera and the features.
        """
        values = self.settings(sequence.camera, frame_rate(sequence.times)) | dict(further or {})
        (work / "settings.yaml").write_text(opencv_yaml(values | self.file_settings(sequence.camera, work)))
        stamps = nanoseconds(sequence.times)
        write_images(sequence, images, grey=True, names=stamps, keep=self.visible_pixels(sequence.camera))
        (work / "times.txt").write_text("\n".join(stamps) + "\n")
        return find_vocabulary(self.config.vocabulary, sequence)


class MonoEurocMethod(OrbSlamMethod):
    """Programs with mono_euroc's command line: ``PROGRAM VOCABULARY SETTINGS SEQUENCE TIMES NAME``.

    They write f_NAME.txt (all frames) and kf_NAME.txt (keyframes) to the current folder.
    """

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        vocabulary = self.write_inputs(sequence, work, work / "sequence" / "mav0" / "cam0" / "data")
        arguments = [vocabulary, work / "settings.yaml", work / "sequence", work / "times.txt", "run"]
        return Job(
            [str(a) for a in arguments],
            work / "f_run.txt",
            TrajectoryFormat("tum-ns"),
            reads=(vocabulary,),
            keyframes=work / "kf_run.txt",
        )
