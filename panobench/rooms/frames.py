"""The frames of one sequence: poses, depth, images with their disturbances, and the image files of the cache."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.factory import upright_rotation
from panobench.geometry import make_pose
from panobench.rooms import effects, render
from panobench.rooms.options import RoomOptions
from panobench.rooms.world import World

Array = NDArray[np.float64]


class FrameRenderer:
    """Renders the frames of one room seen by one camera. Everything expensive is made when it is first needed.

    R_upright_camera (3, 3): the camera's axes in those of an upright one that looks ahead. By default cameras look
    ahead, but an annular lens looks up.
    """

    def __init__(
        self, world: World, camera: Camera, options: RoomOptions, R_upright_camera: Array | None = None
    ) -> None:
        self.world, self.camera, self.options = world, camera, options
        self._turned = R_upright_camera

    @cached_property
    def _mount(self) -> Array:
        """Pose (4, 4) of the camera in the axes of an upright one."""
        R = upright_rotation(self.camera) if self._turned is None else self._turned
        return make_pose(R, np.zeros(3))

    @cached_property
    def _rays(self) -> Array:
        """Rays (H, W, 3) in the axes in which an occluder stays in its place."""
        exact = self._bundle.exact
        return exact if self._turned is None else exact @ self._turned.T

    @cached_property
    def T_wc(self) -> Array:
        """(N, 4, 4) camera-to-world poses of the frames."""
        return np.asarray(self.world.path.T_wc @ self._mount)

    @cached_property
    def T_novel(self) -> Array:
        """(8, 4, 4) camera-to-world poses of the novel views."""
        return np.asarray(self.world.path.novel @ self._mount)

    @cached_property
    def _bundle(self) -> render.RayBundle:
        return render.ray_bundle(self.camera)

    @cached_property
    def _gains(self) -> Array:
        path = self.world.path
        return path.exposure * path.gains * effects.gains(self.options, len(self.T_wc))

    @cached_property
    def _shutter(self) -> float:
        """Share of the frame time for which the shutter is open, so that the median streak is ``blur`` pixels long."""
        n = len(self.T_wc)
        some = np.linspace(0, n - 2, 6).astype(int)
        flows = []
        for i in some:
            d = render.depth(self.world.geometry, self._bundle, self.T_wc[i])
            flows.append(effects.median_flow(self.camera, d, self.T_wc[i], self.T_wc[i + 1]))
        return float(min(1.0, self.options.blur / max(float(np.median(flows)), 1e-6)))

    def depth(self, index: int) -> NDArray[np.float32]:
        """Exact radial depth (H, W) of a frame, metres; NaN where an occluder hides the room. Black frames have it."""
        d = render.depth(self.world.geometry, self._bundle, self.T_wc[index])
        hidden = effects.occluder(self.options, index, self._rays)
        if hidden is not None:
            d[hidden[0] > 0] = np.nan
        return d

    def frame(self, index: int) -> NDArray[np.uint8]:
        """RGB (H, W, 3) of one frame with all its disturbances."""
        o = self.options
        gain = float(self._gains[index])
        if effects.is_black(o, index, len(self.T_wc)):
            linear = np.zeros(self._bundle.rays.shape, dtype=np.float32)
        elif o.blur > 0:
            count = max(3, math.ceil(2 * o.blur))
            poses = effects.shutter_poses(self.T_wc, index, self._shutter, count)
            linear = np.zeros(self._bundle.rays.shape, dtype=np.float32)
            for T in poses:
                linear += render.radiance(self.world.scene, self._bundle, T, gain=gain, sub=2)
            linear /= count
        else:
            linear = render.radiance(self.world.scene, self._bundle, self.T_wc[index], gain=gain)
        slant = effects.row_gain(o, index, self.camera.height)
        if slant is not None:
            linear = linear * slant
        hidden = effects.occluder(o, index, self._rays)
        if hidden is not None:
            opacity = hidden[0][..., None]
            linear = linear * (1 - opacity) + hidden[1] * opacity
        return render.to_image(linear, sigma=o.noise, seed=(o.seed * 1_000_003 + index * 7919 + 17))

    def render_frames(self, first: int, last: int, to: Path) -> None:
        """Write frames first to last - 1 into the folder ``to``, as PNG files named by index, one thread per frame."""
        _ = self.world.scene, self._bundle, self._gains, self.T_wc  # computed before the threads start
        if self.options.blur > 0:
            _ = self._shutter
        with ThreadPoolExecutor(render.worker_count()) as pool:
            list(
                pool.map(
                    lambda i: _write(to / f"{i:06d}.png", self.frame(i)),
                    range(first, last),
                )
            )
        (to / "about.json").write_text(json.dumps({"room": self.world.key(), "options": self.options.to_dict()}))

    def render_novel(self, to: Path) -> None:
        """Write the novel views, without noise or disturbances, into the folder ``to`` as PNG files."""
        scene, gain = self.world.scene, self.world.path.exposure

        def one(k: int) -> None:
            _write(
                to / f"{k:03d}.png",
                render.to_image(render.radiance(scene, self._bundle, self.T_novel[k], gain=gain)),
            )

        _ = self._bundle
        with ThreadPoolExecutor(render.worker_count()) as pool:
            list(pool.map(one, range(len(self.T_novel))))


def _write(path: Path, image: NDArray[np.uint8]) -> None:
    import cv2

    _, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
    path.write_bytes(data.tobytes())
