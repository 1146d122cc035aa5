"""stella_vslam through run_image_slam of stella_vslam_examples: a folder of images in, TUM trajectories out.

The program takes no times: frame i has the time i / fps. It writes no files if it never started a map.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import yaml

from panobench import Camera, FrameSequence, InputError, MethodContext, UnsupportedError, option
from panobench.external import (
    VOCABULARY_VARIABLE,
    ExternalConfig,
    ExternalMethod,
    Finding,
    Job,
    TrajectoryFormat,
    find_vocabulary,
    frame_rate,
    intrinsics,
    opencv_fisheye,
    opencv_pinhole,
    pixels_ahead,
    require_pyramid,
    write_images,
    write_mask,
)
from panobench_stella_vslam.fbow import fbow_from_dbow2, is_fbow

VOCABULARY = "PANOBENCH_STELLA_VSLAM_VOCABULARY"
#: The value of the option or variable that runs the program without a vocabulary.
NONE = "none"
#: stella_vslam looks for no corners in a margin of every pyramid level; this many pixels on both sides together.
MARGIN = 38


@dataclass(frozen=True)
class StellaVslamConfig(ExternalConfig):
    """Features, vocabulary and pace."""

    vocabulary: str = option(
        "",
        "FBoW file (orb_vocab.fbow) or DBoW2 text file, which is converted; empty: PANOBENCH_STELLA_VSLAM_VOCABULARY "
        "or PANOBENCH_ORB_VOCABULARY, else one is trained on built-in rooms; none: run without, loops are not closed",
    )
    pace: Literal["real-time", "free"] = option("real-time", "wait for each frame's time, or do not")
    ini_fast: int = option(20, "FAST threshold", above=0)
    min_fast: int = option(7, "FAST threshold where the first one finds no corner", above=0)
    min_size: int = option(0, "area per feature on every pyramid level; 0: chosen by image size", unit="px")
    levels: int = option(8, "levels of the image pyramid", above=0)
    scale_factor: float = option(1.2, "ratio of the sizes of two levels of the image pyramid", above=1.0)


def pixels_per_feature(camera: Camera) -> int:
    """The area per feature, in pixels: a panorama gets as many features as in stella_vslam's example, which has 800
    pixels each at 1920x960. Other images get 200 pixels each, or less if 1400 features would not fit.

    Its examples use 800 for every image size. With that, a panorama of 1024 pixels was lost half-way, one of 512 was
    never tracked, and neither was room1 in a pinhole view of 640. A view of 640x213 needed 97 pixels.
    """
    area = camera.width * camera.height
    wanted = min(800, 800 * area / (1920 * 960)) if camera.kind == "erp" else min(200, area / 1400)
    return max(1, round(wanted))


def camera_values(camera: Camera, fps: float) -> dict[str, Any]:
    """The Camera section. Raises UnsupportedError for a model that stella_vslam does not have."""
    # the program reads images by OpenCV, which gives BGR
    values: dict[str, Any] = {"name": "panobench", "setup": "monocular", "fps": fps, "color_order": "BGR"}
    values |= {"cols": camera.width, "rows": camera.height}
    if camera.kind == "erp":
        return values | {"model": "equirectangular"}
    if camera.kind == "fisheye":
        fisheye = opencv_fisheye(camera)
        return values | {
            "model": "fisheye",
            **{f"k{i + 1}": float(k) for i, k in enumerate(fisheye.k)},
            **intrinsics(fisheye),
        }
    if camera.kind == "pinhole":
        pinhole = opencv_pinhole(camera, "stella_vslam")
        distortion = dict(zip(("k1", "k2", "p1", "p2", "k3"), pinhole.distortion))
        return values | {"model": "perspective", **distortion, **intrinsics(pinhole)}
    raise UnsupportedError(f"stella_vslam has no {camera.kind} camera; give --camera erp, pinhole or fisheye")


class StellaVslam(ExternalMethod):
    """Monocular; final poses of all tracked frames."""

    title: ClassVar[str] = "stella_vslam"
    program: ClassVar[str] = "run_image_slam"
    variable: ClassVar[str] = "PANOBENCH_STELLA_VSLAM"
    config_class: ClassVar[type[ExternalConfig]] = StellaVslamConfig
    config: StellaVslamConfig

    @classmethod
    def diagnose(cls) -> list[Finding]:
        method, found = cls(), super().diagnose()
        try:
            named = method._named()
        except InputError as error:
            return [*found, Finding(False, "vocabulary", str(error), f"name another in {VOCABULARY}")]
        detail = f"none is named in {VOCABULARY} or {VOCABULARY_VARIABLE}: one is trained on built-in rooms"
        if method._choice() == NONE:
            detail = "none: loops are not closed"
        return [*found, Finding(True, "vocabulary", str(named) if named else detail)]

    def files(self) -> list[Path]:
        """The program, and the vocabulary if the user named one."""
        named = self._named()
        return [*super().files(), *([] if named is None else [named])]

    def set_up(self, sequence: FrameSequence, context: MethodContext) -> None:
        """Train or convert a vocabulary if that is needed, which is not counted as the run's time."""
        if not self._choice():
            find_vocabulary("", sequence, context.log)
        self._vocabulary(sequence, context.work.resolve())

    def _choice(self) -> str:
        """What the option or the variables name: a file, NONE, or nothing (an empty text)."""
        return self.config.vocabulary or os.environ.get(VOCABULARY, "") or os.environ.get(VOCABULARY_VARIABLE, "")

    def _named(self) -> Path | None:
        """The vocabulary that the user named. Raises InputError if it is not there."""
        name = self._choice()
        if name in ("", NONE):
            return None
        path = Path(name).expanduser().resolve()
        if not path.is_file():
            raise InputError("no such vocabulary file (FBoW's format or DBoW2's text)", path)
        return path

    def _vocabulary(self, sequence: FrameSequence, work: Path) -> Path | None:
        """A file in FBoW's format. One in DBoW2's format is converted, into the work folder."""
        if self._choice() == NONE:
            return None
        source = self._named() or find_vocabulary("", sequence)
        if is_fbow(source):
            return source
        converted = work / "vocabulary.fbow"
        if not converted.exists():
            fbow_from_dbow2(source, converted)
        return converted

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        camera = sequence.camera
        require_pyramid(camera, self.config.levels, self.config.scale_factor, MARGIN, "stella_vslam")
        fps = round(frame_rate(sequence.times), 6)
        config = {
            "Camera": camera_values(camera, fps),
            "Preprocessing": {"min_size": self.config.min_size or pixels_per_feature(camera)},
            "Feature": {
                "name": "panobench",
                "scale_factor": float(self.config.scale_factor),
                "num_levels": self.config.levels,
                "ini_fast_threshold": self.config.ini_fast,
                "min_fast_threshold": self.config.min_fast,
            },
            "System": {"map_format": "msgpack"},
        }
        (work / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False))
        write_images(sequence, work / "images")
        (work / "eval").mkdir()
        arguments = ["--img-dir", str(work / "images"), "--config", str(work / "config.yaml")]
        arguments += ["--eval-log-dir", str(work / "eval"), "--start-timestamp", "0", "--viewer", "none", "--auto-term"]
        arguments += ["--no-sleep"] if self.config.pace == "free" else []
        if write_mask(camera, work / "mask.png", pixels_ahead(camera) if camera.kind == "fisheye" else None):
            arguments += ["--mask", str(work / "mask.png")]
        vocabulary = self._vocabulary(sequence, work)
        arguments += ["--vocab", str(vocabulary)] if vocabulary else ["--without-vocab"]
        if vocabulary is None:
            context.log("stella_vslam runs without a vocabulary: loops are not closed")
        return Job(
            arguments,
            work / "eval" / "frame_trajectory.txt",
            TrajectoryFormat("tum", index_rate=fps),
            reads=() if vocabulary is None or work in vocabulary.parents else (vocabulary,),
            keyframes=work / "eval" / "keyframe_trajectory.txt",
            frame_seconds=work / "eval" / "track_times.txt",
            silent_when_lost=True,
        )
