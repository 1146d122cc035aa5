"""COLMAP through pycolmap 4, in a process of its own. The intrinsics are given and are not refined."""

from __future__ import annotations

import importlib.metadata
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from panobench import Camera, Estimate, FrameSequence, MethodContext, UnsupportedError, option
from panobench.external import (
    ExternalConfig,
    Job,
    Place,
    PythonPackageMethod,
    copy_script,
    write_images,
    write_mask,
)


@dataclass(frozen=True)
class ColmapConfig(ExternalConfig):
    """Matching and features."""

    matcher: Literal["sequential", "exhaustive"] = option(
        "sequential", "which images are matched: each with the next ones, or all pairs"
    )
    overlap: int = option(10, "images that each image is matched with (sequential)", above=0)
    features: int = option(4096, "SIFT features per image", above=0)
    threads: int = option(0, "threads; 0: as many as there are cores")


def colmap_camera(camera: Camera) -> tuple[str, list[float]]:
    """COLMAP's model name and parameters. Pixel centres are at k + 0.5 in both. Raises UnsupportedError."""
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


class Colmap(PythonPackageMethod):
    """Images in, the poses of the largest reconstruction out, up to scale."""

    title: ClassVar[str] = "COLMAP"
    variable: ClassVar[str] = "PANOBENCH_COLMAP"
    package: ClassVar[str] = "pycolmap"
    install: ClassVar[str] = 'pip install "pycolmap>=4", or PANOBENCH_COLMAP_RUN_IN=venv:FOLDER'
    config_class: ClassVar[type[ExternalConfig]] = ColmapConfig
    config: ColmapConfig

    @classmethod
    def package_problem(cls, place: Place) -> str | None:
        """As the base class; the version is checked where it can be seen, in panobench's own environment."""
        problem = super().package_problem(place)
        if problem is not None or place.kind != "local":
            return problem
        version = importlib.metadata.version("pycolmap")
        if int(version.split(".")[0]) >= 4:
            return None
        return f"pycolmap {version} has no equirectangular camera; {cls.install}"

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        model, parameters = colmap_camera(sequence.camera)
        images = write_images(sequence, work / "images")
        job: dict[str, Any] = {
            "images": images.names,
            "times": [float(t) for t in sequence.times],
            "model": model,
            "parameters": parameters,
            "mask": write_mask(sequence.camera, work / "mask.png"),
            "matcher": self.config.matcher,
            "overlap": self.config.overlap,
            "features": self.config.features,
            "threads": self.config.threads or -1,
            "seed": context.seed,
        }
        (work / "job.json").write_text(json.dumps(job))
        script = copy_script(Path(__file__).parent / "reconstruct.py", work)
        return Job([str(script), str(work)], work / "trajectory.tum", silent_when_lost=True)

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """As the base class; the figures of the reconstruction are added to ``extra``."""
        estimate = super().run(sequence, context)
        summary = context.work / "summary.json"
        if summary.exists():
            estimate.extra["colmap"] = json.loads(summary.read_text())
        return estimate
