"""Makes a recording's frames: the scene row by row and lens by lens, who is in the way, and the lenses' colours."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.row_times import row_times
from panobench.capture.car import Car
from panobench.capture.casting import Coverage, Light, cast, light_of
from panobench.capture.lenses import Lens, gains, lens_weights, lenses
from panobench.capture.motion import Ride, levelling
from panobench.capture.operator import Operator
from panobench.capture.parts import Parts
from panobench.capture.scene import RayField, RoomScene
from panobench.capture.solids import Solids
from panobench.capture.walkers import Floor, Walkers
from panobench.geometry import hat, make_pose
from panobench.rooms.render import SUB, to_image

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]

#: Rows read while the camera turns by this much are seen from one place, radians.
SLICE = np.deg2rad(0.25)
MOST_SLICES = 16
#: Moments of an exposure that are averaged, per pixel of the motion's length, and at most.
PER_PIXEL, MOST_MOMENTS = 2.0, 9


@dataclass(frozen=True)
class Shot:
    """One frame: linear RGB (H, W, 3), and what hides the scene: shares (H, W) of the carrier and of walkers."""

    linear: Array32
    carrier: Array32
    walkers: Array32


def to_linear(image: NDArray[np.uint8]) -> Array32:
    """sRGB to linear RGB, 0..1."""
    x = np.arange(256) / 255
    table = np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4).astype(np.float32)
    return np.asarray(table[image])


@dataclass(frozen=True)
class Cast:
    """Who walks through a frame, in the world's axes, and the light there, in the camera's."""

    light: Light
    walkers: Solids | None


class Carrier:
    """The operator or the car, if there is one, in the axes of the camera."""

    def __init__(self, parts: Parts, mount: Array) -> None:
        self.seed = parts.seed
        self._who = Operator(parts.operator, parts.seed) if parts.operator else None
        self._car = Car(parts.car, parts.seed) if parts.car else None
        self._mount = make_pose(mount, np.zeros(3)).T

    def coverage(self, rays: Array, origin: Array, t: float, light: Light) -> Coverage | None:
        """Seen along ``rays`` (H, W, 3) from ``origin`` (3,), both in the camera's axes."""
        carrier = self._who or self._car
        if carrier is None:
            return None
        solids = carrier.solids(t).moved(self._mount)
        return cast(solids, rays.astype(np.float32), make_pose(np.eye(3), origin), light, seed=self.seed)


class RoomStudio:
    """A room as a recording shows it."""

    def __init__(self, scene: RoomScene, parts: Parts, times: Array, noise: float, seed: int) -> None:
        self.scene, self.parts, self.times = scene, parts, times
        self.camera: Camera = scene.camera
        self._noise, self._seed = noise, seed

    @cached_property
    def ride(self) -> Ride:
        p = self.parts
        return Ride(
            self.times, self.scene.T_wc, mount=self.scene.mount, gait=p.gait, tilt=p.tilt, turn=p.turn, seed=p.seed
        )

    @cached_property
    def T_wc(self) -> Array:
        """(N, 4, 4): where the picture's axes are at the middle of each frame."""
        T = np.stack([self.ride.pose(float(t)) for t in self.times])
        for i in range(len(T) if self._turned_picture else 0):
            T[i, :3, :3] = T[i, :3, :3] @ self._levelling(i)
        return T

    @property
    def _turned_picture(self) -> bool:
        return bool(self.parts.levelled or self.parts.locked)

    def _levelling(self, index: int) -> Array:
        M = make_pose(self.scene.mount, np.zeros(3))
        T = self.ride.pose(float(self.times[index])) @ M.T
        ahead = (self.ride.pose(float(self.times[0])) @ M.T)[:3, 2] if self.parts.locked else None
        return np.asarray(M[:3, :3].T @ levelling(T, np.array([0.0, 0.0, 1.0]), ahead) @ M[:3, :3])

    @cached_property
    def _field(self) -> RayField:
        return RayField.of(self.camera)

    @cached_property
    def _carrier(self) -> Carrier:
        return Carrier(self.parts, self.scene.mount)

    @cached_property
    def walkers(self) -> Walkers | None:
        if not self.parts.walkers:
            return None
        floor = Floor.of(self.scene.world.plan.mesh, self.T_wc[:, :3, 3])
        return Walkers(floor, self.T_wc[:, :3, 3], self.times, self.parts.walkers, self.parts.seed)

    def prepare(self) -> None:
        """Make what frames share, before threads ask for it."""
        _ = (self.T_wc, self._field, self._carrier, self.walkers)
        self.scene.light(self.T_wc[0])

    def depth(self, index: int) -> Array32:
        """Radial depth (H, W) of the scene at a frame's middle, as if nobody were there."""
        return self.scene.depth(self._field, self.T_wc[index])

    def image(self, index: int) -> NDArray[np.uint8]:
        shot = self.shoot(index)
        return to_image(shot.linear, sigma=self._noise, seed=self._seed * 1_000_003 + index * 7919 + 17)

    def shoot(self, index: int) -> Shot:
        """A frame, exposed around ``times[index]``."""
        t = float(self.times[index])
        field = self._field.turned(self._levelling(index)) if self._turned_picture else self._field
        rows = row_times(self.camera, field.rays) * self.parts.rolling if self.parts.rolling else None
        cast_of = Cast(self.scene.light(self.ride.pose(t)), self.walkers.solids(t) if self.walkers else None)
        moments = self._moments(t)
        total = np.zeros((*field.rays.shape[:2], 5), dtype=np.float32)
        for lens in self._lenses(field.rays):
            view = field.with_rays(lens.rays(field.rays)).only((lens.weight > 0) & field.seen)
            layers = np.zeros_like(total)
            for moment in moments:
                layers += self._instant(view, lens.origin, t + moment, rows, cast_of, coarse=len(moments) > 1)
            layers = self._with_carrier(layers / np.float32(len(moments)), view, lens.origin, t, cast_of.light)
            total += layers * lens.weight[..., None].astype(np.float32)
        linear = total[..., :3]
        if self.parts.lenses:
            linear = linear * lens_gains(field.rays, t, self.parts)
        return Shot(linear, total[..., 3], total[..., 4])

    def _lenses(self, rays: Array) -> list[Lens]:
        return lenses(rays, self.parts.stitch)

    def _moments(self, t: float) -> Array:
        """Offsets (M,) in seconds at which an exposure is sampled."""
        if not self.parts.blur:
            return np.zeros(1)
        pixels = np.linalg.norm(self.ride.rate(t)) * self.parts.blur * self.camera.width / (2 * np.pi)
        count = int(np.clip(np.ceil(PER_PIXEL * (pixels + 1)), 3, MOST_MOMENTS))
        return np.asarray(((np.arange(count) + 0.5) / count - 0.5) * self.parts.blur)

    def _instant(
        self, view: RayField, origin: Array, t: float, rows: Array | None, cast_of: Cast, coarse: bool
    ) -> Array32:
        """(H, W, 5) without the carrier: linear RGB, 0, share of walkers; rows read at t + ``rows`` (H, W)."""
        out = np.zeros((*view.rays.shape[:2], 5), dtype=np.float32)
        if rows is None:
            self._add(out, view, origin, t, cast_of, coarse)
            return out
        turned = float(np.linalg.norm(self.ride.rate(t))) * self.parts.rolling
        count = int(np.clip(np.ceil(turned / SLICE), 4, MOST_SLICES))
        edges = np.linspace(rows.min(), rows.max() + 1e-12, count + 1)
        for low, high in itertools.pairwise(edges):
            pixels = (rows >= low) & (rows < high) & view.seen
            if not pixels.any():
                continue
            middle = t + 0.5 * (low + high)
            part = view.only(pixels)
            # Within a slice the turning is exact to first order; the place is that of its middle.
            rays = part.rays + (rows + t - middle)[..., None] * (part.rays @ hat(self.ride.rate(middle)).T)
            rays /= np.maximum(np.sqrt(np.square(rays).sum(axis=-1, keepdims=True)), 1e-12)
            self._add(out, part.with_rays(rays), origin, middle, cast_of, coarse)
        return out

    def _add(self, out: Array32, view: RayField, origin: Array, t: float, cast_of: Cast, coarse: bool) -> None:
        T = self.ride.pose(t)
        T[:3, 3] += T[:3, :3] @ origin
        linear = self.scene.radiance(view, T, 2 if coarse else SUB)
        if cast_of.walkers is not None:
            depth = self.scene.depth(view, T)
            people = cast(cast_of.walkers, view.bundle.rays, T, cast_of.light, depth=depth, sub=2, seed=self.parts.seed)
            linear = people.over(linear)
            out[..., 4] += people.share
        out[..., :3] += linear

    def _with_carrier(self, layers: Array32, view: RayField, origin: Array, t: float, light: Light) -> Array32:
        # The carrier moves with the camera: neither shutter nor exposure smears it.
        carrier = self._carrier.coverage(view.rays, origin, t, light)
        if carrier is None:
            return layers
        people = layers[..., 4] * (1 - carrier.share)
        return np.concatenate(
            [carrier.over(layers[..., :3]), carrier.share[..., None], people[..., None]], axis=-1
        ).astype(np.float32)


class ImageStudio:
    """The images of any sequence with a carrier laid over them and the lenses' colours."""

    def __init__(self, camera: Camera, parts: Parts, mount: Array) -> None:
        self.camera, self.parts = camera, parts
        self._field, self._area = RayField.of(camera), camera.solid_angle()
        self._carrier = Carrier(parts, mount)

    def shoot(self, image: NDArray[np.uint8], t: float) -> Shot:
        linear = to_linear(image)
        panorama = None
        if self.camera.kind == "erp":
            panorama = np.asarray(cv2.resize(linear, (96, 48), interpolation=cv2.INTER_AREA), dtype=np.float32)
        light = light_of(linear, self._field.rays, self._area, panorama)
        carrier = self._carrier.coverage(self._field.rays, np.zeros(3), t, light)
        nobody = np.zeros(linear.shape[:2], dtype=np.float32)
        if carrier is not None:
            linear = carrier.over(linear)
        if self.parts.lenses:
            linear = linear * lens_gains(self._field.rays, t, self.parts)
        return Shot(linear, nobody if carrier is None else carrier.share, nobody)


def lens_gains(rays: Array, t: float, parts: Parts) -> Array32:
    """(H, W, 3) factors of the lenses' exposure and white balance."""
    front, back = lens_weights(rays)
    a, b = gains(t, parts.lenses, parts.seed)
    return np.asarray(front[..., None] * a + back[..., None] * b, dtype=np.float32)
