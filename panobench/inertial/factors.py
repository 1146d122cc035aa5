"""Factors that compare camera poses in the world with poses of a visual map in its own unit, for gtsam.

Perturbations are gtsam's: a pose (R, p) becomes (R Exp(w), p + R v) for (w, v).
"""

from __future__ import annotations

import gtsam
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import hat, so3_log

Array = NDArray[np.float64]


def visual_factor(
    reference: int,
    node: int,
    log_scale: int,
    relative: Array,
    T_body_cam: Array,
    unit: float,
    model: gtsam.noiseModel.Base,
) -> gtsam.CustomFactor:
    """A node's camera as seen from its reference's.

    reference: key of a camera pose (Pose3). node: key of a body pose. log_scale: key of a number. relative (4, 4): the
    camera's pose in the reference's axes and the map's unit, which is about ``unit`` metres. The residual is a rotation
    (rad), then a position in units of the map times ``unit``: in metres, the noise of the map's positions would grow
    with the scale, and the fit would make the scale smaller to have less of it.
    """
    R_bc, t_bc = T_body_cam[:3, :3].copy(), T_body_cam[:3, 3].copy()
    R_bc_T, arm = R_bc.T.copy(), hat(t_bc)
    R_seen_T, t_seen = relative[:3, :3].T.copy(), relative[:3, 3] * unit

    def error(factor: gtsam.CustomFactor, values: gtsam.Values, H: list[Array] | None) -> Array:
        R_A, p_A = _parts(values.atPose3(reference))
        R_X, p_X = _parts(values.atPose3(node))
        shrink = unit / np.exp(values.atDouble(log_scale))
        R_AX = R_A.T @ R_X
        C = R_AX @ R_bc
        q = shrink * (R_A.T @ (p_X + R_X @ t_bc - p_A))
        rotation = _log(R_seen_T @ C)
        if H is not None:
            inverse = _right_jacobian_inverse(rotation)
            by_reference, by_node, by_scale = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros((6, 1))
            by_reference[:3, :3] = -inverse @ C.T
            by_reference[3:, :3], by_reference[3:, 3:] = hat(q), -shrink * np.eye(3)
            by_node[:3, :3] = inverse @ R_bc_T
            by_node[3:, :3], by_node[3:, 3:] = -shrink * R_AX @ arm, shrink * R_AX
            by_scale[3:, 0] = -q
            H[0], H[1], H[2] = by_reference, by_node, by_scale
        return np.concatenate([rotation, q - t_seen])

    return gtsam.CustomFactor(model, [reference, node, log_scale], error)


def reference_drift_factor(
    one: int, other: int, log_scale: int, relative: Array, unit: float, model: gtsam.noiseModel.Base
) -> gtsam.CustomFactor:
    """Two references, as ``visual_factor`` with a camera in place of a node."""
    return visual_factor(one, other, log_scale, relative, np.eye(4), unit, model)


def _parts(pose: gtsam.Pose3) -> tuple[Array, Array]:
    M = pose.matrix()
    return M[:3, :3], M[:3, 3]


def _log(R: Array) -> Array:
    """As ``so3_log``, without its overhead for small angles."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine2 = float(w @ w)
    if sine2 > 0.25 or np.trace(R) < 1:
        return so3_log(R)
    sine = np.sqrt(sine2)
    return w if sine < 1e-7 else w * (np.arcsin(sine) / sine)


def _right_jacobian_inverse(w: Array) -> Array:
    """To second order: residuals are small."""
    K = hat(w)
    return np.eye(3) + K / 2 + K @ K / 12
