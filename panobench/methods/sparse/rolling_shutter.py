"""Rolling shutter: bearings are turned to the moment of their frame's middle row, and the readout is estimated.

Frames are tracked as they are. At the end every bearing is rotated by what the camera turned between its own row and
the middle one; the angular velocities are those of the trajectory. What is left of a readout that nobody knows is one
number, and the bundle adjustment's cost is a smooth function of it with one minimum (compare Hedborg et al., "Rolling
shutter bundle adjustment", CVPR 2012).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from panobench.cameras.base import Camera
from panobench.cameras.rig import Rig
from panobench.cameras.row_times import rates_along, rig_row_times, rotated, row_times, velocities_along
from panobench.methods.sparse.bundle import bundle_adjust
from panobench.methods.sparse.pointmap import ACTIVE, FrameRecord, Keyframe, PointMap

Array = NDArray[np.float64]

#: Readouts that are looked for, seconds; a negative one reads the rows upwards.
BOUNDS = (-0.04, 0.04)
#: The readout is taken for none unless it moves bearings by this in the root mean square, pixels ...
LEAST_PX = 0.05
#: ... lowers the cost by this share, and is at least this long, seconds.
LEAST_GAIN, LEAST_S = 0.01, 0.002
#: Residual from which the cost is linear, pixels: patches that are aligned wrongly would shorten the readout.
HUBER_PX = 0.15
#: So many keyframes in a row, those of the fastest rotation, are enough to tell.
MOST_KEYFRAMES = 40


@dataclass(frozen=True)
class Readout:
    """seconds: 0 for a global shutter. best_s: where the cost is least. gain: by what share of it.

    moved_px: how far 10 ms would move bearings, root mean square.
    """

    seconds: float
    best_s: float = 0.0
    gain: float = 0.0
    moved_px: float = 0.0


class RowBearings:
    """The bearings of keyframes and frames as they were measured, which can be turned to the middle of their frames.

    rig: the lenses whose rows they are of, where there are several; else they are the camera's.
    """

    def __init__(self, camera: Camera, m: PointMap, records: list[FrameRecord], rig: Rig | None = None) -> None:
        self.camera, self.map, self.rig = camera, m, rig
        self.records = sorted(records, key=lambda r: r.index)
        self.measured = [r.bearings.astype(np.float64) for r in self.records]
        self.rates: dict[int, Array] = {}
        self.velocities: dict[int, Array] = {}
        for key in m.keyframes:
            key.measured = key.bearings.copy()

    def follow(self, T_wc: Array) -> None:
        """Take the angular velocities from the poses (N, 4, 4) of the frames, in the order of their indices."""
        times = np.array([r.time for r in self.records])
        self.rates = {r.index: rate for r, rate in zip(self.records, rates_along(times, T_wc))}
        self.velocities = {r.index: v for r, v in zip(self.records, velocities_along(times, T_wc))}

    def of_keyframe(self, key: Keyframe, readout_s: float) -> Array:
        """Bearings (n, 3) of a keyframe's observations at its middle row."""
        assert key.measured is not None
        return self._turned(key.measured, readout_s, self.rates.get(key.frame, np.zeros(3)))

    def origins(self, key: Keyframe, readout_s: float) -> Array:
        """Where these bearings begin (n, 3), in the axes of the middle row: their lens, and what has been travelled."""
        assert key.measured is not None
        rows, lenses = self._row_times(key.measured), self.map.lenses.origins(key.measured)
        travelled = np.asarray(readout_s * rows[:, None] * self.velocities.get(key.frame, np.zeros(3)))
        return travelled if lenses is None else lenses + travelled

    def turn(self, readout_s: float) -> None:
        """Give keyframes and frames their bearings at the middle row."""
        for key in self.map.keyframes:
            key.bearings = self.of_keyframe(key, readout_s)
        for record, measured in zip(self.records, self.measured):
            record.bearings = self._turned(measured, readout_s, self.rates[record.index]).astype(np.float32)

    def _turned(self, bearings: Array, readout_s: float, rate: Array) -> Array:
        return rotated(bearings, readout_s * self._row_times(bearings), rate)

    def _row_times(self, bearings: Array) -> Array:
        if not len(bearings):
            return np.zeros(0)
        return rig_row_times(self.rig, bearings) if self.rig else row_times(self.camera, bearings[:, None])[:, 0]


def estimate_readout(rows: RowBearings, m: PointMap, focal: float) -> Readout:
    """The readout at which a bundle adjustment of the keyframes costs least; nothing in the map is changed.

    A global shutter has its minimum near 0. One elsewhere counts only if it explains plainly more: distortions of a
    lens that is known badly also change with the row.
    """
    members = _fastest(rows, m)
    frames, points, bearings = _observations(m, members)
    if len(bearings) < 200 or len(members) < 3:
        return Readout(0.0)
    turned = np.concatenate([rows.of_keyframe(m.keyframes[k], 0.01)[use] for k, use in _used(m, members)])
    moved_px = float(focal * np.sqrt(np.square(turned - bearings).sum(axis=1).mean()))
    if moved_px < LEAST_PX:  # at 10 ms nothing would be seen of it
        return Readout(0.0, moved_px=moved_px)
    used = _used(m, members)
    ids, points = np.unique(points, return_inverse=True)
    T, fixed = m.poses()[members], np.arange(len(members)) == 0

    def cost(readout_s: float) -> float:
        b = np.concatenate([rows.of_keyframe(m.keyframes[k], readout_s)[use] for k, use in used])
        o = np.concatenate([rows.origins(m.keyframes[k], readout_s)[use] for k, use in used])
        return bundle_adjust(T, m.position[ids], frames, points, b, fixed, focal, HUBER_PX, 15, o).cost

    found = minimize_scalar(cost, bounds=BOUNDS, method="bounded", options={"xatol": 2e-4, "maxiter": 14})
    best, gain = float(found.x), 1.0 - float(found.fun) / max(cost(0.0), 1e-12)
    moves = moved_px * abs(best) / 0.01 >= LEAST_PX
    rolling = gain >= LEAST_GAIN and abs(best) >= LEAST_S and moves and abs(best) < 0.98 * BOUNDS[1]
    return Readout(best if rolling else 0.0, best, gain, moved_px)


def _fastest(rows: RowBearings, m: PointMap) -> list[int]:
    """Numbers of at most MOST_KEYFRAMES keyframes in a row, those with the fastest rotation."""
    speed = np.array([np.linalg.norm(rows.rates.get(k.frame, np.zeros(3))) for k in m.keyframes])
    if len(speed) <= MOST_KEYFRAMES:
        return list(range(len(speed)))
    sums = np.convolve(speed, np.ones(MOST_KEYFRAMES), mode="valid")
    first = int(np.argmax(sums))
    return list(range(first, first + MOST_KEYFRAMES))


def _used(m: PointMap, members: list[int]) -> list[tuple[int, NDArray[np.int64]]]:
    """For each keyframe, which of its observations are of points that at least two of the keyframes see."""
    counts = np.zeros(m.size, np.int64)
    for k in members:
        np.add.at(counts, m.keyframes[k].points, 1)
    good = (m.state == ACTIVE) & (counts >= 2)
    return [(k, np.flatnonzero(good[m.keyframes[k].points])) for k in members]


def _observations(m: PointMap, members: list[int]) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Position among the members, point, and bearing as measured of every observation used."""
    used = _used(m, members)
    frames = np.concatenate([np.full(len(use), n) for n, (_, use) in enumerate(used)])
    points = np.concatenate([m.keyframes[k].points[use] for k, use in used])
    bearings = np.concatenate([m.keyframes[k].bearings[use] for k, use in used])
    return frames, points, bearings
