"""360DVO through its own demo.py: a folder of panoramas in, a TUM file with the poses of all frames out. It needs CUDA.

Its camera has x right, y down, z ahead in the middle of the panorama, as panobench's; its times are numbers of frames.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from panobench import FrameSequence, MethodContext, UnsupportedError, option
from panobench.external import ExternalConfig, ExternalMethod, Finding, Job, TrajectoryFormat, write_images

HOME = "PANOBENCH_360DVO_HOME"
WEIGHTS, SETTINGS = "360dvo.pth", "config/360.yaml"
#: Rows and columns beyond a multiple of this are cut off, after which an image is no panorama any more.
STEP = 16


@dataclass(frozen=True)
class Dvo360Config(ExternalConfig):
    """360DVO. All other settings are its own."""

    home: str = option("", f"360DVO's folder; empty: the variable {HOME}")
    weights: str = option("", f"its network; empty: {WEIGHTS} in that folder")


class Dvo360(ExternalMethod):
    """``python HOME/demo.py --imagedir ... --save_trajectory``. Every frame is answered, keyframe or not."""

    title: ClassVar[str] = "360DVO"
    program: ClassVar[str] = "python"
    variable: ClassVar[str] = "PANOBENCH_360DVO"
    config_class: ClassVar[type[ExternalConfig]] = Dvo360Config
    config: Dvo360Config

    def home(self) -> str:
        """360DVO's folder, empty if none is named."""
        return self.config.home or os.environ.get(HOME, "")

    def weights(self) -> Path:
        """The file with its network."""
        return Path(self.config.weights) if self.config.weights else Path(self.home()) / WEIGHTS

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        method = cls(config)
        if not method.home():
            return f"360DVO is not there: name its folder in {HOME}"
        if method.place().kind not in ("docker", "apptainer"):
            if not (Path(method.home()) / "demo.py").is_file():
                return f"{method.home()} is not 360DVO's folder: it has no demo.py"
            if not method.weights().is_file():
                return f"360DVO's weights are not there: {method.weights()}; its README says where they are"
        return super().missing(config)

    @classmethod
    def diagnose(cls) -> list[Finding]:
        method = cls()
        home, weights = method.home(), method.weights()
        there = bool(home) and (Path(home) / "demo.py").is_file()
        found = [Finding(there, "360DVO's folder", home or "not named", f"export {HOME}=/path/to/360DVO")]
        if there:
            found.append(Finding(weights.is_file(), "weights", str(weights), "download them (360DVO's README)"))
        return [*found, *super().diagnose()]

    def files(self) -> list[Path]:
        """Python, and the network on which results depend."""
        return [*super().files(), *([self.weights()] if self.weights().is_file() else [])]

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        camera, work = sequence.camera, context.work
        if camera.kind != "erp":
            raise UnsupportedError(f"360DVO takes panoramas, not {camera.kind} images; give --camera erp")
        if camera.width != 2 * camera.height or camera.height % STEP:
            raise UnsupportedError(
                f"360DVO takes full panoramas whose height is a multiple of {STEP}, not {camera.width}x{camera.height}"
            )
        write_images(sequence, work / "images")
        home = Path(self.home())
        arguments = ["--imagedir", work / "images", "--network", self.weights(), "--config", home / SETTINGS]
        return Job(
            [str(home / "demo.py"), *map(str, arguments), "--save_trajectory", "--name", "run"],
            work / "saved_trajectories" / "run.txt",
            TrajectoryFormat("tum", index_rate=1.0),
            reads=(home, self.weights()) if self.place().kind == "local" else (),
            cwd=work,
            environment={"MPLBACKEND": "Agg"},
        )
