"""Collects the primitives of a scene: flat pieces, boxes, smooth grids, and shapes made of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.rooms.mesh import DISC, RECT, TRIANGLE, Array, Material, Mesh, RectLight


@dataclass
class Builder:
    """Collects primitives in local frames that ``at`` nests. Positions and sizes are in metres.

    rng: for texture offsets and dents. node_spacing: distance between light nodes. lights, sun: see ``Mesh``.
    """

    rng: np.random.Generator
    node_spacing: float = 0.07
    lights: list[RectLight] = field(default_factory=list)
    sun: tuple[Array, Array] | None = None

    def __post_init__(self) -> None:
        self._frame = np.eye(4)
        self._prims: list[tuple[Array, ...]] = []
        self._meta: list[tuple[int, int, int, bool]] = []
        self._tint: list[tuple[float, float, float]] = []
        self._uv: list[ArrayLike] = []
        self._nodes: list[tuple[int, int, int]] = []
        self._node_pos: list[Array] = []
        self._node_normal: list[Array] = []
        self._node_two: list[NDArray[np.bool_]] = []
        self._node_count = 0
        self._materials: dict[Material, int] = {}
        self._groups = 0
        self._cell = -1
        self._cell_of: list[int] = []

    # -- placement ---------------------------------------------------------------------------------------------
    @contextmanager
    def at(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, yaw: float = 0.0) -> Iterator[None]:
        """In the block, everything is rotated by ``yaw`` radians about z, then moved to (x, y, z)."""
        keep = self._frame
        c, s = np.cos(yaw), np.sin(yaw)
        step = np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]])
        self._frame = keep @ step
        try:
            yield
        finally:
            self._frame = keep

    @contextmanager
    def cell(self, number: int) -> Iterator[None]:
        """In the block, primitives belong to a cell (see ``cells``)."""
        keep, self._cell = self._cell, number
        try:
            yield
        finally:
            self._cell = keep

    @property
    def members(self) -> NDArray[np.int32]:
        """The cell (N,) of each primitive so far; -1: none."""
        return np.asarray(self._cell_of, dtype=np.int32)

    def world(self, points: ArrayLike) -> Array:
        """Local points (..., 3) in world axes."""
        return np.asarray(points, dtype=np.float64) @ self._frame[:3, :3].T + self._frame[:3, 3]

    def _rotated(self, vectors: ArrayLike) -> Array:
        return np.asarray(vectors, dtype=np.float64) @ self._frame[:3, :3].T

    def new_group(self) -> int:
        """Number of a new group; primitives of one group are one surface to the anti-aliasing."""
        self._groups += 1
        return self._groups

    def _material(self, m: Material) -> int:
        plain = replace(m, tint=(1.0, 1.0, 1.0))  # tints are kept per primitive
        return self._materials.setdefault(plain, len(self._materials))

    # -- primitives --------------------------------------------------------------------------------------------
    def quad(
        self,
        p0: ArrayLike,
        eu: ArrayLike,
        ev: ArrayLike,
        material: Material,
        *,
        shape: int = RECT,
        two_sided: bool = False,
        group: int | None = None,
        spacing: float | None = None,
        origin: tuple[float, float] | None = None,
        along_v: bool = False,
        uv: tuple[float, ...] | None = None,
    ) -> None:
        """A flat piece with corner ``p0`` and edges ``eu``, ``ev``.

        group:   one from ``new_group``; None: a group of its own.
        spacing: between light nodes; None: ``node_spacing``.
        origin:  (s, t) of the texture at p0, metres; None: random.
        along_v: the texture's s axis (the grain of wood) runs along ``ev`` instead of ``eu``.
        uv:      texture coordinates as in ``Mesh``, instead of ``origin`` and ``along_v``.
        """
        p, a, b = self.world(p0), self._rotated(eu), self._rotated(ev)
        la, lb = float(np.linalg.norm(a)), float(np.linalg.norm(b))
        if uv is not None:
            pass
        elif material.scale == 0.0:
            uv = (0.0, 1.0, 0.0, 1.0, 0.0, -1.0)  # the picture's top row at v = 1
        else:
            k = 1.0 / material.scale
            o = self.rng.uniform(0, 1, 2) if origin is None else np.asarray(origin) * k
            uv = (o[0], 0.0, lb * k, o[1], la * k, 0.0) if along_v else (o[0], la * k, 0.0, o[1], 0.0, lb * k)
        step = self.node_spacing if spacing is None else spacing
        nu, nv = (int(np.clip(np.ceil(x / step) + 1, 2, 200)) for x in (la, lb))
        # Nodes on the edges are moved inwards, so that their rays do not start inside a neighbour.
        u = np.clip(np.linspace(0, 1, nu), min(0.01 / la, 0.2), 1 - min(0.01 / la, 0.2))
        v = np.clip(np.linspace(0, 1, nv), min(0.01 / lb, 0.2), 1 - min(0.01 / lb, 0.2))
        pos = p + v[:, None, None] * b + u[None, :, None] * a
        n = np.cross(a, b)
        n = n / np.linalg.norm(n)
        base = self._add_nodes(pos.reshape(-1, 3), np.broadcast_to(n, (nu * nv, 3)), two_sided)
        self._add(
            p,
            a,
            b,
            shape,
            material,
            self.new_group() if group is None else group,
            two_sided,
            uv,
        )
        self._nodes.append((base, nu, nv))

    def box(
        self,
        lo: ArrayLike,
        hi: ArrayLike,
        material: Material,
        *,
        skip: str = "",
        grain: int | None = None,
        spacing: float | None = None,
    ) -> None:
        """A box along the local axes.

        skip:  faces to leave out, of "x" (at the lower x), "X" (at the upper x), "y", "Y", "z", "Z".
        grain: axis, 0 to 2, that the texture's s direction follows; None: the longest.
        """
        lo, hi = np.asarray(lo, dtype=np.float64), np.asarray(hi, dtype=np.float64)
        d = hi - lo
        g = int(np.argmax(d)) if grain is None else grain
        ex, ey, ez = np.diag(d)
        faces = {
            "x": (lo, ez, ey, 2, 1),
            "X": (lo + ex, ey, ez, 1, 2),
            "y": (lo, ex, ez, 0, 2),
            "Y": (lo + ey, ez, ex, 2, 0),
            "z": (lo, ey, ex, 1, 0),
            "Z": (lo + ez, ex, ey, 0, 1),
        }
        for name, (p, a, b, ia, ib) in faces.items():
            if name in skip or d[ia] <= 0 or d[ib] <= 0:
                continue
            along_v = ib == g or (ia != g and d[ib] > d[ia])
            self.quad(p, a, b, material, along_v=along_v, spacing=spacing)

    def grid(
        self,
        points: ArrayLike,
        material: Material,
        *,
        wrap: tuple[bool, bool] = (False, False),
        two_sided: bool = False,
        group: int | None = None,
        flip: bool = False,
    ) -> None:
        """A smooth surface through (m, n, 3) points; ``wrap``: whether its first and last row, column coincide.

        The front side is that of cross(d/d column, d/d row); ``flip`` swaps it. Texture coordinates are arc lengths.
        """
        p = self.world(points)
        if flip:
            p = p[:, ::-1]
        m, n = p.shape[:2]
        dc = _difference(p, 1, wrap[1])
        dr = _difference(p, 0, wrap[0])
        normal = np.cross(dc, dr)
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        centre = p.reshape(-1, 3).mean(axis=0)
        normal = np.where(
            length > 1e-12, normal / np.maximum(length, 1e-12), p - centre
        )  # at the poles of closed shapes: away from the centre
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
        base = self._add_nodes(p.reshape(-1, 3), normal.reshape(-1, 3), two_sided)
        k = 1.0 / (material.scale or 1.0)
        s = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=1), axis=-1).max(axis=0))]) * k
        t = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p, axis=0), axis=-1).max(axis=1))]) * k
        o = self.rng.uniform(0, 1, 2)
        gid = self.new_group() if group is None else group
        for i in range(m - 1):
            for j in range(n - 1):
                for tri in (
                    ((i, j), (i, j + 1), (i + 1, j)),
                    ((i + 1, j + 1), (i + 1, j), (i, j + 1)),
                ):
                    (i0, j0), (i1, j1), (i2, j2) = tri
                    a, b = p[i1, j1] - p[i0, j0], p[i2, j2] - p[i0, j0]
                    if np.linalg.norm(np.cross(a, b)) < 1e-9:
                        continue
                    uv = [o[0] + s[j0], s[j1] - s[j0], s[j2] - s[j0], o[1] + t[i0], t[i1] - t[i0], t[i2] - t[i0]]
                    self._add(p[i0, j0], a, b, TRIANGLE, material, gid, two_sided, uv)
                    self._nodes.append((base + i0 * n + j0, base + i1 * n + j1, base + i2 * n + j2))

    # -- shapes made of the above ------------------------------------------------------------------------------
    def lathe(
        self,
        profile: Sequence[tuple[float, float]],
        material: Material,
        *,
        sides: int = 16,
    ) -> None:
        """Surface of revolution about the local z axis; ``profile``: (radius, z), the outside to the right going up."""
        a = np.linspace(0, 2 * np.pi, sides + 1)
        a[-1] = 0.0
        rz = np.asarray(profile, dtype=np.float64)
        x, y = rz[:, :1] * np.cos(a), rz[:, :1] * np.sin(a)
        z = np.broadcast_to(rz[:, 1:], x.shape)
        self.grid(np.stack([x, y, z], axis=-1), material, wrap=(False, True))

    def disc(self, centre: ArrayLike, radius: float, material: Material, *, up: bool = True) -> None:
        """A horizontal disc facing up or down."""
        c, r = np.asarray(centre, dtype=np.float64), radius
        a, b = np.array([2 * r, 0, 0]), np.array([0, 2 * r, 0])
        self.quad(c - (a + b) / 2, *((a, b) if up else (b, a)), material, shape=DISC)

    def cylinder(
        self,
        base: ArrayLike,
        radius: float,
        height: float,
        material: Material,
        *,
        sides: int = 12,
        caps: str = "Z",
    ) -> None:
        """Upright cylinder on the centre ``base``; ``caps``: "z" (bottom), "Z" (top), both or none."""
        b = np.asarray(base, dtype=np.float64)
        with self.at(*b):
            self.lathe([(radius, 0.0), (radius, height)], material, sides=sides)
        if "Z" in caps:
            self.disc(b + [0, 0, height], radius, material)
        if "z" in caps:
            self.disc(b, radius, material, up=False)

    def tube(
        self,
        points: ArrayLike,
        radius: float,
        material: Material,
        *,
        sides: int = 6,
    ) -> None:
        """A round tube along a polyline (m, 3), for cables, handles and lamp arms."""
        p = np.asarray(points, dtype=np.float64)
        t = _difference(p[:, None], 0, False)[:, 0]
        t /= np.maximum(np.linalg.norm(t, axis=1, keepdims=True), 1e-12)
        ref = np.eye(3)[np.argmin(np.abs(t).max(axis=0))]
        e1 = np.cross(t, ref)
        e1 /= np.maximum(np.linalg.norm(e1, axis=1, keepdims=True), 1e-12)
        e2 = np.cross(t, e1)
        a = np.linspace(0, 2 * np.pi, sides + 1)
        a[-1] = 0.0
        ring = p[:, None] + radius * (np.cos(a)[None, :, None] * e1[:, None] + np.sin(a)[None, :, None] * e2[:, None])
        self.grid(ring, material, wrap=(False, True))

    def blob(
        self,
        centre: ArrayLike,
        radii: ArrayLike,
        material: Material,
        *,
        square: float = 0.5,
        sides: int = 16,
        rows: int = 9,
        dent: float = 0.0,
    ) -> None:
        """A superellipsoid (Barr 1981). square: 1 is an ellipsoid, towards 0 a rounded box. dent: adds soft waves."""
        lat = np.linspace(-np.pi / 2, np.pi / 2, rows)
        lon = np.linspace(-np.pi, np.pi, sides + 1)
        lon[-1] = -np.pi

        def power(x: Array) -> Array:
            return np.sign(x) * np.abs(x) ** square

        cl, sl = power(np.cos(lat))[:, None], power(np.sin(lat))[:, None]
        cl[[0, -1]] = 0.0
        unit = np.stack(
            [cl * power(np.cos(lon)), cl * power(np.sin(lon)), sl * np.ones_like(lon)],
            axis=-1,
        )
        if dent:
            ph = self.rng.uniform(0, 6.28, 3)
            bump = np.sin(3 * unit[..., 0] + ph[0]) * np.sin(3 * unit[..., 1] + ph[1]) + np.sin(4 * lon + ph[2]) * cl
            unit = unit * (1 + dent * 0.5 * bump[..., None])
        self.grid(np.asarray(centre) + unit * np.asarray(radii), material, wrap=(False, True))

    def rect_light(self, p0: ArrayLike, eu: ArrayLike, ev: ArrayLike, radiance: ArrayLike) -> None:
        """A light that only ``bake`` sees; an emissive quad makes it visible."""
        self.lights.append(
            RectLight(
                self.world(p0),
                self._rotated(eu),
                self._rotated(ev),
                np.asarray(radiance, dtype=np.float64),
            )
        )

    # -- bookkeeping -------------------------------------------------------------------------------------------
    def _add(
        self,
        p: Array,
        a: Array,
        b: Array,
        shape: int,
        material: Material,
        group: int,
        two_sided: bool,
        uv: ArrayLike,
    ) -> None:
        self._prims.append((p, a, b))
        self._cell_of.append(self._cell)
        self._meta.append((shape, self._material(material), group, two_sided))
        self._tint.append(material.tint)
        self._uv.append(uv)

    def _add_nodes(self, pos: Array, normal: Array, two_sided: bool) -> int:
        base = self._node_count
        self._node_pos.append(pos)
        self._node_normal.append(np.array(normal))
        self._node_two.append(np.full(len(pos), two_sided))
        self._node_count += len(pos)
        return base

    def build(self) -> Mesh:
        """The finished mesh."""
        prims = np.asarray(self._prims, dtype=np.float64)
        meta = np.asarray(self._meta, dtype=np.int32)
        return Mesh(
            p0=np.ascontiguousarray(prims[:, 0]),
            eu=np.ascontiguousarray(prims[:, 1]),
            ev=np.ascontiguousarray(prims[:, 2]),
            shape=meta[:, 0].copy(),
            material=meta[:, 1].copy(),
            group=meta[:, 2].copy(),
            two_sided=meta[:, 3].astype(bool),
            tint=np.asarray(self._tint, dtype=np.float64),
            uv=np.asarray(self._uv, dtype=np.float64),
            nodes=np.asarray(self._nodes, dtype=np.int32),
            node_pos=np.concatenate(self._node_pos),
            node_normal=np.concatenate(self._node_normal),
            node_two=np.concatenate(self._node_two),
            materials=list(self._materials),
            lights=self.lights,
            sun=self.sun,
        )


def _difference(p: Array, axis: int, wrap: bool) -> Array:
    """Central differences along ``axis``; with ``wrap`` the first and last samples are the same point."""
    if not wrap:
        return np.asarray(np.gradient(p, axis=axis)) if p.shape[axis] > 1 else np.zeros_like(p)
    q = np.moveaxis(p, axis, 0)
    core = q[:-1]
    d = (np.roll(core, -1, axis=0) - np.roll(core, 1, axis=0)) / 2
    return np.moveaxis(np.concatenate([d, d[:1]]), 0, axis)
