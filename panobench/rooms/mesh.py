"""A scene as arrays of parallelograms and triangles, the only primitives that rays are cast against.

World frame: x and y span the floor, z is up, in metres. A primitive is a corner ``p0`` with edges ``eu`` and ``ev``.
Its front side is that of ``cross(eu, ev)``. ``shape`` cuts a rectangle, triangle, disc or leaf out of it exactly.
Curved objects are triangle meshes with smooth light. Every primitive has light nodes, at which ``bake`` stores its
light: a grid for a flat piece, the three mesh vertices for a triangle.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RECT, TRIANGLE, DISC, LEAF = 0, 1, 2, 3


@dataclass(frozen=True)
class Material:
    """How a surface looks.

    texture:  name of a generated texture (see ``textures``), or "" for a plain surface.
    scale:    metres per repeat of the texture; 0: one repeat fills the primitive.
    tint:     linear RGB factor on the albedo.
    macro:    strength of the slow albedo variation that hides the texture's repeats.
    gloss:    reflectance of a mirror coat at normal incidence; 0: no coat.
    emission: linear RGB radiance.
    """

    texture: str = ""
    scale: float = 1.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    macro: float = 0.0
    gloss: float = 0.0
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def tinted(self, r: float, g: float, b: float) -> Material:
        """The same material with its tint multiplied by linear (r, g, b)."""
        t = self.tint
        return replace(self, tint=(t[0] * r, t[1] * g, t[2] * b))


@dataclass(frozen=True)
class RectLight:
    """A rectangle that emits ``radiance`` (linear RGB) from its front side. Only ``bake`` sees it."""

    p0: Array
    eu: Array
    ev: Array
    radiance: Array


@dataclass
class Mesh:
    """N primitives and M light nodes as arrays; the module's docstring defines a primitive.

    p0, eu, ev:  (N, 3) corner and edges.
    shape:       (N,) RECT, TRIANGLE, DISC or LEAF.
    material:    (N,) index into ``materials``.
    group:       (N,) primitives of one group are one surface to the anti-aliasing.
    two_sided:   (N,) visible and lit from both sides.
    tint:        (N, 3) linear RGB.
    uv:          (N, 6) texture coordinates s = uv[0] + u uv[1] + v uv[2] and t = uv[3] + u uv[4] + v uv[5] at the
                 point p0 + u eu + v ev.
    nodes:       (N, 3) of a triangle: the nodes at (u, v) = (0, 0), (1, 0), (0, 1); else first node, columns, rows.
    node_pos, node_normal: (M, 3). node_two: (M,) the node collects light from both sides.
    sun:         unit direction towards the sun, and its radiance x solid angle / pi; None: no sun.
    """

    p0: Array
    eu: Array
    ev: Array
    shape: NDArray[np.int32]
    material: NDArray[np.int32]
    group: NDArray[np.int32]
    two_sided: NDArray[np.bool_]
    tint: Array
    uv: Array
    nodes: NDArray[np.int32]
    node_pos: Array
    node_normal: Array
    node_two: NDArray[np.bool_]
    materials: list[Material]
    lights: list[RectLight]
    sun: tuple[Array, Array] | None
