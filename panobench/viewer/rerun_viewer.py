"""A run in the Rerun viewer: trajectory, truth, keyframes, map, and the frame against what the map shows there."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from panobench.bench.records.runfolder import MAP, TRAJECTORY
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_io import read_tum
from panobench.errors import OutputError
from panobench.geometry import umeyama
from panobench.hookspecs import hookimpl
from panobench.methods.base import OnlineMethod
from panobench.splat.gaussians import GaussianMap
from panobench.splat.ply import read_ply
from panobench.types import Frame, Trajectory
from panobench.viewer.layout import blueprint
from panobench.viewer.pictures import MAX_POINTS, PERIOD, bytes_of, shrunk, small_camera
from panobench.viewer.scene import log_camera, log_map

Array = NDArray[np.float64]


class RerunViewer:
    """Implements the lifecycle hooks; ``file`` None opens a window.

    Entities: world/trajectory, world/truth (moved onto the trajectory by a similarity), world/camera, world/keyframes,
    world/map, images/frame, images/render, plots/latency_ms, plots/error_mm; timeline "frame". At the end
    world/final/trajectory and world/final/map, the Gaussians as ellipsoids: what was stored, after all corrections.
    """

    def __init__(self, file: Path | None) -> None:
        """Raises OutputError when the file cannot be written or the window not opened."""
        self.stream = rr.RecordingStream("panobench")
        try:
            if file is None:
                self.stream.spawn(default_blueprint=blueprint())
            else:
                self.stream.save(str(file), default_blueprint=blueprint())
        except Exception as error:  # Rerun raises RuntimeError and others
            raise OutputError(f"--viewer rerun: {' '.join(str(error).split())}") from error

    def close(self) -> None:
        """Everything is written."""
        self.stream.disconnect()

    @hookimpl
    def run_started(self, spec: dict[str, Any], sequence: FrameSequence) -> None:
        self.camera, self.truth = small_camera(sequence.camera), sequence.groundtruth
        self.positions: list[Array] = []
        self.times: list[float] = []
        self.keyframes = 0
        self.stream.send_recording_name(f"{spec['method']} on {sequence.name}")
        # World axes are those of the first camera: x right, y down.
        self.stream.log("world", rr.ViewCoordinates.RDF, static=True)

    @hookimpl
    def frame_done(self, frame: Frame, T_wc: Array | None, latency_s: float, method: OnlineMethod) -> None:
        self.stream.set_time("frame", sequence=frame.index)
        self.stream.log("plots/latency_ms", rr.Scalars(1e3 * latency_s))
        self.stream.log("images/frame", rr.Image(shrunk(frame.image, self.camera)).compress())
        if T_wc is not None:
            self._pose(frame.time, T_wc)
        live = method.live_map()
        grown = live is not None and len(live.keyframes) != self.keyframes
        if T_wc is None or live is None or not (grown or frame.index % PERIOD == 0):
            return
        step = -(-len(live.points) // MAX_POINTS)
        points, colours = live.points[::step], live.colours[::step]
        self.stream.log("world/map", rr.Points3D(points, colors=bytes_of(colours), radii=rr.Radius.ui_points(2.0)))
        self.keyframes = len(live.keyframes)
        centres = live.keyframes[:, :3, 3]
        self.stream.log("world/keyframes", rr.Points3D(centres, colors=(255, 160, 0), radii=rr.Radius.ui_points(5.0)))
        render = method.render(self.camera, T_wc)
        if render is not None:
            self.stream.log("images/render", rr.Image(bytes_of(render)).compress())
        self._show_truth()

    @hookimpl
    def run_finished(self, folder: Path, run: dict[str, Any]) -> None:
        self.stream.log("log", rr.TextLog(f"{run['status']}: {folder.name}"))
        trajectory, gaussians = folder / TRAJECTORY, folder / MAP
        if trajectory.is_file() and trajectory.stat().st_size:
            path = read_tum(trajectory).positions
            self.stream.log("world/final/trajectory", rr.LineStrips3D([path], colors=(255, 210, 60)))
        if gaussians.is_file():
            self.stream.log("world/map", rr.Clear(recursive=False))  # the points give way to the ellipsoids
            log_map(self.stream, GaussianMap(*read_ply(gaussians)), "world/final/map", static=False)

    def _pose(self, time: float, T_wc: Array) -> None:
        self.positions.append(T_wc[:3, 3].copy())
        self.times.append(time)
        log_camera(self.stream, T_wc, self.camera)
        self.stream.log("world/trajectory", rr.LineStrips3D([np.array(self.positions)], colors=(60, 120, 255)))

    def _show_truth(self) -> None:
        """The truth so far, aligned to the estimate; what comes later is not shown before it was seen."""
        pairs = _pairs(self.truth, self.times, self.positions)
        if len(pairs) < 3:
            return
        estimated, true = pairs[:, 0], pairs[:, 1]
        moved = umeyama(true, estimated).apply_points(true)
        self.stream.log("world/truth", rr.LineStrips3D([moved], colors=(40, 170, 90)))
        there = umeyama(estimated, true).apply_points(estimated)
        self.stream.log("plots/error_mm", rr.Scalars(1e3 * float(np.sqrt(((there - true) ** 2).sum(1).mean()))))


def _pairs(truth: Trajectory | None, times: list[float], positions: list[Array]) -> Array:
    """(K, 2, 3): estimated and true position of the frames that have both."""
    if truth is None:
        return np.empty((0, 2, 3))
    true = dict(zip(truth.times.tolist(), truth.positions))
    return np.array([(p, true[t]) for t, p in zip(times, positions) if t in true]).reshape(-1, 2, 3)
