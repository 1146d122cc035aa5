"""The original MonoGS: a TUM RGB-D folder and a YAML file in, the poses of all frames out; needs CUDA.

MonoGS's reader wants depth and true poses even for monocular runs. It gets images of zeros and a made-up helix: neither
is used by monocular tracking or mapping, and the helix keeps its own evaluation from dividing by zero. MonoGS writes
keyframe poses only; ``export_all.py`` starts it and writes down the poses of all frames when its evaluation is called.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import yaml

from panobench import FrameSequence, MethodContext
from panobench.external import (
    ExternalConfig,
    ExternalMethod,
    Finding,
    Job,
    TrajectoryFormat,
    opencv_pinhole,
    write_images,
)

HOME = "PANOBENCH_MONOGS_HOME"
BASE_CONFIG = "configs/mono/tum/base_config.yaml"
INTERVAL_S = 0.1  # between frames, as MonoGS sees them: its reader skips frames that come faster than 32 per second


@dataclass(frozen=True)
class MonoGsConfig(ExternalConfig):
    """home: MonoGS's folder ("": the variable PANOBENCH_MONOGS_HOME). All other settings are its own."""

    home: str = ""


class MonoGs(ExternalMethod):
    """``python export_all.py HOME CONFIG OUT`` starts MonoGS's slam.py; final poses of all frames."""

    title: ClassVar[str] = "MonoGS"
    program: ClassVar[str] = "python"
    variable: ClassVar[str] = "PANOBENCH_MONOGS"
    config_class: ClassVar[type[ExternalConfig]] = MonoGsConfig
    config: MonoGsConfig

    def home(self) -> str:
        return self.config.home or os.environ.get(HOME, "")

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        method = cls(config)
        if not method.home():
            return f"MonoGS is not there: name its folder in {HOME}"
        contained = method.place().kind in ("docker", "apptainer")
        if not contained and not (Path(method.home()) / "slam.py").is_file():
            return f"{method.home()} is not MonoGS's folder: it has no slam.py"
        return super().missing(config)

    @classmethod
    def diagnose(cls) -> list[Finding]:
        home = cls().home()
        there = bool(home) and (Path(home) / "slam.py").is_file()
        found = Finding(there, "MonoGS's folder", home or "not named", f"export {HOME}=/path/to/MonoGS")
        return [found, *super().diagnose()]

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        import cv2

        work, camera = context.work, sequence.camera
        p = opencv_pinhole(camera, "MonoGS")
        data = work / "sequences" / "panobench" / "run"  # MonoGS names its results after the last folders
        names = write_images(sequence, data / "rgb").names
        (data / "depth").mkdir()
        cv2.imwrite(str(data / "depth" / "zero.png"), np.zeros((camera.height, camera.width), np.uint16))
        times = [f"{i * INTERVAL_S:.6f}" for i in range(len(sequence))]
        (data / "rgb.txt").write_text("".join(f"{t} rgb/{name}\n" for t, name in zip(times, names)))
        (data / "depth.txt").write_text("".join(f"{t} depth/zero.png\n" for t in times))
        (data / "groundtruth.txt").write_text("# made up, not the truth\n" + "".join(_helix(times)))
        (work / "monogs.yaml").write_text(yaml.safe_dump(self._settings(sequence, p, data, work), sort_keys=False))
        script = work / "export_all.py"  # a copy, so that containers see it too
        script.write_text((Path(__file__).parent / "export_all.py").read_text())
        home = self.home()
        return Job(
            [str(script), home, str(work / "monogs.yaml"), str(work / "all.tum")],
            work / "all.tum",
            TrajectoryFormat("tum", index_rate=1 / INTERVAL_S),
            reads=(Path(home),) if self.place().kind == "local" else (),
            cwd=work,
            environment={"WANDB_MODE": "disabled", "MPLBACKEND": "Agg"},
            keyframes=work / "keyframes.tum",
        )

    def _settings(self, sequence: FrameSequence, p: Any, data: Path, work: Path) -> dict[str, Any]:
        k1, k2, p1, p2, k3 = (float(x) for x in p.distortion)
        calibration = {key: float(getattr(p, key)) for key in ("fx", "fy", "cx", "cy")}
        calibration |= {"k1": k1, "k2": k2, "p1": p1, "p2": p2, "k3": k3}
        size = {"width": sequence.camera.width, "height": sequence.camera.height}
        return {
            "inherit_from": str(Path(self.home()) / BASE_CONFIG),
            "Results": {"save_results": True, "save_dir": str(work / "results"), "save_trj": True, "use_gui": False}
            | {"eval_rendering": False, "use_wandb": False},
            "Dataset": {
                "type": "tum",
                "sensor_type": "monocular",
                "dataset_path": str(data),
                "Calibration": {**calibration, **size, "depth_scale": 5000.0, "distorted": any(p.distortion)},
            },
        }


def _helix(times: list[str]) -> list[str]:
    """TUM rows that start at the identity and are in no plane."""
    rows = []
    for i, t in enumerate(times):
        a = 0.3 * i
        rows.append(f"{t} {np.sin(a):.6f} {1 - np.cos(a):.6f} {0.05 * i:.6f} 0 0 0 1\n")
    return rows


def missing() -> str | None:
    """For the probe."""
    return MonoGs.missing()
