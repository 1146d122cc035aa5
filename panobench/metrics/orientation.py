"""What a large rotation error beside a small position error comes from: quaternions or axes of another convention."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import matrix_from_quaternion, quaternion_from_matrix, so3_log

Array = NDArray[np.float64]
#: A rotation error of more than this is looked into.
LARGE_DEG = 20.0
#: An explanation leaves less than this share of the error.
_LEFT = 0.25
#: (w, x, y, z) as they would have been read in the right order, from those read in the wrong one.
_ORDERS = {
    "the file has qw first and was read with qw last": [1, 2, 3, 0],
    "the file has qw last and was read with qw first": [3, 0, 1, 2],
}


def explain_rotation(R_true: Array, R_found: Array, R_align: Array) -> str | None:
    """A line on why ``R_align R_found`` (N, 3, 3) is far from ``R_true``; None if it is not, or nothing explains it."""
    before = _rms_deg(R_true, R_align @ R_found)
    if before < LARGE_DEG:
        return None
    q = quaternion_from_matrix(R_found)
    for why, order in _ORDERS.items():
        after = _rms_deg(R_true, R_align @ matrix_from_quaternion(q[:, order]))
        if after < _LEFT * before:
            return f"a rotation error of {before:.0f} degrees looks like a quaternion in another order: {why}"
    # R_true = R_align R_found C for one C: the axes of the camera, or of the body, are other ones.
    U, _, Vt = np.linalg.svd((np.swapaxes(R_align @ R_found, 1, 2) @ R_true).sum(axis=0))
    C = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    after = _rms_deg(R_true, R_align @ R_found @ C)
    if after < _LEFT * before:
        turn = so3_log(C)
        angle = float(np.linalg.norm(turn))
        axis = ", ".join(f"{v:.2g}" for v in np.round(turn / angle, 2) + 0.0)
        return (
            f"a rotation error of {before:.0f} degrees is {np.degrees(angle):.0f} degrees about the camera's axis "
            f"({axis}) in every frame: the poses are of other axes (a body's, OpenGL's, Blender's)"
        )
    return None


def _rms_deg(A: Array, B: Array) -> float:
    """Root mean square of the angles between rotations (N, 3, 3), degrees."""
    angles = np.linalg.norm(so3_log(np.swapaxes(A, 1, 2) @ B), axis=-1)
    return float(np.degrees(np.sqrt((angles**2).mean())))
