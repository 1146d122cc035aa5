"""The exposure of frames that wait for the first map: gains from each frame to the next, multiplied up.

There is no map yet to compare frames with, and a frame is compared with the one before in the same directions, the turn
between them undone. Compared pixel by pixel, a turn passes for a change of exposure where a mask hides part of the
picture, for what comes into view is brighter or darker than what leaves it: by up to 1% a frame in simulated rooms with
an operator, after which the frames' depths did not agree.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.methods.panogs.config import ExposureOptions
from panobench.methods.panogs.tracking.exposure import ENOUGH, RANGE, scaled, weighted_median
from panobench.photometric.bands import DARK, SATURATED
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pyramid import F32, luma_of_frame, pyramid
from panobench.photometric.rotation_only import RotationOnlyAligner
from panobench.photometric.stereo import WorkingScale

#: Width of the images that are compared, pixels.
WIDTH = 64
#: Least log gain from a frame to the next that counts: less is what the turn leaves, and would add up.
LEAST = 0.003


class ExposureChain:
    """Brings frames to the exposure of the first one. Leaves narrow views alone."""

    def __init__(self, camera: Camera, options: ExposureOptions) -> None:
        self.enabled = options.match and ViewWidth.of(camera) is ViewWidth.WIDE
        self.options, self._camera, self._valid = options, camera, camera.valid_mask()
        self._scale = WorkingScale.of(camera, WIDTH)
        self._area = self._scale.camera.solid_angle()
        self._aligner: RotationOnlyAligner | None = None
        self._last: list[F32] = []
        self._gain = 1.0

    def start(self, image: NDArray[np.uint8], visible: NDArray[np.bool_] | None = None) -> None:
        """Begin with this frame (H, W, 3). visible (H, W): where it shows the scene; None: everywhere."""
        if self.enabled:
            self._last, self._gain = self._pyramid(image, visible), 1.0
            self._aligner = RotationOnlyAligner(self._camera, len(self._last))

    def follow(self, image: NDArray[np.uint8], visible: NDArray[np.bool_] | None = None) -> NDArray[np.uint8]:
        """The next frame at the exposure of the first; arguments as for ``start``. The first itself may come again."""
        if self._aligner is None:
            return image
        before, self._last = self._last, self._pyramid(image, visible)
        gain = self._between(before, self._last, self._aligner.rotation(before, self._last))
        if abs(np.log(gain)) >= LEAST:
            self._gain *= gain
        return scaled(image, self._gain, self.options.least_before)

    def _pyramid(self, image: NDArray[np.uint8], visible: NDArray[np.bool_] | None) -> list[F32]:
        luma = luma_of_frame(image, self._valid if visible is None else self._valid & visible)
        return pyramid(luma, self._scale.camera.width)

    def _between(self, before: list[F32], after: list[F32], turn: NDArray[np.float64] | None) -> float:
        """Gain of a frame over the one before; 1 if there is too little to compare. turn: as by the aligner."""
        s = self._scale
        then, now = before[s.level], after[s.level]
        if turn is not None:
            pixels, _ = s.camera.project(s.rays.reshape(-1, 3) @ turn[:3, :3])
            x, y = (pixels.astype(np.float32) - np.float32(0.5)).T.reshape(2, *now.shape)
            then = np.asarray(cv2.remap(then, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP))
        with np.errstate(invalid="ignore"):
            usable = (np.minimum(now, then) > DARK) & (now < SATURATED)
        if np.count_nonzero(usable) < ENOUGH:
            return 1.0
        return float(np.clip(weighted_median(now[usable] / then[usable], self._area[usable]), *RANGE))
