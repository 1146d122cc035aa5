"""What the parts are laid over: a room rendered anew for each frame, or the images of any sequence."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import upright_rotation
from panobench.capture.casting import Light, light_of
from panobench.rooms import render, visibility
from panobench.rooms.world import World

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Cosine that tells the room's kernels that a cone holds no ray.
NO_RAYS = 2.0
#: Width of the panorama that lights what is put into a scene.
AROUND = 96


@dataclass(frozen=True)
class RayField:
    """Unit rays (H, W, 3), zero where there is none, and their derivatives per pixel."""

    rays: Array
    ray_x: Array
    ray_y: Array

    @cached_property
    def seen(self) -> NDArray[np.bool_]:
        """(H, W): the pixel has a ray."""
        return np.asarray((self.rays[..., 0] != 0) | (self.rays[..., 1] != 0) | (self.rays[..., 2] != 0))

    @classmethod
    def of(cls, camera: Camera) -> RayField:
        bundle = render.ray_bundle(camera)
        return cls(bundle.exact, bundle.ray_x.astype(np.float64), bundle.ray_y.astype(np.float64))

    def turned(self, R: Array) -> RayField:
        """In other axes: ``R`` (3, 3) takes vectors to them."""
        return RayField(self.rays @ R.T, self.ray_x @ R.T, self.ray_y @ R.T)

    def with_rays(self, rays: Array) -> RayField:
        """Other rays, nearly the same derivatives."""
        return RayField(rays, self.ray_x, self.ray_y)

    def only(self, pixels: NDArray[np.bool_]) -> RayField:
        """Nothing elsewhere."""
        keep = pixels[..., None]
        return RayField(self.rays * keep, self.ray_x * keep, self.ray_y * keep)

    @cached_property
    def bundle(self) -> render.RayBundle:
        """For the room's kernels."""
        spread = 0.75 * np.sqrt(np.maximum(np.square(self.ray_x).sum(axis=-1), np.square(self.ray_y).sum(axis=-1)))
        exact = np.ascontiguousarray(self.rays)
        return render.RayBundle(
            rays=exact.astype(np.float32),
            exact=exact,
            ray_x=np.ascontiguousarray(self.ray_x, dtype=np.float32),
            ray_y=np.ascontiguousarray(self.ray_y, dtype=np.float32),
            coarse=_cones(exact, self.seen, spread, visibility.COARSE_W, visibility.COARSE_H),
            fine=_cones(exact, self.seen, spread, visibility.FINE_W, visibility.FINE_H),
        )


def _cones(rays: Array, seen: NDArray[np.bool_], spread: Array, tile_w: int, tile_h: int) -> Array:
    """The tiles' cones; tiles without a ray get the mark that nothing is to be looked for in them."""
    cones = np.asarray(visibility.tile_cones(rays, spread, tile_w, tile_h))
    rows, columns = np.nonzero(seen)
    empty = np.ones(cones.shape[:2], dtype=bool)
    empty[rows // tile_h, columns // tile_w] = False
    cones[empty, 3] = NO_RAYS
    return cones


class RoomScene:
    """A room one can photograph from anywhere."""

    def __init__(self, world: World, camera: Camera) -> None:
        self.world, self.camera = world, camera

    @cached_property
    def mount(self) -> Array:
        """(3, 3): the camera's axes in those of an upright one."""
        return np.asarray(upright_rotation(self.camera))

    @cached_property
    def T_wc(self) -> Array:
        """(N, 4, 4): the sequence's own poses."""
        T = self.world.path.T_wc.copy()
        T[:, :3, :3] = T[:, :3, :3] @ self.mount
        return T

    def radiance(self, field: RayField, T_wc: Array, sub: int = render.SUB) -> Array32:
        """Display-linear RGB (H, W, 3)."""
        return render.radiance(self.world.scene, field.bundle, T_wc, gain=self.world.path.exposure, sub=sub)

    @cached_property
    def _around(self) -> tuple[RayField, Array]:
        camera = ErpCamera(AROUND, AROUND // 2)
        return RayField.of(camera), camera.solid_angle()

    def light(self, T_wc: Array) -> Light:
        """What falls on something at a pose, in its axes."""
        field, area = self._around
        linear = self.radiance(field, T_wc, sub=2)
        return light_of(linear, field.rays, area, linear)

    def depth(self, field: RayField, T_wc: Array) -> Array32:
        """Radial depth (H, W); NaN where there is no ray."""
        return render.depth(self.world.geometry, field.bundle, T_wc)
