"""Tracking leaves out what is hidden from where the camera was, until something opens."""

from __future__ import annotations

import numpy as np
import pytest
from gaussian_shells import shell

from panobench.cameras.erp import ErpCamera
from panobench.geometry import make_pose
from panobench.methods.splatting.culling import STEPS
from panobench.methods.splatting.occlusion import OccludedMap
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer

CAMERA = ErpCamera(128, 64)
RENDERER = Renderer(CAMERA)
HERE = np.eye(4)


@pytest.fixture
def trainable() -> TrainableMap:
    """A sphere within a brighter one."""
    t = TrainableMap()
    t.append(shell(2.0, 0.3), 0)
    t.append(shell(4.0, 0.9), 0)
    return t


def occluded(t: TrainableMap, least: float = 0.01) -> OccludedMap:
    return OccludedMap(t, pixel_weights(CAMERA), least, 0.9)


def test_what_is_hidden_is_left_out_and_the_picture_stays(trainable: TrainableMap) -> None:
    m = occluded(trainable)
    assert m.follow(RENDERER, HERE).drawn == len(trainable)
    nearby = make_pose(np.eye(3), [0.05, 0.0, 0.02])
    part, whole = m.follow(RENDERER, nearby), RENDERER.forward(trainable.gaussians, nearby, sloped=True)
    assert part.drawn < 0.6 * whole.drawn
    np.testing.assert_allclose(part.colour, whole.colour, atol=5e-3)
    assert m.look(RENDERER, nearby).drawn == part.drawn


def test_where_something_opens_the_whole_map_is_drawn(trainable: TrainableMap) -> None:
    m = occluded(trainable)
    m.follow(RENDERER, HERE)
    doorway = (np.abs(trainable.gaussians.means[:, :2]) < 0.6).all(axis=1) & (trainable.gaussians.means[:, 2] > 0)
    trainable.drop(doorway & (np.linalg.norm(trainable.gaussians.means, axis=1) < 3))
    assert m.look(RENDERER, HERE).drawn == len(trainable)
    through = m.follow(RENDERER, HERE)
    assert through.drawn == len(trainable)
    assert through.colour[32, 64].mean() > 0.8  # the outer sphere
    again = m.follow(RENDERER, HERE)
    assert again.drawn < len(trainable)
    np.testing.assert_allclose(again.colour, through.colour, atol=5e-3)


def test_new_gaussians_are_drawn_and_the_whole_map_now_and_then(trainable: TrainableMap) -> None:
    m = occluded(trainable)
    m.follow(RENDERER, HERE)
    before = m.follow(RENDERER, HERE).drawn
    trainable.append(shell(1.0, 0.5, 100), 0)
    assert m.follow(RENDERER, HERE).drawn == before + 100
    counts = [m.follow(RENDERER, HERE).drawn for _ in range(STEPS)]
    assert counts.count(len(trainable)) == 1


def test_without_a_least_weight_the_whole_map_is_always_drawn(trainable: TrainableMap) -> None:
    m = occluded(trainable, 0.0)
    for _ in range(3):
        render = m.follow(RENDERER, HERE)
        assert render.drawn == len(trainable)
        assert render.weights is None
        assert render.touched is not None
