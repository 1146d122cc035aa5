"""ORB-SLAM3 through its example program mono_euroc: EuRoC folders in, trajectories with times in nanoseconds out."""

from __future__ import annotations

from typing import ClassVar

from panobench.external import MonoEurocMethod


class OrbSlam3Binary(MonoEurocMethod):
    """Monocular. It always waits for each frame's time, as the program does."""

    title: ClassVar[str] = "ORB-SLAM3 (mono_euroc)"
    program: ClassVar[str] = "mono_euroc"
    variable: ClassVar[str] = "PANOBENCH_ORBSLAM3_BINARY"
