"""ORB-SLAM3 through the package pyorbslam3, in a process of its own: the library ends a process when it gives up."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from panobench import FrameSequence, Imu, MethodContext, UnsupportedError, option
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
    sample_noise,
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
        return self._job(sequence, context.work, {}, None)

    def _job(
        self, sequence: FrameSequence, work: Path, further: dict[str, Any], T_body_cam: NDArray[np.float64] | None
    ) -> Job:
        """Write the inputs and say how to run. T_body_cam: with an IMU, whose poses the answer then has."""
        vocabulary = self.write_inputs(sequence, work, work / "images", further)
        script = copy_script(Path(__file__).parent / "track.py", work)
        return Job(
            [str(script), str(vocabulary), str(work), repr(float(self.config.pace))],
            work / "frames.txt",
            TrajectoryFormat("tum-ns", T_body_camera=T_body_cam),
            reads=(vocabulary,),
            keyframes=work / "keyframes.txt",
            frame_seconds=work / "track_times.txt",
            silent_when_lost=True,
        )


@dataclass(frozen=True)
class OrbSlam3InertialConfig(OrbSlam3Config):
    """Noise of the IMU. ORB-SLAM3 takes densities."""

    gyro_noise: float | None = option(
        None, "noise of the gyroscope; none: estimated from the samples", unit="rad/s/sqrt(Hz)", above=0
    )
    accel_noise: float | None = option(
        None, "noise of the accelerometer; none: estimated from the samples", unit="m/s^2/sqrt(Hz)", above=0
    )
    gyro_walk: float = option(1.9e-5, "random walk of the gyroscope's bias", unit="rad/s^2/sqrt(Hz)", above=0)
    accel_walk: float = option(3.0e-3, "random walk of the accelerometer's bias", unit="m/s^3/sqrt(Hz)", above=0)


class OrbSlam3Inertial(OrbSlam3):
    """Monocular with IMU, metric scale. The poses it saves are the body's."""

    title: ClassVar[str] = "ORB-SLAM3 with IMU"
    metric: ClassVar[bool] = True
    config_class: ClassVar[type[ExternalConfig]] = OrbSlam3InertialConfig
    config: OrbSlam3InertialConfig

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        imu = context.imu
        if imu is None:
            raise UnsupportedError("ORB-SLAM3 with IMU needs inertial samples; this sequence has none")
        T_body_cam = np.eye(4) if imu.T_body_cam is None else imu.T_body_cam
        rows = np.column_stack([imu.times, imu.gyro, imu.accel])
        (context.work / "imu.txt").write_text("".join(" ".join(f"{v:.9f}" for v in row) + "\n" for row in rows))
        return self._job(sequence, context.work, self.imu_settings(imu, T_body_cam), T_body_cam)

    def imu_settings(self, imu: Imu, T_body_cam: NDArray[np.float64]) -> dict[str, Any]:
        """The IMU's keys. Its matrix is read as single precision whatever the file says: it must be written so."""
        rate = 1 / float(np.median(np.diff(imu.times)))
        config = self.config
        return {
            "IMU.T_b_c1": T_body_cam.astype(np.float32),
            "IMU.InsertKFsWhenLost": 0,
            "IMU.NoiseGyro": config.gyro_noise or sample_noise(imu.gyro, floor=1e-4) / rate**0.5,
            "IMU.NoiseAcc": config.accel_noise or sample_noise(imu.accel, floor=1e-3) / rate**0.5,
            "IMU.GyroWalk": config.gyro_walk,
            "IMU.AccWalk": config.accel_walk,
            "IMU.Frequency": rate,
        }


def _core(place: Place) -> Path | None:
    """The compiled module of pyorbslam3 in this or the named environment, None where it cannot be seen."""
    folder = find_package(place, OrbSlam3.package) if place.kind in ("local", "venv") else None
    cores = sorted(folder.glob("_core*.so")) if folder is not None else []
    return cores[0] if cores else None
