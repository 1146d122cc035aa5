"""Figures made of two solids that a ray meets in closed form: round cones and ellipsoids, each with a material.

A round cone is the hull of two spheres, which is what limbs, fingers and rails are made of. It is the envelope of the
spheres with centres c(s) = a + s d and radii r(s) = ra + s e, 0 <= s <= 1: with w = x - a, the sphere that touches x is
at s = (w.d + ra e) / (d.d - e^2), and x lies on the hull where |w|^2 - ra^2 - (w.d + ra e)^2 / (d.d - e^2) = 0, a
quadratic along a ray. Where s leaves 0..1 the end's sphere takes over.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

CONE, ELLIPSOID = 0, 1
#: Columns of ``Solids.shape``: a cone's end, radius, axis d = b - a and e = rb - ra; an ellipsoid's centre and the
#: rows of the matrix that makes it a unit sphere.
CONE_A, CONE_RA, CONE_D, CONE_E = slice(0, 3), 3, slice(4, 7), 7
ELLIPSOID_C, ELLIPSOID_M = slice(0, 3), slice(3, 12)
#: Kinds of surface.
PLAIN, SKIN, CLOTH, STRIPES, CHECK, HAIR, PAINT = range(7)


@dataclass(frozen=True)
class Material:
    """A surface: its kind, two linear RGB colours, metres per repeat of its pattern, and the strength of its folds."""

    kind: int
    colour: tuple[float, float, float]
    second: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scale: float = 0.05
    folds: float = 0.0

    def row(self) -> list[float]:
        return [float(self.kind), *self.colour, *self.second, self.scale, self.folds]


@dataclass(frozen=True)
class Solids:
    """Arrays for the caster: kind (N,), shape (N, 12), bound (N, 4) spheres, frame (N, 3, 3) rows of the local axes,
    centre (N, 3) of the local axes, material (N,) rows of ``materials`` (M, 9).
    """

    kind: NDArray[np.int32]
    shape: Array
    bound: Array
    frame: Array
    centre: Array
    material: NDArray[np.int32]
    materials: Array

    def __len__(self) -> int:
        return len(self.kind)

    def moved(self, T: ArrayLike) -> Solids:
        """The same in other axes: ``T`` (4, 4) takes points from these axes to the new ones."""
        T = np.asarray(T, dtype=np.float64)
        R, t = T[:3, :3], T[:3, 3]
        shape, bound = self.shape.copy(), self.bound.copy()
        shape[:, :3] = self.shape[:, :3] @ R.T + t
        bound[:, :3] = self.bound[:, :3] @ R.T + t
        cones = self.kind == CONE
        shape[cones, CONE_D] = self.shape[cones, CONE_D] @ R.T
        M = self.shape[~cones, ELLIPSOID_M].reshape(-1, 3, 3) @ R.T
        shape[~cones, ELLIPSOID_M] = M.reshape(-1, 9)
        return Solids(self.kind, shape, bound, self.frame @ R.T, self.centre @ R.T + t, self.material, self.materials)


def joined(parts: Sequence[Solids]) -> Solids:
    """Several figures as one."""
    offsets = np.cumsum([0, *(len(p.materials) for p in parts[:-1])])
    return Solids(
        np.concatenate([p.kind for p in parts]),
        np.concatenate([p.shape for p in parts]),
        np.concatenate([p.bound for p in parts]),
        np.concatenate([p.frame for p in parts]),
        np.concatenate([p.centre for p in parts]),
        np.concatenate([p.material + np.int32(k) for p, k in zip(parts, offsets)]),
        np.concatenate([p.materials for p in parts]),
    )


@dataclass
class Builder:
    """Collects solids. ``front`` is the direction that keeps patterns from turning about a limb's axis."""

    front: tuple[float, float, float] = (0.0, 1.0, 0.0)
    _rows: list[tuple[int, Array, Array, Array, Array, int]] = field(default_factory=list)
    _materials: dict[Material, int] = field(default_factory=dict)

    def cone(self, a: ArrayLike, b: ArrayLike, ra: float, rb: float, material: Material) -> None:
        """The hull of two spheres."""
        a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
        d, e = b - a, rb - ra
        length = float(np.linalg.norm(d))
        if length <= abs(e) + 1e-6:  # one sphere holds the other
            r = max(ra, rb)
            self.ellipsoid(a if ra >= rb else b, (r, r, r), np.eye(3), material)
            return
        shape = np.zeros(12)
        shape[CONE_A], shape[CONE_RA], shape[CONE_D], shape[CONE_E] = a, ra, d, e
        bound = np.array([*(0.5 * (a + b)), 0.5 * length + max(ra, rb)])
        self._add(CONE, shape, bound, _axes(d / length, np.asarray(self.front)), a, material)

    def ellipsoid(self, centre: ArrayLike, radii: ArrayLike, R: ArrayLike, material: Material) -> None:
        """``R`` (3, 3) takes the ellipsoid's axes to the figure's."""
        c, r = np.asarray(centre, dtype=np.float64), np.asarray(radii, dtype=np.float64)
        R = np.asarray(R, dtype=np.float64)
        shape = np.zeros(12)
        shape[ELLIPSOID_C], shape[ELLIPSOID_M] = c, (R.T / r[:, None]).ravel()
        self._add(ELLIPSOID, shape, np.array([*c, r.max()]), R.T, c, material)

    def _add(self, kind: int, shape: Array, bound: Array, frame: Array, centre: Array, material: Material) -> None:
        number = self._materials.setdefault(material, len(self._materials))
        self._rows.append((kind, shape, bound, frame, centre, number))

    def build(self) -> Solids:
        kind, shape, bound, frame, centre, material = zip(*self._rows)
        return Solids(
            np.array(kind, dtype=np.int32),
            np.stack(shape),
            np.stack(bound),
            np.stack(frame),
            np.stack(centre),
            np.array(material, dtype=np.int32),
            np.array([m.row() for m in self._materials]),
        )


def _axes(along: Array, front: Array) -> Array:
    """Rows: an orthonormal frame whose third axis is ``along`` and whose second is as near to ``front`` as can be."""
    if abs(along @ front) > 0.95:
        front = np.array([front[2], front[0], front[1]])
    second = front - (front @ along) * along
    second /= np.linalg.norm(second)
    return np.stack([np.cross(second, along), second, along])
