"""A layout: which part of a picture holds the sphere, how, and how it is turned; and panoramas made of pictures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import directions_from_lonlat
from panobench.layouts.cells import Cube, Packing, Panorama

Array = NDArray[np.float64]
Size = tuple[int, int]
WHOLE = (0.0, 0.0, 1.0, 1.0)
#: The widest panorama that is made, whatever part of it a file claims to hold; and of a mask as it is computed.
_MAX_WIDTH, _MASK_WIDTH = 16384, 2048


@dataclass(frozen=True)
class Layout:
    """name: as `--layout` takes it. part: left, top, right and bottom edge of what is looked at, from 0 to 1.

    yaw_pitch_roll_deg: how the sphere is turned before it is shown, as its metadata say. remark: one line for whoever
    judges a result; "" for a plain panorama.
    """

    name: str = "erp"
    packing: Packing = field(default_factory=Panorama)
    part: tuple[float, float, float, float] = WHOLE
    yaw_pitch_roll_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    remark: str = ""

    @property
    def plain(self) -> bool:
        """Whether the part is a panorama as it stands, but for its proportions."""
        return self.packing == Panorama() and self.yaw_pitch_roll_deg == (0.0, 0.0, 0.0)

    def fitted(self, stored: Size) -> Layout:
        """The same for pictures of that size (width, height)."""
        if not isinstance(self.packing, Cube) or not self.packing.pad_px:
            return self
        pad = (self.packing.pad_px / stored[0], self.packing.pad_px / stored[1])
        return replace(self, packing=replace(self.packing, pad=pad))

    def panorama_size(self, width: int, height: int) -> Size:
        """(width, height) of the panorama that a picture of this size holds: twice as wide as high."""
        left, _, right, _ = self.part
        across = (right - left) * width / self.packing.turns
        half = min(max(1, round(across / 2)), _MAX_WIDTH // 2)
        return 2 * half, half

    def picture_size(self, stored: Size, panorama: Size) -> Size:
        """The size at which to look at a stored picture to make a panorama of that size of it, never above its own."""
        shrink = min(1.0, (1.0 if self.plain else 1.1) * panorama[0] / self.panorama_size(*stored)[0])
        return max(1, round(stored[0] * shrink)), max(1, round(stored[1] * shrink))

    def unpack(self, picture: NDArray[np.uint8], size: Size) -> NDArray[np.uint8]:
        """A picture (h, w, 3), or (h, w), as a panorama of ``size`` (width, height); black where it holds nothing."""
        import cv2

        h, w = picture.shape[:2]
        if self.plain:
            left, top, right, bottom = self.part
            cut = picture[round(top * h) : max(round(bottom * h), 1), round(left * w) : max(round(right * w), 1)]
            shrinks = size[0] <= cut.shape[1] and size[1] <= cut.shape[0]
            how = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
            same = cut.shape[1::-1] == size
            return np.ascontiguousarray(cut if same else cv2.resize(np.ascontiguousarray(cut), size, interpolation=how))
        x, y, seen = _places(self, (w, h), size)
        out = cv2.remap(picture, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        out[~seen] = 0
        return np.asarray(out)

    def seen(self, size: Size) -> NDArray[np.bool_]:
        """Which pixels (H, W) of a panorama of ``size`` the picture holds."""
        if self.plain or isinstance(self.packing, Cube):
            return np.ones((size[1], size[0]), dtype=bool)
        import cv2

        small = min(size[0], _MASK_WIDTH)
        seen = _places(self, (4096, 2048), (small, max(1, small // 2)))[2]
        return cv2.resize(seen.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0


@lru_cache(maxsize=4)
def _places(
    layout: Layout, picture: Size, size: Size
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    """Pixel coordinates in the picture for each pixel of the panorama, as cv2.remap takes them, and which it holds."""
    place, seen = layout.packing.locate(directions(size) @ rotation(layout.yaw_pitch_roll_deg))
    left, top, right, bottom = layout.part
    w, h = picture
    grid = np.array(layout.packing.grid)
    cell = np.clip(np.floor(place * grid), 0, grid - 1)
    half = 0.5 * grid / np.array([(right - left) * w, (bottom - top) * h])
    # no pixel of a cell is mixed with one of the next cell
    place = (cell + np.clip(place * grid - cell, half, 1 - half)) / grid
    x = (left + place[..., 0] * (right - left)) * w - 0.5
    y = (top + place[..., 1] * (bottom - top)) * h - 0.5
    return x.astype(np.float32), y.astype(np.float32), seen


def directions(size: Size) -> Array:
    """Unit directions (H, W, 3) of a panorama's pixel centres."""
    width, height = size
    lon = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    lat = (0.5 - (np.arange(height) + 0.5) / height) * np.pi
    lon, lat = np.meshgrid(lon, lat)
    return np.asarray(directions_from_lonlat(lon, lat))


def rotation(yaw_pitch_roll_deg: tuple[float, float, float]) -> Array:
    """(3, 3): takes directions of the picture to those in which they are to be shown.

    Turns about the up, the right and the forward vector, one after the other, by the right hand: to the left, upwards,
    clockwise (Spherical Video V2, box ``prhd``).
    """
    yaw, pitch, roll = np.deg2rad(yaw_pitch_roll_deg)
    cy, sy, cp, sp, cr, sr = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
    R_yaw = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
    R_pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
    R_roll = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
    return np.asarray(R_yaw @ R_pitch @ R_roll)
