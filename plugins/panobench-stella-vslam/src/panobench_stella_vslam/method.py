"""stella_vslam through run_image_slam of stella_vslam_examples: a folder of images in, TUM out.

The program takes no times: frame i is given at i / fps. It writes nothing when it never started a map.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import yaml

from panobench import Camera, Estimate, InputError, MethodContext, UnsupportedError
from panobench.datasets.base import Sequence
from panobench.methods.external_inputs import frame_rate, opencv_fisheye, opencv_pinhole, write_images, write_mask
from panobench.methods.external_trajectory import TrajectoryFormat
from panobench.methods.subprocess_adapter import ExternalConfig, ExternalMethod, Job

VOCABULARY = "PANOBENCH_STELLA_VSLAM_VOCABULARY"


@dataclass(frozen=True)
class StellaVslamConfig(ExternalConfig):
    """vocabulary: an FBoW file (orb_vocab.fbow; "": the variable PANOBENCH_STELLA_VSLAM_VOCABULARY, else none, and then
    no loop is closed). pace: "real-time" waits for each frame's time, "free" does not.
    """

    vocabulary: str = ""
    pace: str = "real-time"
    ini_fast: int = 20
    min_fast: int = 7
    min_size: int = 800


def camera_values(camera: Camera, fps: float) -> dict[str, Any]:
    """The Camera section. Raises UnsupportedError for a model stella_vslam does not have."""
    values: dict[str, Any] = {"name": "panobench", "setup": "monocular", "fps": fps, "color_order": "RGB"}
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

    def prepare(self, sequence: Sequence, context: MethodContext) -> Job:
        work = context.work
        if self.config.pace not in ("real-time", "free"):
            raise UnsupportedError(f"pace '{self.config.pace}': stella_vslam is run at pace real-time or free")
        fps = round(frame_rate(sequence.times), 6)
        config = {
            "Camera": camera_values(sequence.camera, fps),
            "Preprocessing": {"min_size": self.config.min_size},
            "Feature": {
                "name": "panobench",
                "scale_factor": 1.2,
                "num_levels": 8,
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
        if write_mask(sequence.camera, work / "mask.png"):
            arguments += ["--mask", str(work / "mask.png")]
        vocabulary = _vocabulary(self.config.vocabulary)
        arguments += ["--vocab", str(vocabulary)] if vocabulary else ["--without-vocab"]
        if vocabulary is None:
            context.log(f"stella_vslam: no vocabulary is named in {VOCABULARY}: loops are not closed")
        return Job(
            arguments,
            work / "eval" / "frame_trajectory.txt",
            TrajectoryFormat("tum", index_rate=fps),
            reads=() if vocabulary is None else (vocabulary,),
            keyframes=work / "eval" / "keyframe_trajectory.txt",
            silent_when_lost=True,
        )

    def run(self, sequence: Sequence, context: MethodContext) -> Estimate:
        """As the base class; the program's own tracking times join the frames."""
        estimate = super().run(sequence, context)
        times = context.work / "eval" / "track_times.txt"
        if times.exists():
            seconds = [float(line) for line in times.read_text().split()]
            if len(seconds) == len(sequence):
                estimate.frames = {i: {"program_tracking_s": s} for i, s in enumerate(seconds)}
        return estimate


def _vocabulary(option: str) -> Path | None:
    name = option or os.environ.get(VOCABULARY, "")
    if not name:
        return None
    path = Path(name).expanduser().resolve()
    if not path.is_file():
        raise InputError("no such vocabulary file (FBoW format, usually called orb_vocab.fbow)", path)
    return path


def missing() -> str | None:
    """For the probe."""
    return StellaVslam.missing()
