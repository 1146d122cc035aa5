"""The map: points in growing arrays, keyframes with their observations, and a record of every tracked frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.methods.sparse.lenses import Lenses
from panobench.methods.sparse.patches import STORED

Array = NDArray[np.float64]

CANDIDATE, ACTIVE, DEAD = 0, 1, 2


@dataclass
class Keyframe:
    """A keyframe: its pose T_cw (4, 4), the points it saw (n,) and their unit bearings (n, 3).

    measured (n, 3): the bearings before they were turned to the frame's middle row.
    """

    number: int
    frame: int
    T_cw: Array
    points: NDArray[np.int64]
    bearings: Array
    measured: Array | None = None

    def drop(self, lost: NDArray[np.bool_]) -> None:
        """Remove the observations where ``lost`` (n,) is True."""
        self.points, self.bearings = self.points[~lost], self.bearings[~lost]
        if self.measured is not None:
            self.measured = self.measured[~lost]


@dataclass
class FrameRecord:
    """A tracked frame: its pose relative to a keyframe, and its measurements for the final refinement."""

    index: int
    time: float
    keyframe: int
    T_ck: Array
    points: NDArray[np.int64]
    bearings: NDArray[np.float32]


_FIELDS: dict[str, tuple[tuple[int, ...], Any]] = {
    "position": ((3,), np.float64),  # world
    "state": ((), np.int8),
    "anchor": ((), np.int64),  # keyframe that the template was cut from
    "anchor_bearing": ((3,), np.float64),
    "bearing": ((3,), np.float64),  # last measurement, in the camera of the frame last_seen
    "last_seen": ((), np.int64),
    "visible": ((), np.int32),
    "found": ((), np.int32),
    "misses": ((), np.int32),  # frames in a row in which it was not found
    "parallax": ((), np.float64),  # largest so far, radians
    "descriptor": ((32,), np.uint8),  # of the template
    "_slot": ((), np.int64),  # where the template is, -1 once another point has its place
}


@dataclass
class PointMap:
    """Points in parallel arrays with spare capacity; attributes are views of the used part.

    Templates are a hundred times as large as the rest of a point, and most points die. New templates take the places of
    those of dead points.
    """

    levels: int
    lenses: Lenses = field(default_factory=Lenses)
    size: int = 0
    keyframes: list[Keyframe] = field(default_factory=list)
    _arrays: dict[str, NDArray[Any]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, (shape, dtype) in _FIELDS.items():
            self._arrays[name] = np.zeros((0, *shape), dtype)
        self._templates = np.zeros((0, self.levels, STORED, STORED), np.float32)
        self._templates_used = 0

    def __getattr__(self, name: str) -> NDArray[Any]:
        arrays = self.__dict__.get("_arrays", {})
        if name not in arrays:
            raise AttributeError(name)
        return arrays[name][: self.size]

    def add(self, count: int, template: NDArray[np.float32] | float = 0.0, **values: Any) -> NDArray[np.int64]:
        """Append ``count`` points with templates (count, levels, 16, 16) and these fields, all others zero.

        Returns their indices.
        """
        values["_slot"] = slots = self._places(count)
        self._templates[slots] = template
        new = self.size + count
        for name, array in self._arrays.items():
            if new > len(array):
                grown = np.zeros((max(new, 2 * len(array), 1024), *array.shape[1:]), array.dtype)
                grown[: self.size] = array[: self.size]
                self._arrays[name] = grown
            self._arrays[name][self.size : new] = values.get(name, 0)
        index = np.arange(self.size, new)
        self.size = new
        return index

    def _places(self, count: int) -> NDArray[np.int64]:
        """Where to put the templates of so many new points."""
        dead = np.flatnonzero((self.state == DEAD) & (self._slot >= 0))[:count]
        free = self._slot[dead]
        self._slot[dead] = -1
        first = self._templates_used
        self._templates_used += count - len(free)
        if self._templates_used > len(self._templates):
            grown = np.zeros((max(self._templates_used, 3 * first // 2, 1024), *self._templates.shape[1:]), np.float32)
            grown[:first] = self._templates[:first]
            self._templates = grown
        return np.concatenate([free, np.arange(first, self._templates_used)])

    def templates_on(self, points: NDArray[np.int64], level: int) -> NDArray[np.float32]:
        """(n, 16, 16) of points that are not dead, on a level of the pyramid."""
        return np.asarray(self._templates[self._slot[points], level])

    def renew_templates(self, points: NDArray[np.int64], templates: NDArray[np.float32]) -> None:
        """Replace the templates of points that are not dead."""
        self._templates[self._slot[points]] = templates

    def inverse_distance(self, index: NDArray[np.int64]) -> Array:
        """1 / distance (n,) from each point to its anchor keyframe, to the lens that the template is from."""
        centres = self.centres()[self.anchor[index]]
        origins = self.lenses.origins(self.anchor_bearing[index])
        if origins is not None:
            R_wc = np.swapaxes(self.poses()[:, :3, :3], 1, 2)[self.anchor[index]]
            centres = centres + np.einsum("nij,nj->ni", R_wc, origins)
        return np.asarray(1.0 / np.maximum(np.linalg.norm(self.position[index] - centres, axis=1), 1e-9))

    def poses(self) -> Array:
        """T_cw (K, 4, 4) of all keyframes."""
        return np.stack([k.T_cw for k in self.keyframes]) if self.keyframes else np.zeros((0, 4, 4))

    def centres(self) -> Array:
        """Camera centres (K, 3) of all keyframes."""
        T = self.poses()
        return np.asarray(-np.einsum("kji,kj->ki", T[:, :3, :3], T[:, :3, 3]))

    def observation_counts(self) -> NDArray[np.int64]:
        """How many keyframes see each point (N,)."""
        counts = np.zeros(self.size, np.int64)
        for k in self.keyframes:
            np.add.at(counts, k.points, 1)
        return counts
