"""Parts of the map that have not been seen for a while sleep until a loop is closed on them.

A camera that comes back with a drift would otherwise be tracked against old and new Gaussians together: the old ones
pull it over bit by bit, the drift hides in the last frames, and nothing is left to measure. Compare the active and the
inactive model of Whelan et al., "ElasticFusion" (RSS 2015). Gaussians sleep and wake in groups, by the keyframe that
brought them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.mapper import Mapper
from panobench.splat.gaussians import GaussianMap

Numbers = NDArray[np.int64]

#: Keyframes for which a group must not have been seen, and the share of its Gaussians that counts as seen.
AFTER, SEEN_SHARE = 20, 0.1
#: Nobody sleeps unless this share of the map would.
SHARE_MIN = 0.15


def anchors_of(born: NDArray[np.int32]) -> Numbers:
    """Number of the keyframe that brought each Gaussian; ``born`` counts the keyframes there were by then."""
    return np.maximum(born.astype(np.int64) - 1, 0)


class Dormant:
    """The sleeping part of a mapper's map, with what its optimiser knows of it."""

    def __init__(self) -> None:
        self.map = GaussianMap.empty()
        self.born = np.zeros(0, np.int32)
        self._adam: list[NDArray] = []
        self._seen: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self.map)

    def update(self, mapper: Mapper, touched: NDArray[np.int32]) -> int:
        """Note what the newest keyframe sees, and put to sleep what has not been seen; returns how many went."""
        number, anchors = len(mapper.keyframes) - 1, anchors_of(mapper.born)
        size = np.bincount(anchors, minlength=number + 1)
        seen = np.bincount(anchors[: len(touched)], weights=touched > 0, minlength=number + 1)
        for k in np.flatnonzero(size):
            if seen[k] >= SEEN_SHARE * size[k] or k not in self._seen:
                self._seen[int(k)] = number
        old = np.array([self._seen.get(k, number) < number - AFTER for k in range(len(size))])
        gone = old[anchors]
        awake_and_asleep = len(gone) + len(self)
        if np.count_nonzero(gone) + len(self) < SHARE_MIN * awake_and_asleep or not gone.any():
            return 0
        self._take(mapper, gone)
        return int(np.count_nonzero(gone))

    def wake(self, mapper: Mapper, groups: NDArray[np.bool_] | None = None) -> int:
        """Give the mapper back the groups of these keyframes (K,), or all; returns how many Gaussians woke."""
        anchors = anchors_of(self.born)
        up = np.ones(len(self), bool) if groups is None else groups[anchors]
        count = int(np.count_nonzero(up))
        if count == 0:
            return 0
        number, adam = len(mapper.keyframes) - 1, mapper.adam
        mapper.append(self.map.select(up), self.born[up])
        for mine, kept in zip((adam.m, adam.v, adam.steps), self._adam):
            mine[-count:] = kept[up]
        for k in np.unique(anchors[up]):
            self._seen[int(k)] = number
        self.map, self.born = self.map.select(~up), self.born[~up]
        self._adam = [kept[~up] for kept in self._adam]
        return count

    def _take(self, mapper: Mapper, gone: NDArray[np.bool_]) -> None:
        adam = mapper.adam
        taken = [a[gone] for a in (adam.m, adam.v, adam.steps)]
        self._adam = [np.concatenate([a, b]) for a, b in zip(self._adam, taken)] if self._adam else taken
        self.map = self.map.concat(mapper.map.select(gone))
        self.born = np.concatenate([self.born, mapper.born[gone]])
        mapper.drop(gone)

    def whole(self, mapper: Mapper) -> GaussianMap:
        """The map with what sleeps."""
        return mapper.map.concat(self.map) if len(self) else mapper.map
