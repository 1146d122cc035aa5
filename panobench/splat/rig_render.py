"""Rendering a rig's panorama: each lens's share of the pixels is drawn from that lens's own centre."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig_panorama import RigPanorama
from panobench.geometry import make_pose
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.render import Gradients, Moments, Render, Renderer
from panobench.splat.view import Projection

Array = NDArray[np.float64]


@dataclass
class RigRender(Render):
    """What a rig sees of a map. ``depth`` is the distance from the lens that sees a pixel.

    parts: the renders of the lenses, whole tiles each; shares (L, H, W): the pixels that are theirs. centres (L, 3):
    of the lenses, in the map's unit.
    """

    parts: tuple[Render, ...] = ()
    shares: NDArray[np.bool_] = field(default_factory=lambda: np.zeros((0, 0, 0), bool))
    centres: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def gaussians(self) -> GaussianMap:
        """The map it shows. Raises RuntimeError once detached."""
        return self.parts[0].gaussians

    def detach(self) -> RigRender:
        return replace(self, parts=tuple(part.detach() for part in self.parts))

    def backward(
        self, d_colour: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None, *, planar: bool = False
    ) -> Gradients:
        d_planes = d_colour if planar else np.moveaxis(d_colour, -1, 0)
        packed, pose = None, np.zeros(6)
        for part, share, centre in zip(self.parts, self.shares, self.centres):
            own = [None if d is None else d * share for d in (d_depth, d_opacity)]
            found = part.backward(d_planes * share, *own, planar=True)
            packed = found.packed if packed is None else packed + found.packed
            # A twist (v, w) of the rig moves a lens at c by (v + w x c, w).
            pose += found.pose
            pose[3:] += np.cross(centre, found.pose[:3])
        assert packed is not None
        return Gradients(packed, pose)

    def weighted_sums(self, planes: F32) -> F32:
        parts = [part.weighted_sums(planes * share) for part, share in zip(self.parts, self.shares)]
        return np.asarray(np.sum(parts, axis=0))

    def moments(self, d_planes: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None) -> Moments:
        """There are none of all lenses together. Raises TypeError."""
        raise TypeError("a rig's render has the moments of its parts")


class RigRenderer(Renderer):
    """As ``Renderer``, for a rig's panorama; on the CPU alone."""

    def __init__(
        self,
        camera: RigPanorama,
        projection: Projection = "sphere",
        low_pass: float = 0.3,
        near: float = 0.01,
        stop: float = 1e-4,
        threads: int | None = None,
    ) -> None:
        super().__init__(camera, projection, low_pass, near, stop, threads)
        assert camera.lenses is not None
        self.lenses = camera.lenses
        numbers = range(len(self.lenses.centres_m))
        self._shares = np.stack([camera.lens == number for number in numbers])
        visible = camera.valid_mask()
        plain = ErpCamera(camera.width, camera.height)
        self._parts = [
            Renderer(plain.with_mask(share & visible), projection, low_pass, near, stop, threads)
            for share in self._shares
        ]

    def forward(self, gaussians: GaussianMap, T_wc: Array, **wanted: Any) -> RigRender:
        """Render from the rig's pose ``T_wc`` (4, 4); options as for ``Renderer.forward``."""
        centres = self.lenses.centres
        parts = [
            part.forward(gaussians, T_wc @ make_pose(np.eye(3), centre), **wanted)
            for part, centre in zip(self._parts, centres)
        ]

        def pixels(name: str) -> F32:
            return np.asarray(sum(getattr(p, name) * share for p, share in zip(parts, self._shares)), np.float32)

        def counts(name: str) -> Any:
            return None if getattr(parts[0], name) is None else sum(getattr(p, name) for p in parts)

        return RigRender(
            pixels("planes"), pixels("depth"), pixels("opacity"), counts("touched"),
            np.unique(np.concatenate([p.order for p in parts])), counts("weights"), self.view.pixel_angle, None,
            tuple(parts), self._shares, centres,
        )  # fmt: skip


def renderer_for(camera: Any, projection: Projection, low_pass: float, **options: Any) -> Renderer:
    """The renderer of any camera; ``options`` are those of ``Renderer``, of which a rig's has no device."""
    if isinstance(camera, RigPanorama):
        return RigRenderer(camera, projection, low_pass, **{k: v for k, v in options.items() if k != "device"})
    return Renderer(camera, projection, low_pass, **options)
