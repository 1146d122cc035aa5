"""Reprojection from any camera to any other at the same position: images, radial depth, masks and poses.

The map from target to source pixels is computed once; each image then costs one ``cv2.remap``. Float maps are kept:
with OpenCV 5 four-channel float remapping is faster than fixed-point maps, and exact where pixels coincide.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array, Camera
from panobench.cameras.field_of_view import describe_view
from panobench.cameras.footprint import Sampling, choose_sampling
from panobench.cameras.seams import Seams, Window
from panobench.cameras.views import rotated_poses, upright_rotation
from panobench.errors import CalibrationError, UnsupportedError

#: Samples mapped at a time, to bound memory.
_CHUNK = 1 << 18
#: A map coordinate that is outside every image.
_NOWHERE = -100.0
Array32 = NDArray[np.float32]
#: Neighbours whose depths differ by more than this share belong to different surfaces.
_DEPTH_EDGE = 0.05


@dataclass
class _Maps:
    """Columns and rows (H, W) in the ``window`` of the padded source image."""

    x: Array32
    y: Array32
    seams: Seams
    window: Window

    def hide(self, pixels: NDArray[np.bool_], grid: int) -> None:
        """Make target ``pixels`` (H, W) black."""
        samples = np.repeat(np.repeat(pixels, grid, axis=0), grid, axis=1)
        self.x[samples] = self.y[samples] = _NOWHERE


class Reprojector:
    """Maps the images of ``source`` to ``target``.

    source, target:   cameras with the same centre.
    R_target_source:  rotates vectors from the source's axes to the target's.
    antialias:        filter where the target has fewer pixels than the source.
    displaced:        (3,) where the source's centre is in the target's axes, over the distance of what both see: the
                      centres may differ a little where that distance is known. Depth is not corrected for it.

    Raises UnsupportedError when the target sees nothing of the source's field of view.
    """

    def __init__(
        self,
        source: Camera,
        target: Camera,
        R_target_source: ArrayLike | None = None,
        antialias: bool = True,
        displaced: ArrayLike | None = None,
    ) -> None:
        R = np.eye(3) if R_target_source is None else np.asarray(R_target_source, dtype=np.float64)
        if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
            raise CalibrationError("R_target_source is not a rotation matrix")
        self.source, self.target, self.R_target_source = source, target, R
        self._displaced = None if displaced is None else np.asarray(displaced, dtype=np.float64)
        self.sampling = choose_sampling(source, target, R) if antialias else Sampling()
        self._level = _shrunk(source, self.sampling.shrink)
        self._maps = self._sample_maps(self._level, self.sampling.grid)
        self._depth_maps: _Maps | None = None
        covered = self._remap(source.valid_mask().astype(np.float32))
        self._valid = np.asarray((covered > 0.999) & target.valid_mask())
        self._maps.hide(~self._valid, self.sampling.grid)
        if not self._valid.any():
            up = upright_rotation(source)
            raise UnsupportedError(
                f"the target view sees nothing of the source: the source ({source.kind}) covers "
                f"{describe_view(source, up)}, the target ({target.kind}) {describe_view(target, up @ R.T)}; "
                "turn or widen the target view"
            )

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(H, W) whether a target pixel is valid and wholly covered by valid source pixels."""
        return self._valid

    def image(self, image: NDArray[Any]) -> NDArray[Any]:
        """The target's image of a source image (H, W) or (H, W, C) of uint8, uint16 or float32; 0 where not valid."""
        self._check(image, "image")
        out = self._remap(image)
        return out.reshape(*out.shape[:2], *image.shape[2:])

    def mask(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The target's mask of a source mask (H, W): True for pixels that true source pixels cover wholly."""
        self._check(mask, "mask")
        covered = self._remap(np.asarray(mask, dtype=bool).astype(np.float32))
        return np.asarray(self.valid & (covered > 0.999))

    def depth(self, depth: NDArray[Any], method: Literal["nearest", "edge-aware"] = "edge-aware") -> Array32:
        """The target's radial depth of a source's (H, W), NaN unknown; distances do not change.

        "edge-aware" interpolates between those of the four neighbours that are known and within 5% of the nearest
        known one, so that no point appears between two surfaces. Not filtered when minifying, for the same reason.
        """
        self._check(depth, "depth")
        if self._depth_maps is None:
            self._depth_maps = self._sample_maps(self.source, 1)
        maps = self._depth_maps
        known = maps.seams.cut(np.asarray(depth, dtype=np.float32), maps.window)
        out = sample_depth(known, np.maximum(maps.x, 0), np.maximum(maps.y, 0), method)
        out[~self.valid] = np.nan
        return out

    def poses(self, T_wc_source: ArrayLike) -> Array:
        """Camera-to-world poses (..., 4, 4) of the target from the source's: T_wc_source [R_source_target]."""
        return rotated_poses(T_wc_source, self.R_target_source)

    def _remap(self, image: NDArray[Any]) -> NDArray[Any]:
        """An image (H, W[, C]) at the target's size; a single channel loses its axis."""
        level, maps = self._level, self._maps
        if (level.width, level.height) != (self.source.width, self.source.height):
            image = cv2.resize(image, (level.width, level.height), interpolation=cv2.INTER_AREA)
        image = maps.seams.cut(image, maps.window)
        three = image.ndim == 3 and image.shape[2] == 3
        if three:  # four channels fill a SIMD register: twice as fast as three
            image = cv2.cvtColor(image, cv2.COLOR_RGB2RGBA)
        out = cv2.remap(image, maps.x, maps.y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
        for _ in range(self.sampling.grid.bit_length() - 1):
            out = cv2.resize(out, (out.shape[1] // 2, out.shape[0] // 2), interpolation=cv2.INTER_AREA)
        return cv2.cvtColor(out, cv2.COLOR_RGBA2RGB) if three else out

    def _sample_maps(self, level: Camera, grid: int) -> _Maps:
        """Positions in the image of ``level`` of the ``grid`` x ``grid`` samples of each target pixel."""
        shape = (self.target.height * grid, self.target.width * grid)
        map_x, map_y = np.full(shape, _NOWHERE, np.float32), np.full(shape, _NOWHERE, np.float32)
        inside = np.zeros(shape, dtype=bool)
        seams = level.seams()
        u = (np.arange(shape[1]) + 0.5) / grid
        for rows in _row_chunks(shape):
            v = (np.arange(rows.start, rows.stop) + 0.5) / grid
            rays = self.target.unproject(np.stack(np.meshgrid(u, v), axis=-1))
            if self._displaced is not None:
                rays = rays - self._displaced
            pixels, ok = level.project(rays @ self.R_target_source)
            x, y = seams.locate(pixels[..., 0], pixels[..., 1])
            map_x[rows][ok], map_y[rows][ok] = x[ok], y[ok]
            inside[rows] = ok
        window = seams.window(map_x, map_y, inside)
        map_x[inside] -= window.x0
        map_y[inside] -= window.y0
        return _Maps(map_x, map_y, seams, window)

    def _check(self, array: NDArray[Any], what: str) -> None:
        expected = (self.source.height, self.source.width)
        if array.shape[:2] != expected:
            raise UnsupportedError(
                f"the {what} is {array.shape[1]}x{array.shape[0]}, its camera {expected[1]}x{expected[0]}"
            )


def sample_depth(padded: Array32, x: Array32, y: Array32, method: Literal["nearest", "edge-aware"]) -> Array32:
    """Depth (H, W) at columns ``x`` and rows ``y``; NaN neighbours and those across a depth edge do not count."""
    if method == "nearest":
        return padded[np.rint(y).astype(np.intp), np.rint(x).astype(np.intp)]
    x0 = np.clip(np.floor(x).astype(np.intp), 0, max(padded.shape[1] - 2, 0))
    y0 = np.clip(np.floor(y).astype(np.intp), 0, max(padded.shape[0] - 2, 0))
    x1, y1 = np.minimum(x0 + 1, padded.shape[1] - 1), np.minimum(y0 + 1, padded.shape[0] - 1)
    a, b = (x - x0).astype(np.float32), (y - y0).astype(np.float32)
    d = np.stack([padded[y0, x0], padded[y0, x1], padded[y1, x0], padded[y1, x1]])
    w = np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b])
    known = np.isfinite(d)
    w = np.where(known, w, 0)
    reference = np.take_along_axis(d, np.argmax(w, axis=0)[None], axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        w = np.where(np.abs(d - reference) <= _DEPTH_EDGE * reference, w, 0)
        out = np.sum(np.where(w > 0, w * d, 0), axis=0) / np.sum(w, axis=0)
    # If more than half of the weight is unknown, the result is unknown too.
    enough = np.sum(np.where(known, np.stack([(1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b]), 0), axis=0) >= 0.5
    return np.where(enough, out, np.nan).astype(np.float32)


def _shrunk(camera: Camera, factor: int) -> Camera:
    if factor == 1:
        return camera
    step = camera.width_step
    width = max(1, round(camera.width / factor / step)) * step
    return camera.with_mask(None).scaled(width)


def _row_chunks(shape: tuple[int, int]) -> Iterator[slice]:
    rows = max(1, _CHUNK // shape[1])
    for start in range(0, shape[0], rows):
        yield slice(start, min(start + rows, shape[0]))
