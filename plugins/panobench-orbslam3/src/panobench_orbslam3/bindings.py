"""ORB-SLAM3 through the package pyorbslam3, in a process of its own: the library ends a process when it gives up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from panobench import FrameSequence, MethodContext, option
from panobench.external import (
    ExternalConfig,
    Finding,
    Job,
    OrbSlamConfig,
    OrbSlamMethod,
    Place,
    PythonPackageMethod,
    TrajectoryFormat,
    copy_script,
    find_package,
    library_finding,
    missing_libraries,
)

_LIBRARIES = "apt install libgl1 libegl1 libopengl0 libsm6 libice6 libx11-6 libxext6"


@dataclass(frozen=True)
class OrbSlam3Config(OrbSlamConfig):
    """Pace."""

    pace: float = option(
        1.0, "1 waits for each frame's time, as ORB-SLAM3's programs do; 2 takes twice as long; 0 does not wait"
    )


class OrbSlam3(PythonPackageMethod, OrbSlamMethod):
    """Monocular. Final poses: every tracked frame relative to its keyframe, after all optimisation."""

    title: ClassVar[str] = "ORB-SLAM3"
    variable: ClassVar[str] = "PANOBENCH_ORBSLAM3"
    package: ClassVar[str] = "pyorbslam3"
    install: ClassVar[str] = (
        'pip install "pyorbslam3==0.1.1" (CPython 3.9 to 3.13, x86-64 Linux), or PANOBENCH_ORBSLAM3_RUN_IN=venv:FOLDER'
    )
    config_class: ClassVar[type[ExternalConfig]] = OrbSlam3Config
    config: OrbSlam3Config

    @classmethod
    def package_problem(cls, place: Place) -> str | None:
        problem, core = super().package_problem(place), _core(place)
        if problem is None and core is not None and (lacking := missing_libraries(core)):
            return f"pyorbslam3 needs the shared libraries {', '.join(lacking)} (see panobench doctor orbslam3)"
        return problem

    @classmethod
    def diagnose(cls) -> list[Finding]:
        found, core = super().diagnose(), _core(cls().place())
        return found if core is None else [*found, library_finding("its shared libraries", core, _LIBRARIES)]

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        vocabulary = self.write_inputs(sequence, work, work / "images")
        script = copy_script(Path(__file__).parent / "track.py", work)
        return Job(
            [str(script), str(vocabulary), str(work), repr(float(self.config.pace))],
            work / "frames.txt",
            TrajectoryFormat("tum-ns"),
            reads=(vocabulary,),
            keyframes=work / "keyframes.txt",
            frame_seconds=work / "track_times.txt",
            silent_when_lost=True,
        )


def _core(place: Place) -> Path | None:
    """The compiled module of pyorbslam3 in this or the named environment, None where it cannot be seen."""
    folder = find_package(place, OrbSlam3.package) if place.kind in ("local", "venv") else None
    cores = sorted(folder.glob("_core*.so")) if folder is not None else []
    return cores[0] if cores else None
