"""The built-in rooms as a dataset: frames are rendered on first use and then read from the cache."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.views import upright_rotation
from panobench.datasets.base import Dataset, FrameSequence
from panobench.errors import DatasetError, UnknownNameError
from panobench.rooms import cache
from panobench.rooms.frames import FrameRenderer
from panobench.rooms.kinds import KINDS
from panobench.rooms.options import RoomOptions, parse_name
from panobench.rooms.world import World
from panobench.types import NovelView, Trajectory

DEFAULT_WIDTH = 512
CHUNK = 20  # frames that are rendered together

Progress = Callable[[int, int], None]


class RoomSequence(FrameSequence):
    """One room seen by one camera. Images come from the cache, which is filled in chunks when frames are requested.

    progress(done, total) is called after every chunk that is rendered.
    """

    dataset = "rooms"

    def __init__(
        self,
        name: str,
        kind: str,
        camera: Camera,
        options: RoomOptions,
        progress: Progress | None,
        R_upright_camera: NDArray[np.float64] | None = None,
    ) -> None:
        self.name, self.kind, self.camera, self.options = name, kind, camera, options
        self._progress, self._turned = progress, R_upright_camera
        self._world = World(kind, options.seed, options.frames)
        self.times = np.arange(self._world.frames) / self._world.kind.motion.rate
        values = {
            **self._world.key(),
            "options": options.to_dict(),
            "camera": camera.to_dict(),
        }
        if camera.mask is not None:
            values["mask"] = np.packbits(camera.mask).tobytes().hex()
        if R_upright_camera is not None:
            values["rotation"] = np.round(R_upright_camera, 12).tolist()
        self._key = cache.key_of(values)
        self._folder = cache.cache_root() / "rooms" / f"{kind}-{options.seed}-{camera.kind}{camera.width}-{self._key}"

    @property
    def world(self) -> World:
        """The room and the camera's path through it, for simulations that render it in another way."""
        return self._world

    @cached_property
    def _renderer(self) -> FrameRenderer:
        return FrameRenderer(self._world, self.camera, self.options, self._turned)

    def _chunk(self, index: int) -> Path:
        """The cache folder with frame ``index``, which is rendered now if it is missing."""
        first = index // CHUNK * CHUNK
        folder = self._folder / f"{first:06d}"
        if not folder.is_dir():
            last = min(first + CHUNK, len(self))
            cache.publish(folder, lambda to: self._renderer.render_frames(first, last, to))
            if self._progress:
                self._progress(last, len(self))
        return folder

    def prepare(self, last: int | None = None) -> None:
        """Render the first ``last`` frames (None: all) now, with a progress bar on a terminal."""
        n = len(self) if last is None else min(last, len(self))
        missing = [i for i in range(0, n, CHUNK) if not (self._folder / f"{i:06d}").is_dir()]
        if not missing:
            return
        if self._progress is None and sys.stderr is not None and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import track

            bar = track(
                missing,
                f"rendering rooms/{self.name}",
                console=Console(stderr=True),
                transient=True,
            )
        else:
            bar = missing
        for i in bar:
            self._chunk(i)

    def image(self, index: int) -> NDArray[np.uint8]:
        import cv2

        index = self._checked(index)
        path = self._chunk(index) / f"{self.frame_name(index)}.png"
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None or image.shape[:2] != (self.camera.height, self.camera.width):
            raise DatasetError("cached frame is damaged; delete the folder it is in", path, frame=index)
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        """Exact radial depth (H, W) of the pixel centres, metres; NaN outside the camera's view and on an occluder."""
        return self._renderer.depth(self._checked(index))

    @property
    def groundtruth(self) -> Trajectory | None:
        return Trajectory(self.times, self._renderer.T_wc)

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return np.array([0.0, 0.0, 1.0])

    def novel_views(self) -> list[NovelView]:
        """Eight views away from the trajectory, without noise or disturbances."""
        import cv2

        folder = self._folder / "novel"
        cache.publish(folder, self._renderer.render_novel)
        views = []
        for k, T in enumerate(self._renderer.T_novel):
            image = cv2.imread(str(folder / f"{k:03d}.png"), cv2.IMREAD_COLOR)
            if image is None:
                raise DatasetError(
                    "cached view is damaged; delete the folder it is in",
                    folder,
                    frame=k,
                )
            views.append(NovelView(f"{k:03d}", np.asarray(image[..., ::-1]).copy(), self.camera, T))
        return views

    def rendered_by(self, camera: Camera, R_target_source: NDArray[np.float64]) -> RoomSequence:
        upright = upright_rotation(self.camera) if self._turned is None else self._turned
        R = upright @ np.asarray(R_target_source, dtype=np.float64).T
        usual = np.allclose(R, upright_rotation(camera), atol=1e-12)
        return RoomSequence(self.name, self.kind, camera, self.options, self._progress, None if usual else R)

    def provenance(self) -> dict[str, Any]:
        return {
            "generator": "panobench rooms",
            "generator_version": cache.GENERATOR_VERSION,
            "room": self.kind,
            "summary": self._world.kind.summary,
            "frames": len(self),
            "options": self.options.to_dict(),
            "camera": self.camera.to_dict(),
            **({} if self._turned is None else {"R_upright_camera": self._turned.tolist()}),
            "key": self._key,
        }

    def _checked(self, index: int) -> int:
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return index % len(self)


class RoomsDataset(Dataset):
    """Built-in rooms; ``root`` is ignored."""

    name: ClassVar[str] = "rooms"

    def sequences(self) -> list[str]:
        return list(KINDS)

    def open(
        self,
        sequence: str | None = None,
        *,
        width: int | None = None,
        camera: Camera | None = None,
        options: RoomOptions | None = None,
        progress: Progress | None = None,
    ) -> RoomSequence:
        """Open e.g. "room1", "room3@7" (seed 7) or "room1+blur2+noise0.03" (see ``RoomOptions``).

        camera: any model; None: a full panorama of ``width`` (None: 512). progress: see ``RoomSequence``.
        Raises UnknownNameError for an unknown room or variant, UsageError for an option out of range.
        """
        name = sequence or "room1"
        kind, chosen = parse_name(name, options)
        if kind not in KINDS:
            raise UnknownNameError("sequence of dataset 'rooms'", kind, KINDS)
        if camera is None:
            w = width or DEFAULT_WIDTH
            camera = ErpCamera(w, w // 2)
        elif width is not None and width != camera.width:
            camera = camera.scaled(width)
        return RoomSequence(name, kind, camera, chosen, progress)
