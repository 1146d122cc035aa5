"""The faces of a rig: each lens has its own, cut from its own picture, and no pixel is stitched.

A lens has one face ahead and four around it, tilted so far that they reach its rim. The faces of two lenses back to
back look symmetrically away from the plane between them, so the nearest face of a bearing is one of the nearer lens.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.rig import Rig
from panobench.methods.sparse.faces import FINER, MARGIN, FaceSet, resampled, round_up
from panobench.methods.sparse.lenses import Lenses
from panobench.methods.sparse.patches import STORED, cut_templates

Array = NDArray[np.float64]

#: How far the faces around are tilted off a lens's axis, radians, and half of a face's side at distance 1.
TILT, HALF = np.deg2rad(57.0), 1.25


class RigFaces(FaceSet):
    """The faces of all lenses, in the rig's axes. ``parts``: those of each lens."""

    parts: list[FaceSet]

    def pyramids(self, pictures: tuple[NDArray[np.uint8], ...], levels: int) -> list[NDArray[np.uint8]]:
        """One RGB picture (H, W, 3) for each lens -> per level the grey faces (F, H / 2^l, W / 2^l)."""
        each = [part.pyramid(picture, levels) for part, picture in zip(self.parts, pictures, strict=True)]
        return [np.concatenate(level) for level in zip(*each)]

    def templates(self, pyramid: list[NDArray[np.uint8]], bearings: Array) -> NDArray[np.float32]:
        """As of one camera, each from the faces of the bearing's own lens: other lenses see it with parallax."""
        out = np.zeros((len(bearings), len(pyramid), STORED, STORED), np.float32)
        owner = self.lenses.of(bearings)
        for k in range(len(self.lenses.centres)):
            own, faces = owner == k, self.lenses.lens == k
            part = [np.ascontiguousarray(level[faces]) for level in pyramid]
            out[own] = cut_templates(part, self.R_fc[faces], self.intrinsics, bearings[own], self.focal)
        return out


def build_rig_faces(rig: Rig, max_pixels: int, levels: int) -> RigFaces:
    """Fine faces (see ``faces``), ``max_pixels`` of all together at most."""
    multiple = 1 << (levels - 1)
    sides = _sides()
    angle = float(np.mean([_pixel_angle(lens.camera) for lens in rig.lenses]))
    widest = (np.sqrt(max_pixels / (len(sides) * len(rig))) / 2 - MARGIN) / HALF
    focal = float(min(FINER / angle, widest))
    half = round_up(2 * (HALF * focal + MARGIN), 2 * multiple) // 2
    intrinsics = np.array([focal, focal, float(half), float(half)])
    parts = [
        resampled(lens.camera, sides, intrinsics, (2 * half, 2 * half), focal, angle, wide=True) for lens in rig.lenses
    ]
    R_fc = np.concatenate([sides @ lens.T_rig_lens[:3, :3].T for lens in rig.lenses])
    lenses = Lenses(
        np.stack([lens.T_rig_lens[:3, 3] for lens in rig.lenses]),
        R_fc[:, 2].copy(),
        np.repeat(np.arange(len(rig)), len(sides)),
    )
    core = np.concatenate([part.core for part in parts]) & _own(R_fc, intrinsics, (2 * half, 2 * half))
    valid = np.concatenate([part.valid for part in parts])
    found = RigFaces(
        R_fc, intrinsics, (2 * half, 2 * half), valid, core, focal, None, None, False, focal * angle, lenses
    )
    found.parts = parts
    return found


def _sides() -> Array:
    """(5, 3, 3): from a lens's axes to those of its faces."""
    found = [np.eye(3)]
    for turn in np.deg2rad([0.0, 90.0, 180.0, 270.0]):
        z = np.array([np.sin(TILT) * np.cos(turn), np.sin(TILT) * np.sin(turn), np.cos(TILT)])
        x = np.array([-np.sin(turn), np.cos(turn), 0.0])
        found.append(np.stack([x, np.cross(z, x), z]))
    return np.stack(found)


def _pixel_angle(camera: Camera) -> float:
    """Mean side of a pixel over the solid angle, radians."""
    omega = camera.solid_angle()[camera.valid_mask()]
    return float((omega**1.5).sum() / omega.sum())


def _own(R_fc: Array, intrinsics: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
    """(F, H, W): the pixel's ray is nearest to its own face."""
    h, w = size
    fx, fy, cx, cy = intrinsics
    u, v = np.meshgrid(np.arange(w) + 0.5, np.arange(h) + 0.5)
    d = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones((h, w))], axis=-1)
    own = [np.argmax((d @ R) @ R_fc[:, 2].T, axis=-1) == k for k, R in enumerate(R_fc)]
    return np.stack(own)
