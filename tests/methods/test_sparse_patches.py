"""Where templates are found: also away from the middle of a face, where squares are not seen as parallelograms."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.geometry import make_pose, so3_exp
from panobench.methods.sparse.faces import FaceSet, build_faces
from panobench.methods.sparse.patches import align_level

Array = NDArray[np.float64]
LEVELS = 3


def sky(directions: Array) -> NDArray[np.uint8]:
    """A smooth texture (..., 3) at infinity, by direction (..., 3)."""
    waves = np.random.default_rng(3).normal(0, 14.0, (12, 3))
    grey = 128 + 9 * np.sin(directions @ waves.T + np.arange(12)).sum(axis=-1)
    return np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=-1)


def outward(faces: FaceSet, bearings: Array) -> tuple[Array, Array]:
    """The angle of each bearing (N, 3) off its face's middle, and the direction (N, 3) in which it grows."""
    axes = faces.R_fc[np.argmax(bearings @ faces.R_fc[:, 2].T, axis=1), 2]
    cosine = np.sum(axes * bearings, axis=1)
    away = cosine[:, None] * bearings - axes
    return np.arccos(cosine), away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)


@pytest.mark.parametrize(("exact", "least", "most"), [(True, 0.0, 0.01), (False, 0.02, 0.1)])
def test_where_a_template_is_found_near_the_border_of_a_face(exact: bool, least: float, most: float) -> None:
    camera = ErpCamera(384, 192)
    faces = build_faces(camera, 1_000_000, LEVELS)
    rng = np.random.default_rng(0)
    bearings = rng.normal(size=(4000, 3))
    bearings /= np.linalg.norm(bearings, axis=1, keepdims=True)
    R = so3_exp([0.1, 0.6, 0.05])
    seen = faces.pyramid(sky(camera.rays() @ R), LEVELS)  # x2 = R x1
    templates = faces.templates(faces.pyramid(sky(camera.rays()), LEVELS), bearings)
    truth = bearings @ R.T
    found, ok = truth.copy(), np.ones(len(truth), bool)
    score = align_level(
        None,
        seen[0],
        faces.valid,
        0,
        faces.R_fc,
        faces.intrinsics,
        faces.focal,
        np.ascontiguousarray(templates[:, 0]),
        bearings,
        np.zeros(len(bearings)),
        make_pose(R, np.zeros(3))[None],
        np.zeros(len(bearings), np.int64),
        found,
        ok,
        2.0,
        exact,
    )
    angle, away = outward(faces, truth)
    border = ok & (score > 0.9) & (angle > np.deg2rad(35))
    assert border.sum() > 300
    off = faces.focal * np.sum((found - truth) * away, axis=1)[border]
    assert least <= abs(float(np.median(off))) < most
