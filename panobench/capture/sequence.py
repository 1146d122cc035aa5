"""A sequence as a recording of it: frames made on first use and kept on disk, truth as it is."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.factory import upright_rotation
from panobench.capture.codec import through_codec
from panobench.capture.parts import Parts
from panobench.capture.scene import RoomScene
from panobench.capture.studio import ImageStudio, RoomStudio
from panobench.datasets.base import FrameSequence
from panobench.datasets.synthetic.rooms import CHUNK, RoomSequence
from panobench.errors import DatasetError, UsageError
from panobench.rooms import cache
from panobench.rooms.options import RoomOptions
from panobench.rooms.render import to_image, worker_count
from panobench.types import Imu, NovelView, Trajectory

Image = NDArray[np.uint8]


@lru_cache(maxsize=1)
def _source_digest() -> str:
    """Digest of this package's source: changed parts never serve old pictures."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


class CapturedSequence(FrameSequence):
    """``source`` as ``parts`` record it. Novel views and depth are those of the scene without anybody in it.

    Raises UsageError for parts that need a room and get something else.
    """

    dataset = "disturbed"

    def __init__(self, source: FrameSequence, parts: Parts, name: str) -> None:
        self.source, self.parts, self.name = source, parts, name
        self.camera, self.times = source.camera, source.times
        room = isinstance(source, RoomSequence)
        if parts.need_a_scene and not room:
            raise UsageError(
                f"sequence '{name}': part {parts.need_a_scene[0]} needs a built-in room; other data take operator, "
                "car, lenses, h264 and h265"
            )
        if parts.stitch and self.camera.kind != "erp":
            raise UsageError(f"sequence '{name}': part stitch makes panoramas, not {self.camera.kind} images")
        if isinstance(source, RoomSequence):
            plain = RoomOptions(seed=source.options.seed, frames=source.options.frames, noise=source.options.noise)
            if source.options != plain:
                raise UsageError(
                    f"sequence '{name}': parts go with the plain room (its noise, seed and frames); name other "
                    "disturbances behind ':'"
                )
        key = cache.key_of({"parts": parts.to_dict(), "source": _identity(source), "code": _source_digest()})
        self._folder = cache.cache_root() / "captured" / f"{_plain(source.name)}-{self.camera.width}-{key}"

    # -- frames ------------------------------------------------------------------------------------------------

    def image(self, index: int) -> Image:
        index = self._checked(index)
        first = index // CHUNK * CHUNK
        codec = "h264" if self.parts.h264 else "h265" if self.parts.h265 else ""
        if codec:
            folder = self._folder / codec
            cache.publish(folder, lambda to: self._encode(codec, to))
        else:
            folder = self._chunk(first)
        return self._read(folder, index)

    def _read(self, folder: Path, index: int) -> Image:
        path = folder / f"{index:06d}.png"
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None or image.shape[:2] != (self.camera.height, self.camera.width):
            raise DatasetError("cached frame is damaged; delete the folder it is in", path, frame=index)
        return np.asarray(image[..., ::-1].copy(), dtype=np.uint8)

    def _chunk(self, first: int) -> Path:
        folder = self._folder / f"{first:06d}"
        cache.publish(folder, lambda to: self._make(range(first, min(first + CHUNK, len(self))), to))
        return folder

    def _make(self, frames: range, to: Path) -> None:
        if self._room is not None:
            self._room.prepare()
        with ThreadPoolExecutor(worker_count()) as pool:
            for i, image in zip(frames, pool.map(self._fresh, frames)):
                _write(to / f"{i:06d}.png", image)

    def _encode(self, codec: str, to: Path) -> None:
        bits = self.parts.h264 or self.parts.h265
        rate = (len(self) - 1) / float(self.times[-1] - self.times[0]) if len(self) > 1 else 15.0
        for i, image in enumerate(through_codec(self._uncompressed(), codec, bits, rate)):
            _write(to / f"{i:06d}.png", image)

    def _uncompressed(self) -> Iterator[Image]:
        for index in range(len(self)):
            yield self._read(self._chunk(index // CHUNK * CHUNK), index)

    def _fresh(self, index: int) -> Image:
        if self._room is not None:
            return self._room.image(index)
        assert self._images is not None
        return to_image(self._images.shoot(self.source.image(index), float(self.times[index])).linear)

    @cached_property
    def _room(self) -> RoomStudio | None:
        if not isinstance(self.source, RoomSequence):
            return None
        options = self.source.options
        scene = RoomScene(self.source.world, self.camera)
        return RoomStudio(scene, self.parts, np.asarray(self.times), options.noise, options.seed)

    @cached_property
    def _images(self) -> ImageStudio | None:
        return None if self._room else ImageStudio(self.camera, self.parts, upright_rotation(self.camera))

    def hidden(self, index: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Pixels (H, W) of which the carrier hides at least half, and those of which walkers do: made anew."""
        index = self._checked(index)
        if self._room is not None:
            shot = self._room.shoot(index)
        else:
            assert self._images is not None
            shot = self._images.shoot(self.source.image(index), float(self.times[index]))
        return shot.carrier >= 0.5, shot.walkers >= 0.5

    # -- truth -------------------------------------------------------------------------------------------------

    def frame_name(self, index: int) -> str:
        return self.source.frame_name(index)

    def depth(self, index: int) -> NDArray[np.float32] | None:
        index = self._checked(index)
        return self.source.depth(index) if self._room is None else self._room.depth(index)

    @property
    def groundtruth(self) -> Trajectory | None:
        """Of the picture's axes at the middle of each frame: the source's, but for gait, turn and levelling."""
        return self.source.groundtruth if self._room is None else Trajectory(self.times, self._room.T_wc)

    @property
    def world_up(self) -> NDArray[np.float64] | None:
        return self.source.world_up

    @property
    def imu(self) -> Imu | None:
        """The source's; none when the camera moves otherwise than it did."""
        p = self.parts
        return None if p.gait or p.tilt or p.turn or p.levelled or p.locked else self.source.imu

    def novel_views(self) -> list[NovelView]:
        return self.source.novel_views()

    def provenance(self) -> dict[str, Any]:
        return {**self.source.provenance(), "source": self.source.dataset, "recording": self.parts.to_dict()}

    def _checked(self, index: int) -> int:
        if not -len(self) <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        return index % len(self)


def _identity(source: FrameSequence) -> dict[str, Any]:
    """What the source's images depend on."""
    mask = source.camera.mask
    return {
        "provenance": source.provenance(),
        "name": source.name,
        "camera": source.camera.to_dict(),
        "mask": None if mask is None else hashlib.sha256(np.packbits(mask).tobytes()).hexdigest(),
    }


def _plain(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name)[:40]


def _write(path: Path, image: Image) -> None:
    _, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])
    path.write_bytes(data.tobytes())
