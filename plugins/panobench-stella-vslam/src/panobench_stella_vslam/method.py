"""stella_vslam through run_image_slam of stella_vslam_examples: a folder of images in, TUM out.

The program takes no times: frame i is given at i / fps. It writes nothing when it never started a map.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import yaml

from panobench import Camera, Estimate, FrameSequence, InputError, MethodContext, UnsupportedError
from panobench.external import (
    VOCABULARY_VARIABLE,
    ExternalConfig,
    ExternalMethod,
    Finding,
    Job,
    TrajectoryFormat,
    find_vocabulary,
    frame_rate,
    opencv_fisheye,
    opencv_pinhole,
    pixels_ahead,
    require_pyramid,
    write_images,
    write_mask,
)
from panobench_stella_vslam.fbow import fbow_from_dbow2, is_fbow

VOCABULARY = "PANOBENCH_STELLA_VSLAM_VOCABULARY"
#: As option or variable: run without a vocabulary.
NONE = "none"
#: Pixels of each pyramid level, on both sides together, in which stella_vslam looks for no corners.
MARGIN = 38


@dataclass(frozen=True)
class StellaVslamConfig(ExternalConfig):
    """vocabulary: an FBoW file (orb_vocab.fbow) or a DBoW2 text file, which is rewritten; "": the variables
    PANOBENCH_STELLA_VSLAM_VOCABULARY or PANOBENCH_ORB_VOCABULARY, else one is trained on built-in rooms; "none":
    without, and then no loop is closed.
    pace: "real-time" waits for each frame's time, "free" does not.
    min_size: pixels per feature on every pyramid level; 0: see ``pixels_per_feature``.
    """

    vocabulary: str = ""
    pace: str = "real-time"
    ini_fast: int = 20
    min_fast: int = 7
    min_size: int = 0
    levels: int = 8
    scale_factor: float = 1.2


def pixels_per_feature(camera: Camera) -> int:
    """As many features for a panorama as stella_vslam's example has, 800 pixels each at 1920x960; elsewhere 200 pixels
    each, and room for 1400 at least.

    Its examples have 800 for every image size. With that a panorama of 1024 pixels was lost half-way, one of 512 never
    tracked, nor was room1 in a pinhole view of 640; a view of 640x213 needed 97 pixels.
    """
    area = camera.width * camera.height
    wanted = min(800, 800 * area / (1920 * 960)) if camera.kind == "erp" else min(200, area / 1400)
    return max(1, round(wanted))


def camera_values(camera: Camera, fps: float) -> dict[str, Any]:
    """The Camera section. Raises UnsupportedError for a model stella_vslam does not have."""
    values: dict[str, Any] = {
        "name": "panobench",
        "setup": "monocular",
        "fps": fps,
        "color_order": "BGR",
    }  # as OpenCV reads
    values |= {"cols": camera.width, "rows": camera.height}
    if camera.kind == "erp":
        return values | {"model": "equirectangular"}
    if camera.kind == "fisheye":
        fisheye = opencv_fisheye(camera)
        values |= {"model": "fisheye", **{f"k{i + 1}": float(k) for i, k in enumerate(fisheye.k)}}
        return values | {key: float(getattr(fisheye, key)) for key in ("fx", "fy", "cx", "cy")}
    if camera.kind == "pinhole":
        pinhole = opencv_pinhole(camera, "stella_vslam")
        values |= {"model": "perspective", **dict(zip(("k1", "k2", "p1", "p2", "k3"), pinhole.distortion))}
        return values | {key: float(getattr(pinhole, key)) for key in ("fx", "fy", "cx", "cy")}
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
        detail = f"none named in {VOCABULARY} or {VOCABULARY_VARIABLE}: one will be trained on built-in rooms, once"
        if method._choice() == NONE:
            detail = "none: loops are not closed"
        return [*found, Finding(True, "vocabulary", str(named) if named else detail)]

    def files(self) -> list[Path]:
        """The program and the named vocabulary."""
        place = self.place()
        found = place.find(self.command()) if place.kind in ("local", "venv") else None
        return [Path(p) for p in (found, self._named()) if p is not None]

    def set_up(self, sequence: FrameSequence, context: MethodContext) -> None:
        """A vocabulary that must be trained or rewritten first is so outside the run's own time."""
        if not self._choice():
            find_vocabulary("", sequence, context.log)
        self._vocabulary(sequence, context.work.resolve())

    def _choice(self) -> str:
        """What the option or the variables name: a file, NONE, or nothing."""
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
        """A file in FBoW's format, if need be a rewritten one in the work folder."""
        if self._choice() == NONE:
            return None
        source = self._named() or find_vocabulary("", sequence)
        if is_fbow(source):
            return source
        rewritten = work / "vocabulary.fbow"
        if not rewritten.exists():
            fbow_from_dbow2(source, rewritten)
        return rewritten

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        if self.config.pace not in ("real-time", "free"):
            raise UnsupportedError(f"pace '{self.config.pace}': stella_vslam is run at pace real-time or free")
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
            context.log("stella_vslam: without a vocabulary: loops are not closed")
        return Job(
            arguments,
            work / "eval" / "frame_trajectory.txt",
            TrajectoryFormat("tum", index_rate=fps),
            reads=() if vocabulary is None or work in vocabulary.parents else (vocabulary,),
            keyframes=work / "eval" / "keyframe_trajectory.txt",
            silent_when_lost=True,
        )

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """As the base class; the program's own tracking times join the frames."""
        estimate = super().run(sequence, context)
        times = context.work / "eval" / "track_times.txt"
        if times.exists():
            seconds = [float(line) for line in times.read_text().split()]
            if len(seconds) == len(sequence):
                estimate.frames = {i: {"program_tracking_s": s} for i, s in enumerate(seconds)}
        return estimate


def missing() -> str | None:
    """For the probe."""
    return StellaVslam.missing()
