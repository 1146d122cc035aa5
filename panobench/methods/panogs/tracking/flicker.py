"""Flicker: bands of light that wander over the frames of a rolling shutter are found, and taken out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.tracking.bands import (
    C128,
    F64,
    ROWS,
    Bands,
    find_bands,
    log_row_gains,
    small_luma,
)
from panobench.photometric.pyramid import F32
from panobench.types import Frame

#: Changes from frame to frame that tell of bands; they are looked for again after so many more frames.
WINDOW, AGAIN = 10, 5
#: Least share of all changes that bands explain. Of rows that grow lighter and darker again where they are, as when a
#: camera bobs, a wave that travels explains half at most. Measured shares are in reports/wild.md.
SHARE = 0.6
#: Least amplitude of the log brightness.
LEAST = 0.01
#: Waves that are taken out: the bands' own and its first harmonic.
WAVES = 2
#: Weight of what a frame shows beside what the bands' own frequency predicts.
TRUST = 0.5


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
        return frame if self._remover is None else self._remover.steady(frame)

    def _found(self) -> Bands | None:
        bands = find_bands(self._gains[-WINDOW:], [f.time for f in self._frames[-WINDOW - 1 :]])
        if bands is None or (self.mode == "auto" and (bands.share < SHARE or bands.amplitude < LEAST)):
            return None
        return bands

    def _stop(self) -> None:
        self.watching, self._last = False, None
        self._frames, self._gains = [], []


class BandRemover:
    """Divides frames by their bands, which it follows: they may grow, fade, and drift in their phase.

    time: of the frame that ``bands`` have their phasor at. The first frame may be an earlier one.
    """

    def __init__(self, bands: Bands, time: float) -> None:
        self.bands = bands
        harmonics = 2 * np.pi * bands.cycles * np.arange(1, WAVES + 1)
        self._harmonics = harmonics
        angles = ROWS[:, None] * harmonics
        self._model = np.concatenate([np.ones((len(ROWS), 1)), ROWS[:, None] - 0.5, np.cos(angles), np.sin(angles)], 1)
        self._time, self._last = time, None  # type: float, F32 | None
        self._phasors = np.zeros(WAVES, complex)
        self._phasors[0] = bands.phasor

    def steady(self, frame: Frame) -> Frame:
        """The next frame without its bands."""
        luma = small_luma(frame.image)
        predicted = self._phasors * self._turn(frame.time - self._time)
        change = None if self._last is None else self._change(log_row_gains(self._last, luma))
        seen = predicted if change is None else self._phasors + change
        self._phasors = (1 - TRUST) * predicted + TRUST * seen
        self._time, self._last = frame.time, luma
        return replace(frame, image=self._without_bands(frame.image))

    def _turn(self, seconds: float) -> C128:
        """(waves,): what the phasors are multiplied by after so long."""
        return np.asarray(np.exp(2j * np.pi * self.bands.hertz * seconds * np.arange(1, WAVES + 1)))

    def _change(self, gains: F64) -> C128 | None:
        """(waves,): change of the phasors that ``log_row_gains`` show; None if too few rows are known.

        Least squares with a constant and a slope, and once more with less weight for what does not fit.
        """
        known = np.isfinite(gains)
        if np.count_nonzero(known) < len(gains) // 4:
            return None
        A, b = self._model[known], gains[known]
        off = np.abs(b - A @ np.linalg.lstsq(A, b, rcond=None)[0])
        weights = 1 / np.maximum(1.0, off / (1.5 * np.median(off) + 1e-4))
        x = np.linalg.lstsq(A * weights[:, None], b * weights, rcond=None)[0]
        return np.asarray(x[2 : 2 + WAVES] - 1j * x[2 + WAVES :])

    def _without_bands(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        rows = (np.arange(len(image)) + 0.5) / len(image)
        log_gain = (np.exp(1j * rows[:, None] * self._harmonics) @ self._phasors).real
        return np.rint(np.clip(image / np.exp(log_gain)[:, None, None], 0, 255)).astype(np.uint8)
