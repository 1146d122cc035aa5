"""A recording whose pictures hold the sphere in some layout, read as panoramas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.datasets.files.images import read_image, resize_image
from panobench.errors import DatasetError
from panobench.layouts.cells import EAC
from panobench.layouts.layout import WHOLE, Layout, Size
from panobench.layouts.metadata import Said, from_photo_sphere, from_side_data, from_xml
from panobench.layouts.names import AUTO, layout_named
from panobench.layouts.recognise import CALIBRATION, recognise
from panobench.masks.files import BesideMask
from panobench.video.pair import PairReader
from panobench.video.recording import Recording

#: Pictures looked at to recognise a layout, and their width.
_LOOKED_AT, _WIDTH = 3, 512


class PanoramaReader:
    """Frames of ``video`` as panoramas (H, W, 3), H = W / 2. width, height: of the panorama the pictures hold."""

    def __init__(self, video: Recording, layout: Layout) -> None:
        self.stored = (video.width, video.height)
        self.video, self.layout = video, layout.fitted(self.stored)
        self.width, self.height = layout.panorama_size(*self.stored)

    def read(self, index: int, size: tuple[int, int]) -> NDArray[np.uint8]:
        """Frame ``index`` as a panorama of ``size`` (width, height)."""
        if self.layout.plain and self.layout.part == WHOLE:
            return self.video.read(index, size)
        picture = self.video.read(index, self.layout.picture_size(self.stored, size))
        return self.layout.unpack(picture, size)

    def camera(self) -> Camera:
        """The panorama's, without what the pictures do not hold."""
        camera = ErpCamera(self.width, self.height)
        seen = self.layout.seen((self.width, self.height))
        return camera if seen.all() else camera.with_mask(seen)

    def remarks(self) -> list[str]:
        """How the pictures are read, if not as they stand."""
        return [self.layout.remark] if self.layout.remark else []

    def files(self) -> list[Path]:
        """The files read besides the video: none."""
        return []

    def about(self) -> dict[str, Any]:
        """For a sequence's provenance."""
        if self.layout.plain and self.layout.part == WHOLE:
            return {}
        layout = self.layout
        return {
            "layout": {
                "name": layout.name,
                "part": list(layout.part),
                "yaw_pitch_roll_deg": list(layout.yaw_pitch_roll_deg),
            }
        }


def panoramas(video: Recording, option: str | None = None) -> PanoramaReader:
    """The panoramas in a video, as `--layout` says or as they are recognised.

    Raises DatasetError for pictures that are not read without being told how, UsageError for an unknown layout.
    """
    if option not in (None, AUTO):
        return PanoramaReader(video, layout_named(str(option)))
    if isinstance(video, PairReader) and video.strips:
        # What cameras write has overlaps and no padding.
        packing = replace(EAC, pad_px=0) if video.overlapping else EAC
        remark = "two streams of three faces each are put together (GoPro's equi-angular cubemap)"
        return PanoramaReader(video, Layout("eac", packing, remark=remark))
    said = from_side_data(video.side_data)
    if said == Said():
        said = from_xml(video.path)
    found = recognise(_looked_at(video), (video.width, video.height), said)
    if found.refusal:
        raise DatasetError(found.refusal, video.path)
    return PanoramaReader(video, found.layout)


def _looked_at(video: Recording) -> list[NDArray[np.uint8]]:
    size = _small((video.width, video.height))
    numbers = sorted({round(k * (len(video) - 1) / (_LOOKED_AT - 1)) for k in range(_LOOKED_AT)})
    return [video.read(index, size) for index in numbers]


def _small(size: Size) -> Size:
    width = min(_WIDTH, size[0])
    return width, max(1, round(size[1] * width / size[0]))


def panorama_of_images(
    paths: list[Path], size: Size, option: str | None, lens: str = CALIBRATION
) -> tuple[Camera, Layout | None]:
    """The panorama's camera in image files of one ``size`` and how they hold it; None for panoramas as they stand.

    lens: see ``recognise``. Raises as ``panoramas``.
    """
    if option not in (None, AUTO):
        layout = layout_named(str(option))
    else:
        some = sorted({0, len(paths) // 2, len(paths) - 1})
        small = [resize_image(read_image(paths[k], frame=k), *_small(size)) for k in some]
        found = recognise(small, size, from_photo_sphere(paths[0]), lens)
        if found.refusal:
            raise DatasetError(found.refusal, paths[0])
        layout = found.layout
    layout = layout.fitted(size)
    shape = layout.panorama_size(*size)
    camera, seen = ErpCamera(*shape), layout.seen(shape)
    stands = layout.plain and layout.part == WHOLE and shape == size and not layout.remark
    return camera if seen.all() else camera.with_mask(seen), None if stands else layout


def mask_of_panorama(found: Callable[[Size], BesideMask], layout: Layout, stored: Size, size: Size) -> BesideMask:
    """``found``(size) finds the mask beside a recording, for pictures of that size: those that are ``stored`` in
    ``layout``, or the panoramas of ``size`` made of them. The answer is for the panoramas.
    """
    if layout.plain and layout.part == WHOLE:
        return found(size)
    try:
        mask = found(stored)
    except DatasetError:
        return found(size)
    if mask.file is None:
        return mask
    valid = layout.unpack(np.uint8(mask.file.valid) * 255, size) > 250
    return replace(mask, file=replace(mask.file, valid=valid))
