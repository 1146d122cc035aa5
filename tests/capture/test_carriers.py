"""Who carries the camera: how much is hidden, where, and how it moves."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.capture.car import Car
from panobench.capture.casting import Light, cast
from panobench.capture.operator import Operator, share_hidden

CAMERA = ErpCamera(160, 80)
DARK = Light(np.zeros((9, 3)), np.zeros((1, 1, 3), np.float32))


def hidden(carrier: Operator | Car, t: float) -> np.ndarray:
    return cast(carrier.solids(t), CAMERA.rays().astype(np.float32), np.eye(4), DARK, sub=1).share > 0


@pytest.mark.parametrize("share", [0.05, 0.15, 0.30])
def test_the_operator_hides_the_share_asked_for(share: float) -> None:
    operator = Operator(share, seed=2)
    assert share_hidden([operator.solids(t) for t in (0.0, 1.3, 2.9, 5.2)]) == pytest.approx(share, rel=0.2)


def test_the_operator_is_below_and_behind_holds_the_camera_and_sways() -> None:
    operator = Operator(0.15)
    before, after = hidden(operator, 0.0), hidden(operator, 1.7)
    rays, area = CAMERA.rays(), CAMERA.solid_angle()
    middle = (rays * (before * area)[..., None]).sum(axis=(0, 1)) / (before * area).sum()
    assert middle[1] > 0.3  # y is down
    behind = before & (rays[..., 2] < 0)
    assert behind.sum() > 0.4 * before.sum()
    assert before[-2:].mean() > 0.9  # the stick or hand right below
    overlap = (before & after).sum() / (before | after).sum()
    assert 0.6 < overlap < 0.98


def test_operators_of_other_seeds_look_otherwise() -> None:
    a, b = Operator(0.15, seed=0).solids(0.0), Operator(0.15, seed=1).solids(0.0)
    assert len(a.materials) != len(b.materials) or not np.allclose(a.materials, b.materials)


def test_a_car_is_rigid_and_hides_its_share() -> None:
    car = Car(0.25)
    assert share_hidden([car.solids(1.0)]) == pytest.approx(0.25, rel=0.05)
    a, b = hidden(car, 0.0), hidden(car, 2.0)
    assert (a & b).sum() / (a | b).sum() > 0.97
