"""Rays against solids: what they cover, where they are met, and what hides them."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.capture.casting import Coverage, Light, cast, light_of
from panobench.capture.solids import PLAIN, Builder, Material, Solids, joined

CAMERA = ErpCamera(192, 96)
RAYS = CAMERA.rays().astype(np.float32)
AREA = CAMERA.solid_angle()
#: Irradiance / pi of 1 from everywhere.
EVEN = Light(np.vstack([[1 / 0.282095] * 3, np.zeros((8, 3))]), np.zeros((1, 1, 3), np.float32))
GREY = Material(PLAIN, (0.5, 0.5, 0.5))


def ball(centre: tuple[float, float, float], radius: float) -> Solids:
    add = Builder()
    add.ellipsoid(centre, (radius, radius, radius), np.eye(3), GREY)
    return add.build()


def seen(solids: Solids, **more: object) -> Coverage:
    return cast(solids, RAYS, np.eye(4), EVEN, **more)  # type: ignore[arg-type]


def test_a_ball_covers_the_solid_angle_of_its_cap() -> None:
    for centre in ((0.3, 0.2, 1.0), (-0.5, 1.0, -0.8)):
        cap = 2 * np.pi * (1 - np.sqrt(1 - 0.3**2 / np.dot(centre, centre)))
        assert (seen(ball(centre, 0.3)).share * AREA).sum() == pytest.approx(cap, rel=0.01)


def test_a_cone_is_the_hull_of_its_two_balls() -> None:
    add = Builder()
    add.cone((-0.4, 0.1, 1.0), (0.5, 0.3, 1.4), 0.1, 0.3, GREY)
    hull = seen(add.build()).share
    along = np.linspace(0, 1, 200)
    balls = joined(
        [ball(tuple(np.array([-0.4, 0.1, 1.0]) + s * np.array([0.9, 0.2, 0.4])), 0.1 + 0.2 * s) for s in along]
    )  # type: ignore[arg-type]
    assert np.abs(hull - seen(balls).share).max() <= 1 / 9 + 1e-6
    assert ((hull - seen(balls).share) ** 2 * AREA).sum() < 1e-4


def test_a_turned_figure_is_what_a_turned_camera_sees() -> None:
    from panobench.geometry import make_pose, so3_exp

    T = make_pose(so3_exp([0.3, -0.8, 0.5]), [0.2, 0.1, -0.3])
    add = Builder()
    add.cone((-0.4, 0.1, 1.0), (0.5, 0.3, 1.4), 0.1, 0.3, GREY)
    add.ellipsoid((-0.8, 0, 0.2), (0.1, 0.3, 0.2), so3_exp([0.1, 0.2, 0.3]), Material(PLAIN, (0.9, 0.1, 0.1)))
    turned = cast(add.build(), RAYS, T, EVEN)
    moved = seen(add.build().moved(np.linalg.inv(T)))
    assert np.allclose(turned.share, moved.share, atol=0.12)
    assert np.abs(turned.colour - moved.colour).mean() < 1e-4


def test_what_is_nearer_hides_it() -> None:
    figure = ball((0, 0, 1.0), 0.3)
    left = np.where(np.arange(192) < 96, 0.5, 2.0)[None].repeat(96, axis=0).astype(np.float32)
    share = seen(figure, depth=left).share
    assert share[:, :96].sum() == 0
    assert share[:, 96:].sum() == pytest.approx(seen(figure).share[:, 96:].sum())


def test_light_comes_from_where_the_view_is_bright() -> None:
    sky = np.where(RAYS[..., 1] < 0, 1.0, 0.0)[..., None].repeat(3, axis=-1).astype(np.float32)
    light = light_of(sky, RAYS, AREA)
    figure = cast(ball((0, 0, 1.0), 0.3), RAYS, np.eye(4), light).colour[..., 1]
    top, bottom = figure[:46].max(), figure[52:][figure[52:] > 0].mean()
    assert top > 2 * bottom > 0
