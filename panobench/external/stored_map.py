"""A Gaussian map that a program stored as a PLY file, kept in memory and rendered by panobench's renderer."""

from __future__ import annotations

import tempfile
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.errors import InputError

if TYPE_CHECKING:
    from panobench.cameras.base import Camera
    from panobench.splat.gaussians import GaussianMap

MAX_HEADER_BYTES, MAX_MAP_BYTES = 65536, 2 << 30


class StoredMap:
    """The bytes of a PLY file in the 3DGS layout (an ``Estimate.map``).

    They are kept because the work folder is removed before the run is stored, and they are stored as they are: what
    panobench does not render (spherical harmonics above degree 0) stays in them.
    """

    def __init__(self, data: bytes) -> None:
        self._data = data

    def __len__(self) -> int:
        header = self._data[:MAX_HEADER_BYTES].split(b"end_header")[0].decode("ascii", errors="replace")
        counts = [line.split()[-1] for line in header.splitlines() if line.startswith("element vertex ")]
        return int(counts[0]) if len(counts) == 1 and counts[0].isdigit() else 0

    def write_ply(self, path: Path) -> None:
        path.write_bytes(self._data)

    @cached_property
    def gaussians(self) -> GaussianMap:
        """The parsed map. Raises InputError if it is no 3DGS map."""
        from panobench.splat.gaussians import GaussianMap
        from panobench.splat.ply import read_ply

        with tempfile.NamedTemporaryFile(suffix=".ply") as file:
            file.write(self._data)
            file.flush()
            return GaussianMap(*read_ply(file.name))

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.float32]:
        """RGB (H, W, 3) in 0..1 seen from a pose of the program's world. Raises InputError as ``gaussians``."""
        from panobench.splat.render import Renderer

        renderer = Renderer(camera, "pinhole" if camera.kind == "pinhole" else "sphere")
        return np.ascontiguousarray(np.clip(renderer.forward(self.gaussians, T_wc).colour, 0.0, 1.0))


def read_stored_map(path: Path) -> StoredMap:
    """Read a map of at most 2 GiB. Raises InputError for a larger file."""
    if path.stat().st_size > MAX_MAP_BYTES:
        raise InputError(f"the map is over {MAX_MAP_BYTES >> 20} MiB", path)
    return StoredMap(path.read_bytes())
