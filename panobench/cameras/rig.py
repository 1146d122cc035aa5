"""A rig: several lenses with a centre each, fixed to each other, whose pictures are taken together.

Its axes are those of a camera: x right, y down, z forward. Where it is is a pose of these axes, whose origin need not
be the centre of any lens.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.errors import CalibrationError
from panobench.geometry import renormalise
from panobench.reading import number_array

Array = NDArray[np.float64]

#: Centres of lenses that are further apart were given in another unit, m.
BASELINE_MOST_M = 5.0


@dataclass(frozen=True)
class RigLens:
    """camera: what takes the picture. T_rig_lens: pose (4, 4) of its axes in the rig's, metres.

    readout_s: seconds from the first row to the last; None where it is not known, 0 for a global shutter.
    """

    camera: Camera
    T_rig_lens: Array
    readout_s: float | None = None

    def row_times(self) -> Array | None:
        """When each row (H,) is read, seconds after the frame's time, which is that of the middle row."""
        if self.readout_s is None:
            return None
        rows = self.camera.height
        return np.asarray(((np.arange(rows) + 0.5) / rows - 0.5) * self.readout_s)


@dataclass(frozen=True)
class Rig:
    """The lenses, at least one. Raises CalibrationError for poses that are not rigid, or not in metres."""

    lenses: tuple[RigLens, ...]

    def __post_init__(self) -> None:
        if not self.lenses:
            raise CalibrationError("a rig needs a lens")
        for k, lens in enumerate(self.lenses):
            T = np.asarray(lens.T_rig_lens, dtype=np.float64)
            rigid = T.shape == (4, 4) and np.isfinite(T).all() and np.allclose(T[3], [0, 0, 0, 1])
            if not rigid or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-3) or _mirrored(T):
                raise CalibrationError(f"lens {k}: T_rig_lens is not a rigid 4x4 matrix")
        if self.baseline_m > BASELINE_MOST_M:
            raise CalibrationError(f"lens centres are {self.baseline_m:.3g} m apart: their poses have to be in metres")

    def __len__(self) -> int:
        return len(self.lenses)

    @property
    def baseline_m(self) -> float:
        """The largest distance between two centres, metres; 0 for one lens."""
        centres = [lens.T_rig_lens[:3, 3] for lens in self.lenses]
        return max((float(np.linalg.norm(a - b)) for a, b in combinations(centres, 2)), default=0.0)

    @property
    def readout_s(self) -> float | None:
        """The longest readout of a lens, seconds; None unless all of them are known."""
        known = [lens.readout_s for lens in self.lenses if lens.readout_s is not None]
        return max(known) if len(known) == len(self.lenses) else None

    def scaled(self, factor: float) -> Rig:
        """With pictures of ``factor`` times the width."""
        lenses = (replace(k, camera=k.camera.scaled(max(1, round(k.camera.width * factor)))) for k in self.lenses)
        return Rig(tuple(lenses))

    def with_masks(self, masks: list[NDArray[np.bool_]]) -> Rig:
        """With only the pixels (H, W) of each lens that are True in its mask, as far as they were valid before."""
        lenses = (
            replace(lens, camera=lens.camera.with_mask(lens.camera.valid_mask() & mask))
            for lens, mask in zip(self.lenses, masks, strict=True)
        )
        return Rig(tuple(lenses))

    def to_dict(self) -> dict[str, Any]:
        """Plain values, without masks: {"model": "rig", "lenses": [{"camera": ..., "T_rig_lens": ...}, ...]}."""
        return {"model": "rig", "lenses": [_lens_values(lens) for lens in self.lenses]}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Rig:
        """Inverse of ``to_dict``. Raises CalibrationError for missing, unknown or impossible values."""
        lenses = values.get("lenses")
        if values.get("model", "rig") != "rig" or not isinstance(lenses, list):
            raise CalibrationError("a rig is {model: rig, lenses: [{camera, T_rig_lens, readout_s}, ...]}")
        unknown = sorted(set(map(str, values)) - {"model", "lenses"})
        if unknown:
            raise CalibrationError(f"rig: unknown value '{unknown[0]}'; known: model, lenses")
        return cls(tuple(_lens(lens, k) for k, lens in enumerate(lenses)))


def seen_in_panorama(rig: Rig, camera: Camera, mask: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
    """For each lens (H, W) whether what its pixels look at is True in ``mask`` (h, w), which is of ``camera``.

    ``camera`` has the rig's axes; parallax is neglected. What it does not see counts as True.
    """
    found = []
    for lens in rig.lenses:
        rays = np.nan_to_num(lens.camera.rays()) @ lens.T_rig_lens[:3, :3].T
        pixels, ok = camera.project(rays)
        column, row = (np.where(ok, pixels[..., k], 0).astype(np.intp) for k in (0, 1))
        found.append(np.asarray(~ok | mask[row, column]))
    return found


def _mirrored(T: Array) -> bool:
    return float(np.linalg.det(T[:3, :3])) < 0


def _lens_values(lens: RigLens) -> dict[str, Any]:
    readout = {} if lens.readout_s is None else {"readout_s": lens.readout_s}
    return {"camera": lens.camera.to_dict(), "T_rig_lens": lens.T_rig_lens.tolist(), **readout}


def _lens(values: Any, k: int) -> RigLens:
    from panobench.cameras.factory import camera_from_dict

    if not isinstance(values, dict) or not isinstance(values.get("camera"), dict):
        raise CalibrationError(f"lens {k}: 'camera' is missing")
    unknown = sorted(set(map(str, values)) - {"camera", "T_rig_lens", "readout_s"})
    if unknown:
        raise CalibrationError(f"lens {k}: unknown value '{unknown[0]}'; known: camera, T_rig_lens, readout_s")
    try:
        T = number_array(values["T_rig_lens"])
    except (KeyError, TypeError, ValueError):
        raise CalibrationError(f"lens {k}: 'T_rig_lens' must be a 4x4 matrix") from None
    readout = values.get("readout_s")
    if readout is not None and not (isinstance(readout, (int, float)) and 0 <= readout < 1):
        raise CalibrationError(f"lens {k}: 'readout_s' must be seconds below 1, not {readout!r}")
    if T.shape != (4, 4):
        raise CalibrationError(f"lens {k}: 'T_rig_lens' must be a 4x4 matrix")
    lens = RigLens(camera_from_dict(values["camera"]), T, None if readout is None else float(readout))
    Rig((lens,))  # refuses what is not rigid before it is made so
    return replace(lens, T_rig_lens=renormalise(T))
