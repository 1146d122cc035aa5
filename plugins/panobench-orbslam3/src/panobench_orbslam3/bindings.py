"""ORB-SLAM3 through the package pyorbslam3, in a process of its own: it ends processes it does not like."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import ClassVar

from panobench import Estimate, FrameSequence, MethodContext
from panobench.external import (
    VOCABULARY_VARIABLE,
    ExternalConfig,
    ExternalMethod,
    Finding,
    Job,
    Place,
    TrajectoryFormat,
    find_vocabulary,
    frame_rate,
    missing_libraries,
    named_vocabulary,
    nanoseconds,
    opencv_yaml,
    write_images,
)
from panobench_orbslam3.settings import OrbSlam3Config, seen, settings

_FIX = 'pip install "pyorbslam3==0.1.1" (CPython 3.9 to 3.13, x86-64 Linux), or PANOBENCH_ORBSLAM3_RUN_IN=venv:FOLDER'


class OrbSlam3(ExternalMethod):
    """Monocular. Final poses: every tracked frame relative to its keyframe after all optimisation."""

    title: ClassVar[str] = "ORB-SLAM3"
    program: ClassVar[str] = "python"
    variable: ClassVar[str] = "PANOBENCH_ORBSLAM3"
    config_class: ClassVar[type[ExternalConfig]] = OrbSlam3Config
    config: OrbSlam3Config

    def command(self) -> str:
        named = super().command()
        return sys.executable if named == self.program and self.place().kind == "local" else named

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        reason = super().missing(config)
        if reason is not None:
            return reason
        place = cls(config).place()
        if place.kind in ("local", "venv") and cls(config).command() in (sys.executable, cls.program):
            core = _core(place)
            if core is None:
                return f"the package pyorbslam3 is not installed; {_FIX}"
            lacking = missing_libraries(core)
            if lacking:
                return f"pyorbslam3 needs the shared libraries {', '.join(lacking)} (see panobench doctor orbslam3)"
        return None

    @classmethod
    def diagnose(cls) -> list[Finding]:
        found = super().diagnose()
        place = cls().place()
        if place.kind in ("local", "venv"):
            core = _core(place)
            found.append(Finding(core is not None, "pyorbslam3", str(core) if core else "not installed", _FIX))
            if core is not None:
                lacking = missing_libraries(core)
                detail = f"needs {', '.join(lacking)}" if lacking else "all found"
                fix = "apt install libgl1 libegl1 libopengl0 libsm6 libice6 libx11-6 libxext6"
                found.append(Finding(not lacking, "its shared libraries", detail, fix))
        named = named_vocabulary("")
        detail = (
            str(named) if named else f"none named in {VOCABULARY_VARIABLE}: one will be trained on built-in rooms, once"
        )
        return [*found, Finding(True, "vocabulary", detail)]

    def set_up(self, sequence: FrameSequence, context: MethodContext) -> None:
        """A vocabulary that must be trained first is trained once, outside the run's own time."""
        find_vocabulary(self.config.vocabulary, sequence, context.log)

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """As the base class; the seconds of each call of its tracker join the frames."""
        estimate = super().run(sequence, context)
        times = context.work / "track_times.txt"
        seconds = [float(line) for line in times.read_text().split()] if times.exists() else []
        if len(seconds) == len(sequence):
            estimate.frames = {i: {"program_tracking_s": s} for i, s in enumerate(seconds)}
        return estimate

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        vocabulary = find_vocabulary(self.config.vocabulary, sequence)
        values = settings(sequence.camera, frame_rate(sequence.times), self.config)
        (work / "settings.yaml").write_text(opencv_yaml(values))
        stamps = nanoseconds(sequence.times)
        write_images(sequence, work / "images", grey=True, names=stamps, keep=seen(sequence.camera))
        (work / "times.txt").write_text("\n".join(stamps) + "\n")
        script = work / "track.py"  # a copy, so that containers see it too
        script.write_text((Path(__file__).parent / "track.py").read_text())
        arguments = [str(script), str(vocabulary), str(work), repr(float(self.config.pace))]
        return Job(
            arguments,
            work / "frames.txt",
            TrajectoryFormat("tum-ns"),
            reads=(vocabulary,),
            keyframes=work / "keyframes.txt",
            silent_when_lost=True,
        )


def missing() -> str | None:
    """For the probe."""
    return OrbSlam3.missing()


def _core(place: Place) -> Path | None:
    """The compiled module of pyorbslam3 in this or the named environment."""
    if place.kind == "venv":
        folders = sorted(Path(place.target).glob("lib/python3*/site-packages/pyorbslam3"))
    else:
        spec = importlib.util.find_spec("pyorbslam3")
        folders = [Path(p) for p in (spec.submodule_search_locations or ())] if spec else []
    cores = [core for folder in folders for core in sorted(folder.glob("_core*.so"))]
    return cores[0] if cores else None
