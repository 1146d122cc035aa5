"""P2U-SLAM by the interface its paper and repository describe: ORB-SLAM3's command line, a polynomial as camera.

No code is public at the time of writing. Everything here that is not ORB-SLAM3's is a guess that is kept in one place:
``PAL_TYPE``, ``pal_section`` and the names of the result files.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from panobench import Camera, FrameSequence, MethodContext, UnsupportedError
from panobench.external import (
    ExternalConfig,
    ExternalMethod,
    Job,
    TrajectoryFormat,
    find_vocabulary,
    frame_rate,
    nanoseconds,
    opencv_fisheye,
    opencv_pinhole,
    opencv_yaml,
    write_images,
    write_mask,
)

PAL_TYPE = "Taylor"


@dataclass(frozen=True)
class P2uSlamConfig(ExternalConfig):
    """vocabulary: a DBoW2 text file ("": PANOBENCH_ORB_VOCABULARY, else one is trained on built-in rooms)."""

    vocabulary: str = ""
    features: int = 1500


def pal_section(camera: Camera) -> dict[str, Any]:
    """The Taylor (OCamCalib) polynomial, its inverse and the affine part; first pixel's centre at 0."""
    v = camera.to_dict()
    values: dict[str, Any] = {"Camera.type": PAL_TYPE}
    values |= {f"Camera1.poly{i}": float(x) for i, x in enumerate(v["poly"])}
    values |= {f"Camera1.invpoly{i}": float(x) for i, x in enumerate(v["inv_poly"])}
    values |= {"Camera1.c": float(v["c"]), "Camera1.d": float(v["d"]), "Camera1.e": float(v["e"])}
    return values | {"Camera1.cx": float(v["cx"]) - 0.5, "Camera1.cy": float(v["cy"]) - 0.5}


def settings(camera: Camera, rate: float, features: int) -> dict[str, Any]:
    """The settings file. Raises UnsupportedError for a camera it has no model of."""
    if camera.kind == "pal":
        values = pal_section(camera)
    elif camera.kind == "fisheye":
        f = opencv_fisheye(camera)
        values = {"Camera.type": "KannalaBrandt8", **{f"Camera1.k{i + 1}": float(k) for i, k in enumerate(f.k)}}
        values |= {f"Camera1.{key}": float(getattr(f, key)) for key in ("fx", "fy", "cx", "cy")}
    elif camera.kind == "pinhole":
        p = opencv_pinhole(camera, "P2U-SLAM")
        values = {"Camera.type": "PinHole"}
        values |= {f"Camera1.{k}": float(x) for k, x in zip(("k1", "k2", "p1", "p2"), p.distortion)}
        values |= {f"Camera1.{key}": float(getattr(p, key)) for key in ("fx", "fy", "cx", "cy")}
    else:
        raise UnsupportedError(f"P2U-SLAM has no {camera.kind} camera; give --camera pal, fisheye or pinhole")
    return {
        "File.version": "1.0",
        **values,
        "Camera.width": camera.width,
        "Camera.height": camera.height,
        "Camera.fps": max(1, round(rate)),
        "Camera.RGB": 1,
        "ORBextractor.nFeatures": features,
        "ORBextractor.scaleFactor": 1.2,
        "ORBextractor.nLevels": 8,
        "ORBextractor.iniThFAST": 20,
        "ORBextractor.minThFAST": 7,
    }


class P2uSlam(ExternalMethod):
    """``PROGRAM VOCABULARY SETTINGS SEQUENCE TIMES NAME`` as ORB-SLAM3's mono_euroc, f_NAME.txt and kf_NAME.txt out."""

    title: ClassVar[str] = "P2U-SLAM"
    program: ClassVar[str] = "p2u_slam_mono"
    variable: ClassVar[str] = "PANOBENCH_P2U_SLAM"
    config_class: ClassVar[type[ExternalConfig]] = P2uSlamConfig
    config: P2uSlamConfig

    def set_up(self, sequence: FrameSequence, context: MethodContext) -> None:
        """A vocabulary that must be trained first is trained once, outside the run's own time."""
        find_vocabulary(self.config.vocabulary, sequence, context.log)

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        work = context.work
        values = settings(sequence.camera, frame_rate(sequence.times), self.config.features)
        if write_mask(sequence.camera, work / "mask.png"):
            values["Camera.mask"] = str(work / "mask.png")
        (work / "settings.yaml").write_text(opencv_yaml(values))
        vocabulary = find_vocabulary(self.config.vocabulary, sequence)
        stamps = nanoseconds(sequence.times)
        write_images(sequence, work / "sequence" / "mav0" / "cam0" / "data", grey=True, names=stamps)
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
    reason = P2uSlam.missing()
    return None if reason is None else f"no public code at present; {reason}"
