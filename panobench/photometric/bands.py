"""Bands of flickering light: how bright rows are beside the frame before, and the wave over rows and time that fits.

Lamps on the mains change faster than a rolling shutter reads. The rows of a frame see a wave, whose phase is another in
the next frame. What the camera sees as it moves changes rows as well, but as no single wave that goes on over frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.photometric.pyramid import F32

F64 = NDArray[np.float64]
C128 = NDArray[np.complex128]

#: Luma (of 1) below and above which a pixel does not tell how bright it is lit.
DARK, SATURATED = 0.06, 0.97
#: Changes from frame to frame that tell of bands.
WINDOW = 10
#: Least share of all changes that bands explain. Of rows that grow lighter and darker again where they are, as when a
#: camera bobs, a wave that travels explains half at most. Measured shares are in reports/wild.md.
SHARE = 0.6
#: Least amplitude of the log brightness.
LEAST = 0.01
#: Waves that are taken out: the bands' own and its first harmonic.
WAVES = 2
#: Weight of what a frame shows beside what the bands' own frequency predicts.
TRUST = 0.5
#: Size (width, height) at which rows are compared, and the fewest pixels that tell how bright one is.
SIZE, FEWEST = (128, 64), 16
#: Where these rows are, as a share of the picture's height.
ROWS = (np.arange(SIZE[1]) + 0.5) / SIZE[1]
#: Waves that are looked for, in cycles over the picture's height; above that the rows compared are too few.
CYCLES = np.arange(0.75, 8.01, 0.25)
#: Highest frequency that is looked for, hertz: a lamp flickers with twice that of the mains, 50 or 60 Hz.
HERTZ = 125.0
#: Frequencies are looked for in these steps over the time watched, and never in more than that many.
STEP, MOST = 0.25, 1000
#: The wave has to change from frame to frame: mean squared change over its amplitude's square, at least.
WANDERS = 0.15


@dataclass(frozen=True)
class Bands:
    """A wave of brightness over rows and time.

    cycles: over the height of the picture. hertz: how fast its phase goes on, up to what the frame rate leaves open.
    phasor: complex amplitude of the log brightness at the first row and frame. share: of all that changes between
    frames, row by row, what the wave explains.
    """

    cycles: float
    hertz: float
    phasor: complex
    share: float

    @property
    def amplitude(self) -> float:
        return abs(self.phasor)

    @property
    def evident(self) -> bool:
        """Whether there are bands without doubt."""
        return self.share >= SHARE and self.amplitude >= LEAST

    def numbers(self) -> dict[str, float]:
        """For run.json."""
        known = {"amplitude": self.amplitude, "cycles": self.cycles, "hertz": self.hertz, "share": self.share}
        return {name: round(number, 4) for name, number in known.items()}


def small_luma(image: NDArray[np.uint8]) -> F32:
    """(64, 128) of 1: an image (H, W, 3) as small as its rows are compared."""
    small = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
    return np.asarray(small.mean(axis=2, dtype=np.float32) / np.float32(255))


def log_row_gains(before: F32, after: F32) -> F64:
    """(64,): log brightness of the rows of ``after`` over those of ``before``; NaN where too few pixels tell.

    The median over a row's pixels: what moves changes some of them.
    """
    usable = (np.minimum(before, after) > DARK) & (np.maximum(before, after) < SATURATED)
    gains = np.full(len(before), np.nan)
    for row in np.flatnonzero(np.count_nonzero(usable, axis=1) >= FEWEST):
        known = usable[row]
        gains[row] = np.log(np.median(after[row, known] / before[row, known]))
    return gains


def find_bands(gains: Sequence[F64], times: Sequence[float]) -> Bands | None:
    """The wave that explains most. gains: n of ``log_row_gains``; times (n + 1,) of the frames, in seconds.

    None if nothing changes, or the times tell nothing.
    """
    steps, seconds = np.diff(times), float(times[-1] - times[0])
    if seconds <= 0 or np.median(steps) <= 0:
        return None
    x = np.stack([_without_slope(g) for g in gains])
    known = np.isfinite(x)
    x = np.where(known, x, 0.0)
    total = float((x**2).sum())
    if total < 1e-9:
        return None
    at = np.asarray(times) - times[0]
    count = min(int(min(HERTZ, 4 / np.median(steps)) * seconds / STEP), MOST)
    best = _best_wave(x, known, at, CYCLES, np.arange(count, dtype=np.float64) * STEP / seconds)
    around = np.linspace(-1, 1, 11)
    cycles = np.asarray(best.cycles + 0.25 * around, np.float64)
    hertz = np.asarray(np.abs(best.hertz + STEP / seconds * around), np.float64)
    best = _best_wave(x, known, at, cycles, hertz)
    return Bands(best.cycles, best.hertz, best.phasor, best.share / total)


def _without_slope(gains: F64) -> F64:
    """Gains without their mean and slope over the rows, which exposure and motion change; NaN if few are known."""
    known = np.isfinite(gains)
    if np.count_nonzero(known) < len(gains) // 4:
        return np.full_like(gains, np.nan)
    return np.asarray(gains - np.polyval(np.polyfit(ROWS[known], gains[known], 1), ROWS))


def _best_wave(x: F64, known: NDArray[np.bool_], at: F64, cycles: F64, hertz: F64) -> Bands:
    """Of all pairs of cycles and hertz; its ``share`` is the energy that it explains in x (n, rows)."""
    turned = np.exp(2j * np.pi * hertz[:, None] * at)
    change = np.diff(turned, axis=1)  # (frequencies, n)
    rows = known.sum(axis=1)
    norm = (np.abs(change) ** 2 * rows).sum(axis=1)
    best = Bands(float(cycles[0]), float(hertz[0]), 0j, 0.0)
    for c in cycles:
        amplitudes = 2 * (x @ np.exp(-2j * np.pi * c * ROWS))
        phasors = (change.conj() @ amplitudes) / np.maximum(norm, 1e-9)
        energy = np.where(norm > WANDERS * rows.sum(), 0.5 * np.abs(phasors) ** 2 * norm, 0.0)
        k = int(energy.argmax())
        if energy[k] > best.share:
            best = Bands(float(c), float(hertz[k]), complex(phasors[k]), float(energy[k]))
    return best


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

    def steady(self, image: NDArray[np.uint8], time: float) -> NDArray[np.uint8]:
        """The image (H, W, 3) of the next frame without its bands."""
        luma = small_luma(image)
        predicted = self._phasors * self._turn(time - self._time)
        change = None if self._last is None else self._change(log_row_gains(self._last, luma))
        seen = predicted if change is None else self._phasors + change
        self._phasors = (1 - TRUST) * predicted + TRUST * seen
        self._time, self._last = time, luma
        return self._without_bands(image)

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
