"""A map of 3D Gaussians: float32 arrays with a row for each Gaussian."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import Sim3, matrix_from_quaternion, quaternion_from_matrix

F32 = NDArray[np.float32]


@dataclass
class GaussianMap:
    """N Gaussians in the world frame.

    means (N, 3): positions, in metres where the scale is known. log_scales (N, 3): logarithms of the standard
    deviations along the Gaussian's own axes. quats (N, 4) as (w, x, y, z), of any length: the rotation of those axes
    into the world. opacity_logits (N,): opacity = sigmoid(.). colours (N, 3): RGB, 0..1 but not clipped.
    """

    means: F32
    log_scales: F32
    quats: F32
    opacity_logits: F32
    colours: F32

    def __post_init__(self) -> None:
        n = len(self.means)
        shapes = {"means": (n, 3), "log_scales": (n, 3), "quats": (n, 4), "opacity_logits": (n,), "colours": (n, 3)}
        for name, shape in shapes.items():
            value = np.ascontiguousarray(getattr(self, name), dtype=np.float32)
            if value.shape != shape:
                raise ValueError(f"{name} has shape {value.shape}, expected {shape}")
            setattr(self, name, value)

    @classmethod
    def empty(cls) -> GaussianMap:
        z = np.zeros
        return cls(*(z(s, np.float32) for s in ((0, 3), (0, 3), (0, 4), (0,), (0, 3))))

    def __len__(self) -> int:
        return len(self.means)

    def arrays(self) -> Iterator[F32]:
        """The parameter arrays in declaration order."""
        for f in fields(self):
            yield getattr(self, f.name)

    def select(self, index: NDArray[np.bool_] | NDArray[np.intp] | slice) -> GaussianMap:
        """A copy of the Gaussians that ``index`` picks."""
        return GaussianMap(*(np.ascontiguousarray(a[index]) for a in self.arrays()))

    def kept(self, which: NDArray[np.bool_]) -> GaussianMap:
        """A map of the same kind with the Gaussians that ``which`` (N,) marks."""
        return GaussianMap(*(np.compress(which, a, axis=0) for a in self.arrays()))  # 4 x as fast as indexing

    def concat(self, other: GaussianMap) -> GaussianMap:
        """A new map with the Gaussians of both, these first."""
        return GaussianMap(*(np.concatenate([a, b]) for a, b in zip(self.arrays(), other.arrays())))

    def copy(self) -> GaussianMap:
        return GaussianMap(*(a.copy() for a in self.arrays()))

    def on_host(self) -> GaussianMap:
        """The map with its arrays on the host: itself, unless it stays on a device (``cuda.gaussians``)."""
        return self

    def update(self, **arrays: NDArray[Any]) -> None:
        """Write whole arrays, by name, in place."""
        for name, array in arrays.items():
            getattr(self, name)[:] = array

    def assign(self, which: NDArray[np.bool_], new: GaussianMap) -> None:
        """Write the parameters of ``new`` (M Gaussians), in place, to the M Gaussians that ``which`` (N,) marks."""
        for mine, theirs in zip(self.arrays(), new.arrays()):
            mine[which] = theirs

    def transformed(self, transform: Sim3) -> GaussianMap:
        """A new map, moved by a similarity."""
        R = transform.R @ matrix_from_quaternion(self.quats)
        return GaussianMap(
            transform.apply_points(self.means).astype(np.float32),
            self.log_scales + np.float32(np.log(transform.scale)),
            quaternion_from_matrix(R).astype(np.float32),
            self.opacity_logits,
            self.colours,
        )

    def write_ply(self, path: Path) -> None:
        """Write the standard PLY of 3DGS, which any splat viewer reads."""
        from panobench.splat.ply import write_ply

        write_ply(path, self.means, self.log_scales, self.quats, self.opacity_logits, self.colours)
