"""JSON files with 4x4 poses, read strictly."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.trajectory_io import MAX_TEXT_BYTES
from panobench.errors import DatasetError
from panobench.geometry import make_pose, renormalise
from panobench.reading import number_array, parse_json, read_text


def read_json(path: Path) -> Any:
    """The file's content. Raises DatasetError naming the file and line."""
    return parse_json(read_text(path, "the file", MAX_TEXT_BYTES, DatasetError), path, DatasetError)


def rigid(R: Any, t: Any, path: Path, what: str) -> NDArray[np.float64]:
    """Rotation (3, 3) and translation (3,) from a file -> pose (4, 4). Raises DatasetError naming file and ``what``."""
    rotation, translation = number_array(R), number_array(t).reshape(-1)
    good = rotation.shape == (3, 3) and translation.shape == (3,)
    if not good or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-2 or np.linalg.det(rotation) < 0:
        raise DatasetError(f"the pose of {what} is not a rigid motion", path)
    return renormalise(make_pose(rotation, translation))


def rigid_matrix(matrix: Any, path: Path, what: str) -> NDArray[np.float64]:
    """A 3x4 or 4x4 matrix from a file -> pose (4, 4)."""
    M = number_array(matrix)
    if M.shape not in ((3, 4), (4, 4)):
        raise DatasetError(f"the pose of {what} is no 4x4 matrix of numbers", path)
    return rigid(M[:3, :3], M[:3, 3], path, what)
