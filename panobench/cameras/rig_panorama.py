"""A rig's pictures as one panorama of many centres: each pixel shows what one lens sees, from that lens's own centre.

A direction belongs to the lens whose axis is nearest to it, so no pixel needs to keep which lens it is from. Nothing is
stitched: pictures are only turned into the rig's axes, and pixels where two lenses meet are not valid.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Array
from panobench.cameras.erp import ErpCamera
from panobench.cameras.reproject import Reprojector
from panobench.cameras.rig import Rig

#: Pixels nearer to another lens's share than this are not valid: interpolation there would mix the two.
BORDER_PX = 1.5


@dataclass
class LensCentres:
    """Where the lenses of a rig are, in the unit of a map.

    centres_m (L, 3): in the rig's axes, metres. axes (L, 3): where they look. units_per_metre: how many units of the
    map a metre has, 0 while that is not known: as if there were one centre. It may change, for every camera and
    renderer that shares these centres.
    """

    centres_m: Array
    axes: Array
    units_per_metre: float = 0.0

    @classmethod
    def of(cls, rig: Rig) -> LensCentres:
        T = np.stack([lens.T_rig_lens for lens in rig.lenses])
        return cls(T[:, :3, 3].copy(), T[:, :3, 2].copy())

    @property
    def centres(self) -> Array:
        """(L, 3), in the map's unit."""
        return self.units_per_metre * self.centres_m

    def nearest(self, directions: Array) -> NDArray[np.intp]:
        """The lens (...,) to which directions or points (..., 3) belong."""
        return np.asarray(np.argmax(np.nan_to_num(directions) @ self.axes.T, axis=-1))


@dataclass(frozen=True, eq=False)
class RigPanorama(ErpCamera):
    """An equirectangular panorama whose rays begin in the centre of the lens that they belong to.

    ``project`` and ``unproject`` are those of directions. Only what is fixed to the rig knows the centres: see
    ``origins`` and ``photometric.warp.camera_code``.
    """

    lenses: LensCentres | None = None
    rig: Rig | None = None

    @classmethod
    def of(cls, rig: Rig, camera: ErpCamera, lenses: LensCentres | None = None) -> RigPanorama:
        """Of the panorama ``camera``, whose axes are the rig's, and with the pixels that it hides hidden."""
        lenses = lenses or LensCentres.of(rig)
        made = cls(camera.width, camera.height, camera.hfov_deg, camera.lat_min_deg, camera.lat_max_deg, lenses, rig)
        seen = np.zeros((camera.height, camera.width), bool)
        for number, lens in enumerate(rig.lenses):
            own = Reprojector(lens.camera, camera, lens.T_rig_lens[:3, :3]).valid
            seen |= own & (made.lens == number)
        return made.with_mask(camera.valid_mask() & seen & ~made._border())

    def _numbers(self) -> dict[str, Any]:
        return {name: value for name, value in super()._numbers().items() if name not in ("lenses", "rig")}

    @property
    def _centres(self) -> LensCentres:
        assert self.lenses is not None
        return self.lenses

    @cached_property
    def lens(self) -> NDArray[np.intp]:
        """(H, W): the number of the lens that each pixel belongs to."""
        return self._centres.nearest(self.rays())

    def origins(self) -> Array:
        """(H, W, 3): where the rays begin, in the rig's axes and the map's unit."""
        return np.asarray(self._centres.centres[self.lens])

    def _border(self) -> NDArray[np.bool_]:
        """(H, W): whether a pixel is within ``BORDER_PX`` of another lens's share."""
        towards = np.sort(self.rays() @ self._centres.axes.T, axis=-1)
        if towards.shape[-1] < 2:
            return np.zeros(towards.shape[:2], bool)
        # The bisecting plane of two axes a, b has the normal a - b, of length 2 sin(half the angle between them).
        apart = np.linalg.norm(self._centres.axes[:, None] - self._centres.axes[None], axis=-1)
        least = float(apart[apart > 0].min()) if (apart > 0).any() else 2.0
        return np.asarray(towards[..., -1] - towards[..., -2] < least * BORDER_PX * 2 * np.pi / self.width)


class LensPictures:
    """Puts the pictures of a rig's lenses in their places of a ``RigPanorama``."""

    def __init__(self, rig: Rig, camera: RigPanorama) -> None:
        self._reprojectors = [Reprojector(k.camera, camera, k.T_rig_lens[:3, :3]) for k in rig.lenses]
        self._shares = [r.valid & (camera.lens == number) for number, r in enumerate(self._reprojectors)]

    def image(self, pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """The panorama (H, W, 3) of one picture for each lens; black where no lens sees."""
        out = np.zeros((*self._shares[0].shape, 3), np.uint8)
        for picture, reprojector, share in zip(pictures, self._reprojectors, self._shares, strict=True):
            out[share] = reprojector.image(picture)[share]
        return out
