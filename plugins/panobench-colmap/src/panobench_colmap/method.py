"""COLMAP through pycolmap 4, in a process of its own; the intrinsics are given and stay as they are."""

from __future__ import annotations

import importlib.metadata
import importlib.util
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from panobench import Camera, Estimate, FrameSequence, MethodContext, UnsupportedError
from panobench.external import ExternalConfig, ExternalMethod, Finding, Job, Place, write_images, write_mask

_FIX = 'pip install "pycolmap>=4", or PANOBENCH_COLMAP_RUN_IN=venv:FOLDER'


@dataclass(frozen=True)
class ColmapConfig(ExternalConfig):
    """matcher: "sequential" (each frame with the next ``overlap``) or "exhaustive". threads: 0 is all there are."""

    matcher: str = "sequential"
    overlap: int = 10
    features: int = 4096
    threads: int = 0


def colmap_camera(camera: Camera) -> tuple[str, list[float]]:
    """Model name and parameters; COLMAP's pixel centres are panobench's. Raises UnsupportedError."""
    v = camera.to_dict()
    if camera.kind == "erp":
        return "EQUIRECTANGULAR", [float(camera.width), float(camera.height)]
    if camera.kind == "fisheye":
        return "OPENCV_FISHEYE", [v["fx"], v["fy"], v["cx"], v["cy"], *v["k"]]
    if camera.kind == "pinhole":
        d = [float(x) for x in v.get("distortion", ())]
        if not any(d):
            return "PINHOLE", [v["fx"], v["fy"], v["cx"], v["cy"]]
        return "FULL_OPENCV", [v["fx"], v["fy"], v["cx"], v["cy"], *d, *([0.0] * (8 - len(d)))]
    raise UnsupportedError(f"COLMAP has no {camera.kind} camera; give --camera erp, pinhole or fisheye")


class Colmap(ExternalMethod):
    """Images in, the largest reconstruction's poses out, up to scale."""

    title: ClassVar[str] = "COLMAP"
    program: ClassVar[str] = "python"
    variable: ClassVar[str] = "PANOBENCH_COLMAP"
    config_class: ClassVar[type[ExternalConfig]] = ColmapConfig
    config: ColmapConfig

    def command(self) -> str:
        named = super().command()
        return sys.executable if named == self.program and self.place().kind == "local" else named

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        reason = super().missing(config)
        if reason is None and cls(config).command() in (sys.executable, cls.program):
            reason = _version_problem(cls(config).place())
        return reason

    @classmethod
    def diagnose(cls) -> list[Finding]:
        problem = _version_problem(cls().place())
        return [*super().diagnose(), Finding(problem is None, "pycolmap", problem or "4 or newer", _FIX)]

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        if self.config.matcher not in ("sequential", "exhaustive"):
            raise UnsupportedError(f"matcher '{self.config.matcher}': COLMAP is run with sequential or exhaustive")
        model, parameters = colmap_camera(sequence.camera)
        images = write_images(sequence, work / "images")
        masked = write_mask(sequence.camera, work / "mask.png")
        job: dict[str, Any] = {
            "images": images.names,
            "times": [float(t) for t in sequence.times],
            "model": model,
            "parameters": parameters,
            "mask": masked,
            "matcher": self.config.matcher,
            "overlap": self.config.overlap,
            "features": self.config.features,
            "threads": self.config.threads or -1,
            "seed": context.seed,
        }
        (work / "job.json").write_text(json.dumps(job))
        script = work / "reconstruct.py"  # a copy, so that containers see it too
        script.write_text((Path(__file__).parent / "reconstruct.py").read_text())
        return Job([str(script), str(work)], work / "trajectory.tum", silent_when_lost=True)

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """As the base class; the reconstruction's figures join ``extra``."""
        estimate = super().run(sequence, context)
        summary = context.work / "summary.json"
        if summary.exists():
            estimate.extra["colmap"] = json.loads(summary.read_text())
        return estimate


def _version_problem(place: Place) -> str | None:
    """None if pycolmap 4 is in this or the named virtual environment; other places are taken on trust."""
    if place.kind == "venv":
        there = list(Path(place.target).glob("lib/python3*/site-packages/pycolmap"))
        return None if there else f"pycolmap is not installed in {place.target}; {_FIX}"
    if place.kind != "local":
        return None
    if importlib.util.find_spec("pycolmap") is None:
        return f"the package pycolmap is not installed; {_FIX}"
    version = importlib.metadata.version("pycolmap")
    return None if int(version.split(".")[0]) >= 4 else f"pycolmap {version} has no equirectangular camera; {_FIX}"


def missing() -> str | None:
    """For the probe."""
    return Colmap.missing()
