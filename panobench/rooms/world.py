"""A room of a kind and a seed, with the camera path through it. Its light and poses are kept in the cache."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import UsageError
from panobench.rooms import cache, motion, walks
from panobench.rooms.exposure import auto_exposure
from panobench.rooms.kinds import KINDS, Kind
from panobench.rooms.mesh import TRIANGLE
from panobench.rooms.plans import Plan
from panobench.rooms.render import worker_count
from panobench.rooms.scene import Geometry, Scene, Surfaces, make_geometry, make_surfaces

Array = NDArray[np.float64]
NOVEL_VIEWS = 8
CLEARANCE = 0.3  # metres that the camera keeps from everything


@dataclass(frozen=True)
class CameraPath:
    """Camera-to-world poses of the frames (N, 4, 4) and of the novel views (8, 4, 4), and the scene's exposure.

    exposure: factor from radiance to display-linear values, before the tone curve. gains (N,): of each frame on top
    of it.
    """

    T_wc: Array
    novel: Array
    exposure: float
    gains: Array


class World:
    """Everything about one room that does not depend on the camera model. frames: None for the kind's own number."""

    def __init__(self, kind: str, seed: int, frames: int | None) -> None:
        self.name, self.seed = kind, seed
        self.kind: Kind = KINDS[kind]
        self.frames = frames or self.kind.motion.frames
        walk = self.kind.walk
        if walk is not None and self.kind.first + self.frames > walk.frames:
            most = walk.frames - self.kind.first
            raise UsageError(f"room option frames={self.frames}: the walk through '{kind}' ends after {most}")

    def rng(self, purpose: str) -> np.random.Generator:
        """Random numbers for one purpose, independent of other purposes and the same on every call."""
        name = self.kind.scene or self.name
        return np.random.default_rng([self.seed, zlib.crc32(name.encode()), zlib.crc32(purpose.encode())])

    def key(self) -> dict[str, Any]:
        """What the room and its path depend on, for cache keys."""
        return {"room": self.name, "seed": self.seed, "frames": self.frames}

    def _scene_key(self) -> dict[str, Any]:
        """What the baked light depends on, and the path that is kept beside it: a whole walk."""
        return self.key() if self.kind.walk is None else {"room": self.kind.scene, "seed": self.seed}

    @cached_property
    def plan(self) -> Plan:
        """The mesh, and the closed walk through it."""
        return self.kind.plan(self.rng("plan"))

    @cached_property
    def geometry(self) -> Geometry:
        """The mesh prepared for casting rays."""
        return make_geometry(self.plan.mesh, self.plan.cells)

    @cached_property
    def folder(self) -> Path:
        """Cache folder of the room's light and poses."""
        key = self._scene_key()
        return cache.cache_root() / "rooms" / f"{key['room']}-{self.seed}-{cache.key_of(key)}"

    @cached_property
    def _surfaces(self) -> Surfaces:
        return make_surfaces(self.plan.mesh, self.seed, worker_count())

    def _bake(self, folder: Path) -> None:
        from panobench.rooms.bake import bake

        g = self.geometry
        surfaces = self._surfaces
        light = bake(g, surfaces, worker_count())
        exposure = _exposure(g, light, surfaces.albedo)
        if self.kind.walk is not None:
            T_wc = walks.walk_poses(self.plan.walk, self.kind.walk, self.rng("path"))
            surfaces.light = light
            gains = auto_exposure(Scene(g, surfaces), T_wc, exposure)
            np.savez(folder / "room.npz", light=light, exposure=exposure, T_wc=T_wc, gains=gains)
            return
        T_wc = motion.clear_trajectory(
            self.plan.walk,
            self.kind.motion,
            self.frames,
            g.mesh,
            self.rng("path"),
            CLEARANCE,
        )
        novel = motion.novel_poses(T_wc, g.mesh, self.rng("novel"), NOVEL_VIEWS, CLEARANCE)
        np.savez(folder / "room.npz", light=light, exposure=exposure, T_wc=T_wc, novel=novel)

    def prepare(self) -> None:
        """Bake the light and choose the path, if the cache does not have them yet."""
        cache.publish(self.folder, self._bake)

    @cached_property
    def path(self) -> CameraPath:
        """Poses and exposure, from the cache."""
        self.prepare()
        with np.load(self.folder / "room.npz") as z:
            if self.kind.walk is None:
                return CameraPath(z["T_wc"], z["novel"], float(z["exposure"]), np.ones(len(z["T_wc"])))
            part = slice(self.kind.first, self.kind.first + self.frames)
            T_wc, gains, exposure = z["T_wc"][part], z["gains"][part], float(z["exposure"])
        novel = motion.novel_poses(T_wc, self.geometry.mesh, self.rng("novel"), NOVEL_VIEWS, CLEARANCE)
        return CameraPath(T_wc, novel, exposure, gains)

    @cached_property
    def scene(self) -> Scene:
        """Geometry, textures and baked light, ready to render."""
        self.prepare()
        surfaces = self._surfaces
        with np.load(self.folder / "room.npz") as z:
            surfaces.light = z["light"]
        return Scene(self.geometry, surfaces)


def _exposure(g: Geometry, light: NDArray[np.float32], albedo: NDArray[np.float32]) -> float:
    """Gain that brings the room's area-weighted log-mean radiance to 0.28 sqrt(log-mean albedo) of display white.

    So white rooms come out brighter than dark ones, as in a photograph.
    """
    mesh = g.mesh
    flat = mesh.shape != TRIANGLE
    area = np.linalg.norm(np.cross(mesh.eu, mesh.ev), axis=1)[flat]
    luma = np.array([0.21, 0.72, 0.07])
    brightness = light @ luma
    lit = np.array([brightness[a : a + n * m].mean() for a, n, m in mesh.nodes[flat]])
    reflectance = albedo[flat] @ luma
    ok = lit * reflectance > 1e-4
    weights = area[ok] / area[ok].sum()
    log_albedo = float(weights @ np.log(reflectance[ok]))
    log_radiance = float(weights @ np.log(lit[ok])) + log_albedo
    return float(0.28 * np.exp(0.5 * log_albedo - log_radiance))
