"""Depth of images whose poses are known, by plane sweeps over their neighbours; for every camera the renderer takes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.stereo_camera import StereoCamera
from panobench.photometric.pyramid import luma_of_frame, pyramid
from panobench.photometric.stereo import SweepOptions, WorkingScale, multi_view_depth, resize_panorama
from panobench.splat.gaussians import F32

Array = NDArray[np.float64]

#: Baselines wanted between an image and its neighbours, over the median depth.
BASELINE = (0.02, 0.25)
#: Turned by more than this (cosine of the angle), a narrow view shares too little.
TURN_COSINE = 0.85
#: Range swept, over the median depth; and over the largest baseline while the depth is not known.
NEAR, FAR = 0.1, 12.0
FIRST_NEAR, FIRST_FAR = 1.0, 300.0


@dataclass
class _Seen:
    luma: F32
    T_wc: Array


class DepthSweeper:
    """Takes posed images, gives the radial depth of any of them. Nothing is random."""

    def __init__(self, camera: Camera, width: int, views: int) -> None:
        self.original = camera
        self.stereo = StereoCamera(camera)
        self.scale = WorkingScale.of(self.stereo.camera, width)
        self.valid = self.stereo.camera.valid_mask()
        self.wide = float(camera.solid_angle().sum()) > 2 * np.pi
        self.views = views
        self.median_depth: float | None = None
        self._seen: list[_Seen] = []

    def __len__(self) -> int:
        return len(self._seen)

    def add(self, image: NDArray[np.uint8], T_wc: Array) -> None:
        """The next image (H, W, 3) of the original camera with its pose."""
        levels = pyramid(luma_of_frame(self.stereo.image(image), self.valid), smallest_width=16)
        self._seen.append(_Seen(levels[min(self.scale.level, len(levels) - 1)], T_wc))

    def move(self, number: int, T_wc: Array) -> None:
        """Image ``number`` (in the order added) has a better pose now."""
        self._seen[number].T_wc = T_wc

    def forget(self, oldest: int) -> None:
        """Drop that many images from the front; numbers of the others shift down."""
        del self._seen[:oldest]

    def depth(self, number: int) -> F32 | None:
        """(H, W) at the original camera's pixels, NaN where it sees nothing; None without parallax.

        ``median_depth`` is set by the first depth found.
        """
        if self.median_depth is None:
            around = self._nearest_in_time(number)
            if not around:
                return None
            baseline = max(self._baseline(number, k) for k in around)
            first = self._sweep(number, around, FIRST_NEAR * baseline, FIRST_FAR * baseline, SweepOptions(shells=96))
            self.median_depth = float(np.median(first[self.scale.valid]))
        z = self.median_depth
        others = self._neighbours(number, z)
        if not others:
            return None
        depth = self._sweep(number, others, NEAR * z, FAR * z, SweepOptions())
        shape = (self.stereo.camera.height, self.stereo.camera.width)
        full = resize_panorama(depth, shape, self.stereo.camera.kind == "erp")
        return self.stereo.depth_map(np.where(self.valid, full, np.nan).astype(np.float32))

    def _baseline(self, a: int, b: int) -> float:
        return float(np.linalg.norm(self._seen[a].T_wc[:3, 3] - self._seen[b].T_wc[:3, 3]))

    def _nearest_in_time(self, number: int) -> list[int]:
        """Twice as many as wanted before and after, every second, that moved at all."""
        reach = 2 * self.views
        near = range(max(0, number - reach), min(len(self._seen), number + reach + 1), 2)
        moved = [k for k in near if k != number and self._baseline(number, k) > 0]
        return sorted(moved, key=lambda k: abs(k - number))[: self.views]

    def _neighbours(self, number: int, z: float) -> list[int]:
        """Views at useful baselines, spread over them; the longest there are when all are short."""
        T = self._seen[number].T_wc
        found = []
        for k in range(len(self._seen)):
            b = self._baseline(number, k) / z
            cosine = 0.5 * (float(np.trace(T[:3, :3].T @ self._seen[k].T_wc[:3, :3])) - 1)
            if k != number and 0.2 * BASELINE[0] < b < BASELINE[1] and (self.wide or cosine > TURN_COSINE):
                found.append((b, k))
        found.sort()
        useful = [k for b, k in found if b > BASELINE[0]] or [k for _, k in found[-self.views :]]
        if len(useful) <= self.views:
            return useful
        return [useful[i] for i in np.linspace(0, len(useful) - 1, self.views).round().astype(int)]

    def _sweep(self, number: int, others: list[int], near: float, far: float, options: SweepOptions) -> F32:
        T_wc = self._seen[number].T_wc
        T_fr = np.stack([invert_pose(self._seen[k].T_wc) @ T_wc for k in others])
        images = np.stack([self._seen[k].luma for k in others])
        depth, _ = multi_view_depth(self._seen[number].luma, self.scale, images, T_fr, near, far, options)
        return depth
