"""Poses in JSON: transforms.json of nerfstudio, instant-ngp and Blender, and MonoGS's trj_final.json.

nerfstudio: ``frames`` with ``file_path`` and ``transform_matrix``, camera-to-world with the camera's x right, y up and
z backward (https://docs.nerf.studio/quickstart/data_conventions.html); ``applied_scale`` is divided out. MonoGS:
``trj_id``, frame numbers, and ``trj_est``, camera-to-world in x right, y down, z forward.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from panobench.datasets.files.json_poses import read_json, rigid_matrix
from panobench.errors import DatasetError
from panobench.trajectories.posed import Array, PoseList

#: OpenGL camera axes (x right, y up, z backward) to the package's (x right, y down, z forward).
_CV_FROM_GL = np.diag([1.0, -1.0, -1.0, 1.0])


def read_poses(path: Path) -> PoseList:
    """Either kind. Raises DatasetError for JSON that is neither, or a pose that is no rigid motion."""
    values = read_json(path)
    if isinstance(values, dict) and isinstance(values.get("frames"), list):
        names, T_wc = transforms(values, path)
        return PoseList(T_wc, "transforms", names=names, scaled=False)
    if isinstance(values, dict) and isinstance(values.get("trj_est"), list):
        return _monogs(values, path)
    raise DatasetError("no poses: 'frames' (nerfstudio's transforms.json) or 'trj_est' (MonoGS) is expected", path)


def transforms(values: dict[str, Any], path: Path) -> tuple[tuple[str, ...], Array]:
    """Names and T_wc (N, 4, 4) of a transforms.json's frames."""
    scale = values.get("applied_scale", 1.0)
    if isinstance(scale, bool) or not isinstance(scale, (int, float)) or not 1e-12 < scale < 1e12:
        raise DatasetError(f"'applied_scale' must be a positive number, not {scale!r}", path)
    names, poses = [], []
    for k, frame in enumerate(values["frames"]):
        name = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(name, str) or not name:
            raise DatasetError("a frame has no 'file_path'", path, frame=k)
        T = rigid_matrix(frame.get("transform_matrix"), path, f"'{name[:200]}'") @ _CV_FROM_GL
        T[:3, 3] /= scale
        names.append(name)
        poses.append(T)
    if not poses:
        raise DatasetError("the file has no frame", path)
    if not np.isfinite(poses).all():
        raise DatasetError("a pose is beyond all bounds", path)
    return tuple(names), np.stack(poses)


def _monogs(values: dict[str, Any], path: Path) -> PoseList:
    poses = [rigid_matrix(T, path, f"'trj_est' {k}") for k, T in enumerate(values["trj_est"])]
    if not poses:
        raise DatasetError("the trajectory has no pose", path)
    ids = values.get("trj_id", list(range(len(poses))))
    whole = isinstance(ids, list) and all(isinstance(i, int) and not isinstance(i, bool) for i in ids)
    if not whole or len(ids) != len(poses) or not all(0 <= i < 1 << 40 for i in ids):
        raise DatasetError("'trj_id' must be the frame number of each pose in 'trj_est'", path)
    return PoseList(np.stack(poses), "monogs", numbers=np.array(ids, dtype=np.int64))
