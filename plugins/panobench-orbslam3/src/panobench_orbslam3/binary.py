"""ORB-SLAM3 through its example program mono_euroc: EuRoC folders in, trajectory in EuRoC's time unit out."""

from __future__ import annotations

from typing import ClassVar

from panobench import FrameSequence, MethodContext
from panobench.external import (
    ExternalConfig,
    ExternalMethod,
    Job,
    TrajectoryFormat,
    find_vocabulary,
    frame_rate,
    nanoseconds,
    opencv_yaml,
    write_images,
)
from panobench_orbslam3.settings import OrbSlam3Config, seen, settings


class OrbSlam3Binary(ExternalMethod):
    """``mono_euroc VOCABULARY SETTINGS SEQUENCE TIMES NAME`` writes f_NAME.txt and kf_NAME.txt where it runs."""

    title: ClassVar[str] = "ORB-SLAM3 (mono_euroc)"
    program: ClassVar[str] = "mono_euroc"
    variable: ClassVar[str] = "PANOBENCH_ORBSLAM3_BINARY"
    config_class: ClassVar[type[ExternalConfig]] = OrbSlam3Config
    config: OrbSlam3Config

    def set_up(self, sequence: FrameSequence, context: MethodContext) -> None:
        """A vocabulary that must be trained first is trained once, outside the run's own time."""
        find_vocabulary(self.config.vocabulary, sequence, context.log)

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        vocabulary = find_vocabulary(self.config.vocabulary, sequence)
        values = settings(sequence.camera, frame_rate(sequence.times), self.config)
        (work / "settings.yaml").write_text(opencv_yaml(values))
        stamps = nanoseconds(sequence.times)
        write_images(
            sequence, work / "sequence" / "mav0" / "cam0" / "data", grey=True, names=stamps, keep=seen(sequence.camera)
        )
        (work / "times.txt").write_text("\n".join(stamps) + "\n")
        arguments = [vocabulary, work / "settings.yaml", work / "sequence", work / "times.txt", "run"]
        return Job(
            [str(a) for a in arguments],
            work / "f_run.txt",
            TrajectoryFormat("tum-ns"),
            reads=(vocabulary,),
            keyframes=work / "kf_run.txt",
        )


def missing() -> str | None:
    """For the probe."""
    return OrbSlam3Binary.missing()
