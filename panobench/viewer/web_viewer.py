"""A run in the browser, through viser: path, camera, map and frame while it runs, and its Gaussians at the end."""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

from panobench.bench.records.runfolder import MAP, TRAJECTORY
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_io import read_tum
from panobench.errors import OutputError
from panobench.geometry import matrix_from_quaternion, quaternion_from_matrix
from panobench.hookspecs import hookimpl
from panobench.methods.base import OnlineMethod
from panobench.splat.gaussians import GaussianMap
from panobench.splat.ply import read_ply
from panobench.types import Frame
from panobench.viewer.pictures import MAX_POINTS, PERIOD, bytes_of, shrunk, small_camera

Array = NDArray[np.float64]
PORT = 8080


def _quiet() -> contextlib.redirect_stdout[io.StringIO]:
    """viser greets on standard output, which belongs to results."""
    return contextlib.redirect_stdout(io.StringIO())


class WebViewer:
    """Implements the lifecycle hooks. host: the address that is listened on; port: this one, or the next free one.

    url: where the page is.
    """

    def __init__(self, host: str = "localhost", port: int = PORT) -> None:
        """Raises OutputError when nothing can be served there."""
        try:
            with _quiet():
                self.server = viser.ViserServer(host=host, port=port, label="panobench", verbose=False)
        except OSError as error:
            raise OutputError(f"--viewer web: {host}:{port} cannot be listened on ({error})") from error
        self.url = f"http://{host}:{self.server.get_port()}"
        self.server.scene.set_up_direction("-y")  # world axes are those of the first camera: x right, y down
        self.state = self.server.gui.add_markdown("Waiting for the run.")
        blank = np.zeros((2, 4, 3), np.uint8)
        self.frame = self.server.gui.add_image(blank, label="Frame")
        self.render = self.server.gui.add_image(blank, label="Render")
        print(f"panobench: watch the run at {self.url}", file=sys.stderr)

    def close(self) -> None:
        """Nothing is served any more. Where somebody is at the terminal, not before they say so."""
        if sys.stdin is not None and sys.stdin.isatty() and sys.stderr.isatty():
            print(f"panobench: the run stays at {self.url}; Ctrl-C ends that", file=sys.stderr)
            with contextlib.suppress(KeyboardInterrupt):
                self.server.sleep_forever()
        with _quiet():
            self.server.stop()

    @hookimpl
    def run_started(self, spec: dict[str, Any], sequence: FrameSequence) -> None:
        self.camera = small_camera(sequence.camera)
        self.positions: list[Array] = []
        self.about = f"**{spec['method']}** on {sequence.name}"
        self.frames = len(sequence)

    @hookimpl
    def frame_done(self, frame: Frame, T_wc: Array | None, latency_s: float, method: OnlineMethod) -> None:
        self.state.content = f"{self.about}: frame {frame.index + 1} of {self.frames}, {1e3 * latency_s:.0f} ms"
        if frame.index % PERIOD == 0:
            self.frame.image = shrunk(frame.image, self.camera)
        if T_wc is None:
            return
        if not self.positions:
            self._look_from(T_wc)
        self.positions.append(T_wc[:3, 3].copy())
        self._show_camera(T_wc)
        if frame.index % PERIOD:
            return
        self._show_path(np.array(self.positions), (60, 120, 255))
        live = method.live_map()
        if live is None:
            return
        step = -(-len(live.points) // MAX_POINTS)
        self.server.scene.add_point_cloud(
            "/map", live.points[::step].astype(np.float32), bytes_of(live.colours[::step]), point_size=0.01
        )
        render = method.render(self.camera, T_wc)
        if render is not None:
            self.render.image = bytes_of(render)

    @hookimpl
    def run_finished(self, folder: Path, run: dict[str, Any]) -> None:
        self.state.content = f"{self.about}: {run['status']}"
        trajectory, gaussians = folder / TRAJECTORY, folder / MAP
        if trajectory.is_file() and trajectory.stat().st_size:
            self._show_path(read_tum(trajectory).positions, (255, 210, 60))
        if gaussians.is_file():
            self.server.scene.remove_by_name("/map")
            self._show_map(GaussianMap(*read_ply(gaussians)))

    def _look_from(self, T_wc: Array) -> None:
        """Browsers that come begin where the run began, a step back."""
        down, ahead, here = T_wc[:3, 1], T_wc[:3, 2], T_wc[:3, 3]
        self.server.initial_camera.position = here - 0.3 * ahead - 0.15 * down
        self.server.initial_camera.look_at = here + ahead

    def _show_camera(self, T_wc: Array) -> None:
        self.server.scene.add_camera_frustum(
            "/camera",
            fov=1.2,
            aspect=1.6,
            scale=0.12,
            thickness=2.0,
            thickness_units="screen",
            color=(255, 160, 0),
            wxyz=quaternion_from_matrix(T_wc[:3, :3]),
            position=T_wc[:3, 3],
        )

    def _show_path(self, positions: Array, colour: tuple[int, int, int]) -> None:
        if len(positions) > 1:
            pieces = np.stack([positions[:-1], positions[1:]], axis=1).astype(np.float32)
            self.server.scene.add_line_segments("/path", pieces, colors=colour, thickness=2.0, thickness_units="screen")

    def _show_map(self, gaussians: GaussianMap) -> None:
        R = matrix_from_quaternion(gaussians.quats) * np.exp(gaussians.log_scales.astype(np.float64))[:, None, :]
        alpha = 1.0 / (1.0 + np.exp(-gaussians.opacity_logits.astype(np.float64)))
        self.server.scene.add_gaussian_splats(
            "/map",
            centers=gaussians.means,
            covariances=(R @ R.transpose(0, 2, 1)).astype(np.float32),
            rgbs=np.clip(gaussians.colours, 0.0, 1.0),
            opacities=alpha[:, None].astype(np.float32),
        )
