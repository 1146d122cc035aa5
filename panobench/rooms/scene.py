"""A scene that is ready to render: mesh with dual edges and hierarchy, textures, materials and baked light."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.rooms.cells import Cells
from panobench.rooms.mesh import TRIANGLE, Mesh
from panobench.rooms.textures import TextureAtlas, make_texture, pack
from panobench.rooms.trace import build_bvh, plane_rows

Array = NDArray[np.float64]


@dataclass
class Geometry:
    """What casting rays needs, in world axes: unit normals (N, 3) and dual edges (N, 6), float64.

    For a point x of primitive i's plane, u = duals[i, :3] . (x - p0[i]) and v = duals[i, 3:] . (x - p0[i]).
    ``trace`` explains boxes, links, planes, tree_shape and order, the bounding volume hierarchy. cells: None where
    everything may be seen from everywhere.
    """

    mesh: Mesh
    normal: Array
    duals: Array
    boxes: NDArray[np.float32]
    links: NDArray[np.int32]
    order: NDArray[np.int64]
    planes: NDArray[np.float32]
    tree_shape: NDArray[np.int32]
    cells: Cells | None = None

    def __post_init__(self) -> None:
        self._all = np.arange(len(self.normal), dtype=np.int32)

    def seen_from(self, point: Array) -> NDArray[np.int32]:
        """Numbers of the primitives that may be seen from a point (3,)."""
        return self._all if self.cells is None else self.cells.primitives(point)


def make_geometry(mesh: Mesh, cells: Cells | None = None) -> Geometry:
    """Normals, dual edges and bounding volume hierarchy of a mesh."""
    cross = np.cross(mesh.eu, mesh.ev)
    area = np.linalg.norm(cross, axis=1, keepdims=True)
    normal = cross / area
    dual_u = np.cross(mesh.ev, normal) / area
    dual_v = np.cross(normal, mesh.eu) / area
    corners = np.stack([mesh.p0, mesh.p0 + mesh.eu, mesh.p0 + mesh.ev, mesh.p0 + mesh.eu + mesh.ev])
    corners[3, mesh.shape == TRIANGLE] = mesh.p0[mesh.shape == TRIANGLE]
    boxes, links, order = build_bvh(corners.min(axis=0), corners.max(axis=0))
    rows = plane_rows(mesh.p0, normal, dual_u, dual_v)
    return Geometry(
        mesh,
        normal,
        np.hstack([dual_u, dual_v]),
        boxes,
        links,
        order,
        rows[order],
        mesh.shape[order],
        cells,
    )


@dataclass
class Surfaces:
    """What shading needs; ``shading`` names the columns.

    look:   (N, 7) texture, macro texture (-1: none), kind of light nodes (0 grid, 1 triangle), ``Mesh.nodes``, group.
    paint:  (N, 14) texture coordinates as ``Mesh.uv``, tint, macro strength, emission, reflectance of the coat.
    albedo: (N, 3) mean linear colour; 0 for a primitive that emits.
    light:  (M, 3) irradiance / pi at the nodes, linear RGB; zero until baked.
    """

    look: NDArray[np.int32]
    paint: NDArray[np.float32]
    albedo: NDArray[np.float32]
    atlas: TextureAtlas
    light: NDArray[np.float32]


def make_surfaces(mesh: Mesh, seed: int, threads: int = 1) -> Surfaces:
    """Generate the textures and write every primitive's material into its row."""
    names = sorted({m.texture for m in mesh.materials if m.texture} | {"macro"})
    number = {name: k + 1 for k, name in enumerate(names)}
    with ThreadPoolExecutor(threads) as pool:
        images = list(pool.map(lambda name: make_texture(name, seed), names))
    atlas = pack([np.full((1, 1, 3), 1.0, np.float32), *images])
    tex = np.array([number[m.texture] if m.texture else 0 for m in mesh.materials], dtype=np.int32)[mesh.material]
    macro = np.array([m.macro for m in mesh.materials], dtype=np.float32)[mesh.material]
    coat = np.array([m.gloss for m in mesh.materials], dtype=np.float32)[mesh.material]
    glow = np.array([m.emission for m in mesh.materials], dtype=np.float32)[mesh.material]
    kind = (mesh.shape == TRIANGLE).astype(np.int32)
    look = np.column_stack([tex, np.where(macro > 0, number["macro"], -1), kind, mesh.nodes, mesh.group])
    shines = np.any(glow > 0, axis=1, keepdims=True)
    return Surfaces(
        look=np.ascontiguousarray(look, dtype=np.int32),
        paint=np.column_stack([mesh.uv, mesh.tint, macro, glow * mesh.tint, coat]).astype(np.float32),
        albedo=np.where(shines, 0, atlas.mean[tex] * mesh.tint).astype(np.float32),
        atlas=atlas,
        light=np.zeros((len(mesh.node_pos), 3), dtype=np.float32),
    )


@dataclass
class Scene:
    """Geometry and surfaces together."""

    geometry: Geometry
    surfaces: Surfaces
