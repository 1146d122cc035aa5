"""What a visual method hands over: its poses, up to the scale and axes of its maps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class VisualPoses:
    """Poses by frame: times (N,) in s, increasing; T_wc (N, 4, 4), NaN for a frame without a pose; maps (N,).

    Frames of the same map share its scale and axes; -1 for a frame without a pose.
    """

    times: Array
    T_wc: Array
    maps: NDArray[np.int64]

    @classmethod
    def of_one_map(cls, times: Array, T_wc: Array) -> VisualPoses:
        """All poses that are not NaN are of one map."""
        known = np.isfinite(T_wc).all(axis=(1, 2))
        return cls(times, T_wc, np.where(known, 0, -1))

    def __len__(self) -> int:
        return len(self.times)

    @property
    def known(self) -> NDArray[np.bool_]:
        """(N,)"""
        return np.asarray(self.maps >= 0)

    def select(self, keep: NDArray[np.bool_] | NDArray[np.int64]) -> VisualPoses:
        """Some of the frames."""
        return VisualPoses(self.times[keep], self.T_wc[keep], self.maps[keep])


def pairs(visual: VisualPoses, span_s: float) -> NDArray[np.int64]:
    """Pairs (P, 2) of frames of the same map that are ``span_s`` or more apart, and at most four times that.

    A pair begins where the one before ends.
    """
    found = []
    known = np.flatnonzero(visual.known)
    begin = 0
    for end in range(1, len(known)):
        i, j = known[begin], known[end]
        apart = visual.times[j] - visual.times[i]
        if visual.maps[i] != visual.maps[j] or apart > 4 * span_s:
            begin = end
        elif apart >= span_s - 1e-6:
            found.append((i, j))
            begin = end
    return np.array(found, dtype=np.int64).reshape(-1, 2)


def overlapping_pairs(visual: VisualPoses, span_s: float) -> NDArray[np.int64]:
    """Pairs (P, 2) of frames of the same map: every frame and the first that follows by at least ``span_s``.

    Where none does within twice the span, a frame begins no pair, unless there would be no pair at all.
    """
    known = np.flatnonzero(visual.known)
    times = visual.times[known]
    ends = np.searchsorted(times, times + span_s - 1e-6)
    begins = np.flatnonzero(ends < len(known))
    ends = ends[begins]
    same = (visual.maps[known[begins]] == visual.maps[known[ends]]) & (times[ends] - times[begins] < 2 * span_s)
    found = np.column_stack([known[begins], known[ends]])[same]
    return found if len(found) else pairs(visual, span_s / 5)
