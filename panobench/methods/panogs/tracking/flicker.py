"""Flicker: bands of light that wander over the frames of a rolling shutter are found, and taken out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

from panobench.photometric.bands import F64, WINDOW, BandRemover, Bands, find_bands, log_row_gains, small_luma
from panobench.photometric.pyramid import F32
from panobench.types import Frame

#: Bands that are not found are looked for again after so many more frames.
AGAIN = 5


class Flicker:
    """Watches the first frames for bands, and takes them out of all frames if there are any.

    mode: "auto" asks for evidence, True takes what fits best for bands, False does nothing.
    """

    def __init__(self, mode: bool | Literal["auto"], log: Callable[[str], None]) -> None:
        self.mode, self.log = mode, log
        self.watching = mode is not False
        self.bands: Bands | None = None
        self._frames: list[Frame] = []
        self._gains: list[F64] = []
        self._remover: BandRemover | None = None
        self._last: F32 | None = None

    def watch(self, frame: Frame, *, waiting: bool) -> list[Frame]:
        """Take one more of the first frames. waiting: there is no map yet.

        All frames so far without their bands, once these have been found; an empty list otherwise.
        """
        self._frames.append(frame)
        luma = small_luma(frame.image)
        if self._last is not None:
            self._gains.append(log_row_gains(self._last, luma))
        self._last, n = luma, len(self._gains)
        if n < WINDOW or (n - WINDOW) % AGAIN:
            return []
        self.bands = self._found()
        if self.bands is None:
            if not waiting and n >= WINDOW + AGAIN:
                self._stop()
            return []
        self.log(
            f"bands of flickering light ({self.bands.amplitude:.1%}, {self.bands.cycles:.1f} over a picture) are "
            "taken out of all frames"
        )
        frames, self._remover = self._frames, BandRemover(self.bands, self._frames[-WINDOW - 1].time)
        self._stop()
        return [self.steady(f) for f in frames]

    def steady(self, frame: Frame) -> Frame:
        """The frame without its bands."""
        if self._remover is None:
            return frame
        return replace(frame, image=self._remover.steady(frame.image, frame.time))

    def _found(self) -> Bands | None:
        bands = find_bands(self._gains[-WINDOW:], [f.time for f in self._frames[-WINDOW - 1 :]])
        return bands if bands is not None and (bands.evident or self.mode is True) else None

    def _stop(self) -> None:
        self.watching, self._last = False, None
        self._frames, self._gains = [], []
