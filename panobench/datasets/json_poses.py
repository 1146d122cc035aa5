"""JSON files with 4x4 poses, read strictly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.trajectory_io import MAX_TEXT_BYTES
from panobench.errors import DatasetError
from panobench.geometry import make_pose, renormalise


def read_json(path: Path) -> Any:
    """The file's content. Raises DatasetError naming the file and line."""
    try:
        if path.stat().st_size > MAX_TEXT_BYTES:
            raise DatasetError(f"the file is over {MAX_TEXT_BYTES >> 20} MiB", path)
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DatasetError("the file is missing", path) from None
    except json.JSONDecodeError as error:
        raise DatasetError(f"the file is not JSON ({error.msg})", path, line=error.lineno) from None
    except (OSError, UnicodeDecodeError, RecursionError) as error:
        raise DatasetError(f"the file cannot be read ({error})", path) from None


def rigid(R: Any, t: Any, path: Path, what: str) -> NDArray[np.float64]:
    """Rotation (3, 3) and translation (3,) from a file -> pose (4, 4). Raises DatasetError naming file and ``what``."""
    try:
        rotation, translation = np.array(R, dtype=np.float64), np.array(t, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise DatasetError(f"the pose of {what} is not made of numbers", path) from None
    good = rotation.shape == (3, 3) and translation.shape == (3,)
    good = good and bool(np.isfinite(rotation).all() and np.isfinite(translation).all())
    if not good or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-2 or np.linalg.det(rotation) < 0:
        raise DatasetError(f"the pose of {what} is not a rigid motion", path)
    return renormalise(make_pose(rotation, translation))


def rigid_matrix(matrix: Any, path: Path, what: str) -> NDArray[np.float64]:
    """A 3x4 or 4x4 matrix from a file -> pose (4, 4)."""
    try:
        M = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError):
        M = np.zeros(0)
    if M.shape not in ((3, 4), (4, 4)):
        raise DatasetError(f"the pose of {what} is no 4x4 matrix of numbers", path)
    return rigid(M[:3, :3], M[:3, 3], path, what)
