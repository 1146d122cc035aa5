"""Pictures of a rig stitched to a panorama: what a camera with one centre would have seen, but for parallax."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.cameras.reproject import Reprojector
from panobench.cameras.rig import Rig


class Stitcher:
    """Weights are linear in the angle from each lens's axis, over ``blend_deg`` around a right angle.

    distance_m: things so far from the rig's origin are stitched without a seam; None: things at infinity, as if all
    lenses had one centre.
    """

    def __init__(self, rig: Rig, camera: ErpCamera, blend_deg: float = 6.0, distance_m: float | None = None) -> None:
        self.rig = rig
        self._reprojectors = [
            Reprojector(
                lens.camera,
                camera,
                lens.T_rig_lens[:3, :3],
                displaced=None if distance_m is None else lens.T_rig_lens[:3, 3] / distance_m,
            )
            for lens in rig.lenses
        ]
        half = blend_deg / 2
        weights = []
        for lens, reprojector in zip(rig.lenses, self._reprojectors):
            angle = np.degrees(np.arccos(np.clip(camera.rays() @ lens.T_rig_lens[:3, 2], -1, 1)))
            ramp = np.clip((90 + half - angle) / (2 * half), 0, 1)
            # Where only one lens sees, only that lens counts, however far from its axis.
            weights.append(np.where(reprojector.valid, np.maximum(ramp, 1e-6), 0.0))
        total = np.sum(weights, axis=0)
        self.valid: NDArray[np.bool_] = total > 0
        self._weights = [(w / np.where(self.valid, total, 1.0)).astype(np.float32)[..., None] for w in weights]

    def image(self, pictures: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
        """The panorama of one picture (H, W, 3) for each lens; black where no lens sees."""
        out = np.zeros((*self.valid.shape, 3), np.float32)
        for picture, reprojector, weight in zip(pictures, self._reprojectors, self._weights, strict=True):
            out += weight * reprojector.image(picture)
        return np.asarray(np.rint(out), dtype=np.uint8)
