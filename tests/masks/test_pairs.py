"""The camera's motion between two frames, with a part of the view that does not follow it."""

from __future__ import annotations

import numpy as np
import pytest
from mask_walks import walk

from panobench.geometry import fibonacci_sphere, so3_exp, so3_log
from panobench.masks.pairs import behind_carrier, find_pair, refined, robust_rotation
from panobench.methods.sparse.faces import build_faces

RNG = np.random.default_rng(3)
POINTS = fibonacci_sphere(300) * RNG.uniform(1.0, 6.0, (300, 1))


def matches(R: np.ndarray, t: np.ndarray, still: float) -> tuple[np.ndarray, np.ndarray]:
    """Bearings in two views; the share ``still`` of them stays in the picture."""
    a = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    b = POINTS @ R.T + t
    b /= np.linalg.norm(b, axis=1, keepdims=True)
    b += 1e-3 * RNG.standard_normal(b.shape)
    b[: int(still * len(b))] = a[: int(still * len(b))]
    return a, b / np.linalg.norm(b, axis=1, keepdims=True)


def degrees(A: np.ndarray, B: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(so3_log(A.T @ B))))


def test_a_rotation_is_found_though_a_third_stays_still() -> None:
    R = so3_exp([0.02, 0.1, -0.03])
    a, b = matches(R, np.zeros(3), 0.33)
    found, near = robust_rotation(a, b, 0.01, np.random.default_rng(0))
    assert degrees(found, R) < 0.1
    assert near[99:].mean() > 0.95
    assert near[:99].mean() < 0.3


def test_refinement_corrects_a_motion_that_is_a_degree_off() -> None:
    R, t = so3_exp([0.02, 0.1, -0.03]), np.array([0.3, 0.05, 0.4])
    a, b = matches(R, t, 0.2)
    t /= np.linalg.norm(t)
    start = so3_exp([0.01, -0.01, 0.01]) @ R
    found, direction, off = refined(start, t, a, b, 0.01)
    assert degrees(found, R) < 0.2 < 0.8 < degrees(start, R)
    assert direction @ t > 0.999
    assert np.median(off[60:]) < 0.003


@pytest.mark.parametrize("name", ["tiny", "tiny+operator-15"])
def test_the_motion_of_a_walk_is_that_of_the_room(name: str) -> None:
    sequence = walk(name)
    face_set = build_faces(sequence.camera, 120_000, 1)
    pair = find_pair(
        face_set, lambda i: face_set.pyramid(sequence.image(i), 1)[0], 5, len(sequence), np.random.default_rng(0)
    )
    assert pair is not None
    truth = sequence.groundtruth
    assert truth is not None
    T = np.linalg.inv(truth.T_wc[pair.second]) @ truth.T_wc[pair.first]
    assert degrees(pair.R, T[:3, :3]) < 0.7  # a pixel is 1.9 degrees
    baseline = np.linalg.norm(T[:3, 3])
    assert pair.t @ T[:3, 3] / baseline > 0.98
    depth = np.asarray(sequence.depth(pair.first))
    uv, _ = sequence.camera.project(pair.bearings)
    at = depth[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    assert np.median(pair.inverse * at / baseline) == pytest.approx(1.0, abs=0.1)
    back = pair.reversed()
    assert np.allclose(back.R @ pair.R, np.eye(3), atol=1e-9)
    assert np.allclose(back.reversed().bearings, pair.bearings, atol=1e-6)


def test_nothing_is_found_without_motion() -> None:
    sequence = walk("tiny")
    face_set = build_faces(sequence.camera, 120_000, 1)
    faces = face_set.pyramid(sequence.image(0), 1)[0]
    assert find_pair(face_set, lambda i: faces, 0, 30, np.random.default_rng(0)) is None


@pytest.mark.parametrize("turn", [0.0, 0.03])
def test_a_scene_behind_a_carrier_that_fills_most_of_the_view(turn: float) -> None:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(600, 3))
    a = points / np.linalg.norm(points, axis=1, keepdims=True)
    carrier = a @ so3_exp(np.array([0.0, turn, 0.0])).T
    scene = points @ so3_exp(np.array([0.0, 0.1, 0.0])).T + [0.3, 0.0, 0.1]
    scene /= np.linalg.norm(scene, axis=1, keepdims=True)

    def behind(seen: np.ndarray) -> np.ndarray:
        return behind_carrier(a, np.where(seen[:, None], scene, carrier), 0.01, np.random.default_rng(1))

    up = a[:, 1] < -0.3  # a third of the sphere
    found = behind(up)
    assert found[up].mean() > 0.9
    assert not found[~up].any()
    assert not behind(a[:, 0] > 0.8).any()  # a person
    assert not behind(np.zeros(len(a), dtype=bool)).any()
