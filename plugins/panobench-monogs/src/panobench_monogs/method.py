"""The original MonoGS: a TUM RGB-D folder and a YAML file in; the poses of all frames and the map out. It needs CUDA.

MonoGS's reader wants depth and true poses even for monocular runs. It gets a depth image of zeros, and the identity
as every pose: a monocular run uses the pose at which a map starts, and nothing else of them. MonoGS stores keyframe
poses only: ``export_all.py`` starts it, and writes the poses of all frames and the map.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import yaml
from numpy.typing import NDArray

from panobench import Camera, Estimate, FrameSequence, MethodContext, option
from panobench.external import (
    ExternalConfig,
    ExternalMethod,
    Finding,
    Job,
    OpenCvPinhole,
    StoredMap,
    TrajectoryFormat,
    copy_script,
    intrinsics,
    opencv_pinhole,
    read_stored_map,
    write_images,
)

HOME = "PANOBENCH_MONOGS_HOME"
BASE_CONFIG = "configs/mono/tum/base_config.yaml"
#: Seconds between two frames as MonoGS sees them. Its reader skips frames that come faster than 32 per second.
INTERVAL_S = 0.1


@dataclass(frozen=True)
class MonoGsConfig(ExternalConfig):
    """MonoGS. All other settings are its own."""

    home: str = option("", "MonoGS's folder; empty: the variable PANOBENCH_MONOGS_HOME")
    single_thread: bool = option(False, "map only when there is a keyframe, instead of all the time beside tracking")


class MonoGs(ExternalMethod):
    """``python export_all.py HOME CONFIG FOLDER`` starts MonoGS's slam.py. Final poses of the last map's frames."""

    title: ClassVar[str] = "MonoGS"
    program: ClassVar[str] = "python"
    variable: ClassVar[str] = "PANOBENCH_MONOGS"
    config_class: ClassVar[type[ExternalConfig]] = MonoGsConfig
    config: MonoGsConfig

    _map: StoredMap | None = None

    def home(self) -> str:
        """MonoGS's folder, empty if none is named."""
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
        (data / "groundtruth.txt").write_text("# not the truth\n" + "".join(f"{t} 0 0 0 0 0 0 1\n" for t in times))
        (work / "monogs.yaml").write_text(yaml.safe_dump(self._settings(sequence, p, data, work), sort_keys=False))
        script = copy_script(Path(__file__).parent / "export_all.py", work)
        home = self.home()
        return Job(
            [str(script), home, str(work / "monogs.yaml"), str(work)],
            work / "all.tum",
            TrajectoryFormat("tum", index_rate=1 / INTERVAL_S),
            reads=(Path(home),) if self.place().kind == "local" else (),
            cwd=work,
            environment={"WANDB_MODE": "disabled", "MPLBACKEND": "Agg"},
            keyframes=work / "keyframes.tum",
        )

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """As the base class, with MonoGS's final map."""
        self._map = None
        estimate = super().run(sequence, context)
        path = context.work / "map.ply"
        if path.exists():
            self._map = estimate.map = read_stored_map(path)
        return estimate

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.float32] | None:
        """The map seen by panobench's renderer, which projects to first order as MonoGS's does."""
        return None if self._map is None else self._map.render(camera, T_wc)

    def _settings(self, sequence: FrameSequence, p: OpenCvPinhole, data: Path, work: Path) -> dict[str, Any]:
        k1, k2, p1, p2, k3 = (float(x) for x in p.distortion)
        calibration = {**intrinsics(p), "k1": k1, "k2": k2, "p1": p1, "p2": p2, "k3": k3}
        size = {"width": sequence.camera.width, "height": sequence.camera.height}
        threads = {"single_thread": self.config.single_thread}  # the front end reads one section, the back end another
        return {
            "inherit_from": str(Path(self.home()) / BASE_CONFIG),
            "Results": {
                "save_results": True,
                "save_dir": str(work / "results"),
                "save_trj": False,  # its own evaluation, every few keyframes
                "use_gui": False,
                "eval_rendering": False,
                "use_wandb": False,
            },
            "Training": threads,
            "Dataset": {
                "type": "tum",
                "sensor_type": "monocular",
                "dataset_path": str(data),
                # without depth_scale no depth image is read
                "Calibration": {**calibration, **size, "distorted": any(p.distortion)},
                **threads,
            },
        }
