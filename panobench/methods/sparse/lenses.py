"""Where bearings begin: the centres of a rig's lenses. A central camera is one lens at the origin.

Each face belongs to a lens, and a bearing to that of its nearest face. So no observation needs to keep which lens it is
from, and the geometry of central cameras holds with one vector more.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lenses:
    """centres (L, 3) in the camera's axes, metres. axes (F, 3): where the faces look; lens (F,): whose they are."""

    centres: Array = field(default_factory=lambda: np.zeros((1, 3)))
    axes: Array = field(default_factory=lambda: np.zeros((0, 3)))
    lens: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def several(self) -> bool:
        """Whether there is more than one centre."""
        return len(self.centres) > 1

    def of(self, bearings: Array) -> NDArray[np.int64]:
        """The lens (N,) that sees along bearings (N, 3)."""
        if not self.several:
            return np.zeros(len(bearings), np.int64)
        return np.asarray(self.lens[np.argmax(bearings @ self.axes.T, axis=1)])

    def origins(self, bearings: Array) -> Array | None:
        """Where bearings (N, 3) begin, (N, 3); None for one centre at the origin."""
        return self.centres[self.of(bearings)] if self.several else None

    def bearings(self, points: Array) -> Array:
        """Unit bearings (N, 3) of points (N, 3) in the camera's axes, each from the lens that sees it."""
        if self.several:
            points = points - self.centres[self.of(points)]
        return np.asarray(points / np.maximum(np.linalg.norm(points, axis=1, keepdims=True), 1e-12))

    def sees(self, points: Array) -> NDArray[np.bool_]:
        """Whether each of the points (N, 3) is on the side of the lens it is nearest to.

        Between two lenses back to back lies a layer as thick as their distance, of which each sees what belongs to the
        other: bearings there would be taken for those of the wrong lens.
        """
        if not self.several:
            return np.ones(len(points), dtype=bool)
        return np.asarray(self.of(points) == self.of(self.bearings(points)))

    def between(self, relative: Array, first: Array, second: Array) -> Array:
        """Translations (N, 3) between the lenses of two bearings each (N, 3), of cameras at ``relative`` (N, 4, 4).

        x2 = R x1 + t with x1 from the first bearing's lens and x2 from the second's.
        """
        t = np.asarray(relative[:, :3, 3])
        if not self.several:
            return t
        turned = np.einsum("nij,nj->ni", relative[:, :3, :3], self.centres[self.of(first)])
        return np.asarray(t + turned - self.centres[self.of(second)])

    def places(self, T_wc: Array, bearings: Array, distance: Array) -> Array:
        """World points (N, 3) ``distance`` (N,) along bearings (N, 3) of cameras at ``T_wc`` (N, 4, 4)."""
        local = bearings * distance[:, None]
        if self.several:
            local = local + self.centres[self.of(bearings)]
        return np.asarray(np.einsum("nij,nj->ni", T_wc[:, :3, :3], local) + T_wc[:, :3, 3])
