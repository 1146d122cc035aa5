"""The last adjustment where metres matter: measurements that follow a stride too little do not make it smaller."""

from __future__ import annotations

import numpy as np

from panobench.geometry import invert_pose, make_pose
from panobench.methods.sparse.config import SparseConfig
from panobench.methods.sparse.mapping import adjust_window
from panobench.methods.sparse.pointmap import ACTIVE, Keyframe, PointMap
from panobench.methods.sparse.refine import adjust_exactly

FOCAL = 186.0


def strides(m: PointMap) -> float:
    """Up and down from keyframe to keyframe, over the way forward."""
    p = invert_pose(m.poses())[:, :3, 3]
    return float(np.mean(np.abs(np.diff(p[:, 1]))) / np.linalg.norm(p[-1] - p[0]))


def world() -> PointMap:
    """Twelve keyframes that go forward and alternate by 6 cm; of each seventh measurement the stride is missing."""
    rng = np.random.default_rng(0)
    X = rng.normal(size=(400, 3))
    X *= rng.uniform(1.5, 4.0, (400, 1)) / np.linalg.norm(X, axis=1, keepdims=True)
    m = PointMap(1)
    ids = m.add(len(X), position=X, state=ACTIVE)
    for k in range(12):
        lost = rng.uniform(size=len(X)) < 1 / 7
        seen = X - np.where(lost[:, None], [0.1 * k, 0.0, 0.0], [0.1 * k, 0.03 * (-1) ** k, 0.0])
        b = seen / np.linalg.norm(seen, axis=1, keepdims=True) + rng.normal(scale=0.3 / FOCAL, size=X.shape)
        T_wc = make_pose(np.eye(3), [0.1 * k, 0.03 * (-1) ** k, 0.0])
        m.keyframes.append(Keyframe(k, k, invert_pose(T_wc), ids, b / np.linalg.norm(b, axis=1, keepdims=True)))
    return m


def test_what_is_far_off_does_not_shorten_strides() -> None:
    m, config = world(), SparseConfig(huber_px=0.4)
    true = strides(m)
    adjust_window(m, config, FOCAL, list(range(12)), 10)
    before = strides(m) / true
    adjust_exactly(m, config, FOCAL)
    after = strides(m) / true
    assert before < 0.99
    assert 1 - after < 0.6 * (1 - before)
