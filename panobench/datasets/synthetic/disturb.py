"""Disturbances of a camera's stream, with a fixed seed: noise, blur, exposure, an occluder, black frames, yaw.

They work on the images of any dataset. The built-in rooms can render disturbances of their own (``RoomOptions``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.errors import UnknownNameError, UsageError

Image = NDArray[np.uint8]
#: Value of a name without a number, and the range allowed.
BARE = {"noise": 0.03, "blur": 2.0, "rolling": 0.3, "occluder": 0.25, "black": 20.0, "yaw": 6.0}
_LIMITS = {
    "noise": (0.0, 0.5),
    "blur": (0.0, 32.0),
    "rolling": (0.0, 0.9),
    "occluder": (0.0, 0.9),
    "black": (0.0, 1e5),
    "yaw": (-90.0, 90.0),
}
#: Frames in one period of the exposure.
PERIOD = 24.0


@dataclass(frozen=True)
class Disturbances:
    """What is done to the images; 0 does nothing.

    noise:    standard deviation of Gaussian noise, independent in every frame and channel; full scale is 1.
    blur:     length in pixels of a horizontal streak, a box filter along the rows.
    rolling:  amplitude of a gain that follows a sine over 24 frames: 0.3 is +-30%.
    occluder: share of the sphere that a patterned disc hides; it moves round the camera by 3 degrees per frame.
    black:    number of black frames around the middle of the sequence.
    yaw:      additional rotation about the vertical (y) axis, degrees per frame; for full panoramas.
    """

    noise: float = 0.0
    blur: float = 0.0
    rolling: float = 0.0
    occluder: float = 0.0
    black: float = 0.0
    yaw: float = 0.0

    def __post_init__(self) -> None:
        for f in fields(self):
            value, (low, high) = getattr(self, f.name), _LIMITS[f.name]
            if not low <= value <= high:
                raise UsageError(f"disturbance {f.name}={value}: must be between {low:g} and {high:g}")

    @classmethod
    def parse(cls, texts: list[str]) -> Disturbances:
        """Disturbances of words such as "noise=0.03" and "black". Raises UnknownNameError or UsageError."""
        values: dict[str, float] = {}
        for text in texts:
            name, equals, number = text.partition("=")
            if name not in BARE:
                raise UnknownNameError("disturbance", name, BARE)
            try:
                values[name] = float(number) if equals else BARE[name]
            except ValueError:
                raise UsageError(f"disturbance '{text}': '{number}' is not a number") from None
        return cls(**values)

    def to_dict(self) -> Mapping[str, float]:
        """The disturbances that are not 0."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name)}


class Disturber:
    """Applies disturbances to the images of one camera; frame i always looks the same."""

    def __init__(self, chosen: Disturbances, camera: Camera, frames: int, seed: int = 0) -> None:
        """Raises UsageError for yaw and a camera that does not see 360 degrees."""
        if chosen.yaw and not (camera.kind == "erp" and bool(camera.valid_mask().all())):
            raise UsageError("disturbance yaw: only full panoramas (erp) can be turned")
        self.chosen, self.camera, self.frames, self.seed = chosen, camera, frames, seed

    def angle(self, index: int) -> float:
        """Additional rotation of the camera at this frame, radians."""
        return float(np.deg2rad(self.chosen.yaw * index))

    def rotation(self, index: int) -> NDArray[np.float64]:
        """(4, 4) pose of the rotated camera in the dataset's camera: about y, to the right for positive yaw."""
        c, s = np.cos(self.angle(index)), np.sin(self.angle(index))
        T = np.eye(4)
        T[:3, :3] = [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        return T

    def shift(self, index: int) -> float:
        """Columns by which the panorama is shifted to the left."""
        return self.angle(index) / (2 * np.pi) * self.camera.width

    def is_black(self, index: int) -> bool:
        first = (self.frames - int(self.chosen.black)) // 2
        return first <= index < first + int(self.chosen.black)

    def __call__(self, image: Image, index: int) -> Image:
        """A disturbed copy of RGB (H, W, 3)."""
        chosen = self.chosen
        if self.is_black(index):
            return np.zeros_like(image)
        x = image.astype(np.float64) / 255
        if chosen.yaw:
            x = roll_columns(x, self.shift(index))
        if chosen.blur:
            x = streak(x, chosen.blur, wrap=self.camera.kind == "erp")
        if chosen.occluder:
            hidden, colour = self._disc(index)
            x = np.where(hidden[..., None], colour[..., None], x)
        if chosen.rolling:
            x = x * (1 + chosen.rolling * np.sin(2 * np.pi * index / PERIOD))
        if chosen.noise:
            x = x + np.random.default_rng([self.seed, index]).normal(0.0, chosen.noise, x.shape)
        return np.asarray(np.round(np.clip(x, 0.0, 1.0) * 255), dtype=np.uint8)

    @cached_property
    def _rays(self) -> NDArray[np.float64]:
        return np.nan_to_num(self.camera.rays())

    def _disc(self, index: int) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """The pixels (H, W) that the occluder, a chequered cap of the sphere, hides, and its grey levels there.

        A cap of half-angle a covers (1 - cos a) / 2 of the sphere.
        """
        a = np.deg2rad(3.0 * index) + self.seed
        axis = np.array([np.sin(a), 0.3 * np.sin(0.7 * a), np.cos(a)])
        axis /= np.linalg.norm(axis)
        right = np.cross([0.0, 1.0, 0.0], axis)
        right /= np.linalg.norm(right)
        down = np.cross(axis, right)
        squares = np.floor(6 * self._rays @ right) + np.floor(6 * self._rays @ down)
        return self._rays @ axis > 1 - 2 * self.chosen.occluder, np.where(squares % 2 == 0, 0.15, 0.3)


def roll_columns(x: NDArray[np.float64], columns: float) -> NDArray[np.float64]:
    """(H, W, C) shifted periodically to the left by a fractional number of columns, in the spectra of the rows."""
    width = x.shape[1]
    phase = np.exp(2j * np.pi * np.fft.rfftfreq(width) * columns)
    return np.asarray(np.fft.irfft(np.fft.rfft(x, axis=1) * phase[None, :, None], n=width, axis=1))


def streak(x: NDArray[np.float64], length: float, wrap: bool) -> NDArray[np.float64]:
    """Box filter of ``length`` pixels along the rows: the mean of eight linearly interpolated samples."""
    samples = (np.arange(8) + 0.5) / 8 * length - length / 2
    reach = int(np.ceil(length / 2)) + 1
    padded = np.pad(x, ((0, 0), (reach, reach), (0, 0)), mode="wrap" if wrap else "edge")
    total = np.zeros_like(x)
    for s in samples:
        k = int(np.floor(s))
        for weight, offset in ((1 - (s - k), k), (s - k, k + 1)):
            begin = reach + offset
            total += weight * padded[:, begin : begin + x.shape[1]]
    return np.asarray(total / len(samples))
