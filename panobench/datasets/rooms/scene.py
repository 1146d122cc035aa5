"""A scene ready for casting: mesh with dual edges, textures, materials, the tree and (once baked) light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.rooms.mesh import Mesh
from panobench.datasets.rooms.textures import TextureAtlas, make_texture, pack
from panobench.datasets.rooms.trace import build_bvh, plane_rows

Array = NDArray[np.float64]


@dataclass
class Geometry:
    """What rays need, float64 in world axes: p0, normal, dual edges (N, 3), shape (N,), two_sided (N,).

    dual_u . (x - p0) is u of a point x of the plane. boxes, links, planes, tree_shape, order: see ``trace``.
    """

    mesh: Mesh
    normal: Array
    dual_u: Array
    dual_v: Array
    boxes: NDArray[np.float32]
    links: NDArray[np.int32]
    order: NDArray[np.int64]
    planes: NDArray[np.float32]
    tree_shape: NDArray[np.int32]


def make_geometry(mesh: Mesh) -> Geometry:
    """Planes, dual bases and the tree of a mesh."""
    cross = np.cross(mesh.eu, mesh.ev)
    area = np.linalg.norm(cross, axis=1, keepdims=True)
    normal = cross / area
    dual_u = np.cross(mesh.ev, normal) / area
    dual_v = np.cross(normal, mesh.eu) / area
    corners = np.stack([mesh.p0, mesh.p0 + mesh.eu, mesh.p0 + mesh.ev, mesh.p0 + mesh.eu + mesh.ev])
    corners[3, mesh.shape == 1] = mesh.p0[mesh.shape == 1]
    boxes, links, order = build_bvh(corners.min(axis=0), corners.max(axis=0))
    rows = plane_rows(mesh.p0, normal, dual_u, dual_v)
    return Geometry(
        mesh,
        normal,
        dual_u,
        dual_v,
        boxes,
        links,
        order,
        rows[order],
        mesh.shape[order],
    )


@dataclass
class Surfaces:
    """What shading needs, float32/int32: per primitive ``look`` (N, 6): texture, macro texture (-1: none), light kind
    (0 grid, 1 triangle), and the three node numbers; uv (N, 6); tint (N, 3); coat (N,) Fresnel; macro (N,) strength;
    glow (N, 3) emission; albedo (N, 3) mean; light (M, 3): irradiance / pi at the nodes, exposure applied.
    """

    look: NDArray[np.int32]
    uv: NDArray[np.float32]
    tint: NDArray[np.float32]
    coat: NDArray[np.float32]
    macro: NDArray[np.float32]
    glow: NDArray[np.float32]
    albedo: NDArray[np.float32]
    atlas: TextureAtlas
    light: NDArray[np.float32]


def make_surfaces(mesh: Mesh, seed: int) -> Surfaces:
    """Generate the textures and flatten the materials; light is zero until baked."""
    names = sorted({m.texture for m in mesh.materials if m.texture} | {"macro"})
    number = {name: k for k, name in enumerate(names)}
    atlas = pack([np.full((1, 1, 3), 1.0, np.float32)] + [make_texture(name, seed) for name in names])
    tex = np.array(
        [number[m.texture] + 1 if m.texture else 0 for m in mesh.materials],
        dtype=np.int32,
    )
    macro = np.array([m.macro for m in mesh.materials], dtype=np.float32)
    coat = np.array([m.gloss for m in mesh.materials], dtype=np.float32)
    glow = np.array([m.emission for m in mesh.materials], dtype=np.float32)
    look = np.zeros((len(mesh.shape), 6), dtype=np.int32)
    look[:, 0] = tex[mesh.material]
    look[:, 1] = np.where(macro[mesh.material] > 0, number["macro"] + 1, -1)
    look[:, 2] = mesh.shape == 1
    look[:, 3:] = mesh.nodes
    tint = mesh.tint.astype(np.float32)
    shines = np.any(glow[mesh.material] > 0, axis=1, keepdims=True)
    return Surfaces(
        look=look,
        uv=mesh.uv.astype(np.float32),
        tint=tint,
        coat=coat[mesh.material],
        macro=macro[mesh.material],
        glow=glow[mesh.material] * tint,
        albedo=np.where(shines, 0, atlas.mean[look[:, 0]] * tint).astype(np.float32),
        atlas=atlas,
        light=np.zeros((len(mesh.node_pos), 3), dtype=np.float32),
    )


@dataclass
class Scene:
    """Geometry and surfaces together."""

    geometry: Geometry
    surfaces: Surfaces
