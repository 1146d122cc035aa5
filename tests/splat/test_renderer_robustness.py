"""Extreme parameters, order of the Gaussians, threads, touch counts."""

from __future__ import annotations

import numpy as np
import pytest
from splat_scenes import CAMERAS, CASES, POSE, gaussian_map, random_scene

from panobench.cameras.erp import ErpCamera
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.splat.view import Projection

COORDINATES = [0.0, 1e-30, -1e-8, 0.0099, 0.01, 0.011, -0.5, 1.0, 3.0, -4.0, 1e4, -1e8, 1e15, 3e38]
LOG_SCALES = [-1e30, -200.0, -20.0, -3.0, 0.0, 5.0, 40.0, 200.0, 1e30]
QUATERNION = [0.0, 1e-25, -1e-6, 1.0, -3.0, 1e15]
LOGITS = [-1e30, -100.0, -5.6, 0.0, 5.0, 20.0, 100.0, 1e30]
COLOURS = [-1.0, 0.0, 0.5, 1.0, 100.0]


def check_finite(g: GaussianMap, camera: str, projection: Projection) -> None:
    renderer = Renderer(CAMERAS[camera], projection)
    out = renderer.forward(g, np.eye(4), count_touched=True)
    for name, a in (("colour", out.colour), ("depth", out.depth), ("opacity", out.opacity)):
        assert np.isfinite(a).all(), name
    assert out.opacity.min() >= 0
    assert out.opacity.max() <= 1
    assert out.touched is not None
    assert out.touched.min(initial=0) >= 0
    assert out.touched.max(initial=0) <= out.opacity.size
    ones = np.ones_like(out.depth)
    grads = out.backward(np.ones_like(out.colour), ones, -ones)
    assert np.isfinite(grads.packed).all(), np.argwhere(~np.isfinite(grads.packed))
    assert np.isfinite(grads.pose).all()


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_extreme_parameters_give_finite_images_and_gradients(camera: str, projection: Projection) -> None:
    rng = np.random.default_rng(33)

    def pick(values: list[float], *shape: int) -> np.ndarray:
        return rng.choice(np.array(values, np.float32), size=shape)

    for n in rng.integers(1, 9, size=200):
        parameters = (
            pick(COORDINATES, n, 3),
            pick(LOG_SCALES, n, 3),
            pick(QUATERNION, n, 4),
            pick(LOGITS, n),
            pick(COLOURS, n, 3),
        )
        check_finite(GaussianMap(*parameters), camera, projection)


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_every_combination_of_place_size_and_opacity(camera: str, projection: Projection) -> None:
    """All at once: at the centre, on both sides of ``near``, on the poles' axis, behind, far; flat, thin, huge."""
    places = [[0, 0, 0], [0, 0, 0.01], [0, 0.02, 0], [0, -2, 0], [0, 2, 1e-7], [0, 0, -2], [1e5, 0, 1], [1, 1, 1]]
    sizes = [[-30] * 3, [-30, 0, 0], [0, -30, -30], [3] * 3, [-2, 8, -30]]
    logits = [-50.0, -5.5, 0.0, 30.0]
    rows = [(p, s, o) for p in places for s in sizes for o in logits]
    g = GaussianMap(
        np.array([r[0] for r in rows], np.float32),
        np.array([r[1] for r in rows], np.float32),
        np.random.default_rng(0).normal(size=(len(rows), 4)).astype(np.float32),
        np.array([r[2] for r in rows], np.float32),
        np.full((len(rows), 3), 0.5, np.float32),
    )
    check_finite(g, camera, projection)
    for k in range(len(g)):
        check_finite(g.select(np.array([k])), camera, projection)


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_what_cannot_be_seen_is_not_drawn_and_does_not_learn(camera: str, projection: Projection) -> None:
    """At the centre, nearer than ``near``, or too faint; for the pinhole also behind."""
    hidden = [[0, 0, 0], [0, 0, 0.049], [0.03, 0.03, 0.01]] + ([[0.1, 0, -2.0]] if camera == "pinhole" else [])
    g = gaussian_map([*hidden, [0, 0, 2.0]], 0.1, [8.0] * len(hidden) + [-5.6])  # sigmoid(-5.6) < 1/255
    renderer = Renderer(CAMERAS[camera], projection, near=0.05)
    out = renderer.forward(g, np.eye(4), count_touched=True)
    assert not out.opacity.any()
    assert out.touched is not None
    assert not out.touched.any()
    grads = out.backward(np.ones_like(out.colour))
    assert not grads.packed.any()
    assert not grads.pose.any()


@pytest.mark.parametrize(("camera", "projection"), CASES)
def test_order_in_memory_does_not_matter(camera: str, projection: Projection) -> None:
    g = random_scene(200, 30, camera, projection)
    order = np.random.default_rng(0).permutation(len(g))
    renderer = Renderer(CAMERAS[camera], projection)
    weight = np.random.default_rng(1).normal(size=(CAMERAS[camera].height, CAMERAS[camera].width, 3)).astype(np.float32)
    a = renderer.forward(g, POSE, count_touched=True)
    ga = a.backward(weight)
    b = renderer.forward(g.select(order), POSE, count_touched=True)
    gb = b.backward(weight)
    np.testing.assert_array_equal(a.colour, b.colour)
    np.testing.assert_array_equal(a.depth, b.depth)
    assert a.touched is not None
    assert b.touched is not None
    np.testing.assert_array_equal(a.touched[order], b.touched)
    np.testing.assert_array_equal(ga.packed[order], gb.packed)
    np.testing.assert_allclose(ga.pose, gb.pose, rtol=1e-12)  # summed over the Gaussians in memory order, in float64
    assert a.colour.any()


def test_same_input_same_bits_and_threads_agree() -> None:
    g = random_scene(300, 31, "erp")
    weight = np.random.default_rng(1).normal(size=(36, 72, 3)).astype(np.float32)
    results = []
    for threads in (2, 2, 1, 3):
        renderer = Renderer(CAMERAS["erp"], threads=threads)
        for _ in range(2):
            render = renderer.forward(g, POSE)
            grads = render.backward(weight)
            results.append((render.colour, grads.packed, grads.pose))
    first = results[0]
    for image, packed, pose in results[1:4]:
        np.testing.assert_array_equal(image, first[0])
        np.testing.assert_array_equal(packed, first[1])
        np.testing.assert_array_equal(pose, first[2])
    for image, packed, pose in results[4:]:
        np.testing.assert_array_equal(image, first[0])  # tiles do not share anything
        np.testing.assert_allclose(packed, first[1], atol=1e-5 * np.abs(first[1]).max())
        np.testing.assert_allclose(pose, first[2], atol=1e-5 * np.abs(first[2]).max())


def test_equal_distances_keep_the_order_in_memory() -> None:
    red, green = [1.0, 0, 0], [0, 1.0, 0]
    for colours in ([red, green], [green, red]):
        g = gaussian_map([[0, 0, 2.0], [0, 0, 2.0]], 0.5, 0.0, colours)
        centre = Renderer(ErpCamera(33 * 2, 33)).forward(g, np.eye(4)).colour[16, 33]
        assert centre[np.argmax(colours[0])] > 1.5 * centre[np.argmax(colours[1])] > 0


def test_touched_counts_the_pixels_of_a_lone_gaussian() -> None:
    for camera, projection in CASES:
        g = gaussian_map([0.2, 0.1, 2.0], 0.3, 1.0)
        out = Renderer(CAMERAS[camera], projection).forward(g, np.eye(4), count_touched=True)
        assert out.touched is not None
        assert out.touched[0] == (out.opacity > 0).sum() > 20
        assert out.opacity[out.opacity > 0].min() > 0.999 / 255


def test_touched_stops_where_half_the_light_is_gone() -> None:
    """Sheets of alpha 0.4 over the whole hemisphere: light left is 1, 0.6, then 0.36."""
    logit = float(np.log(0.4 / 0.6))
    sheets = gaussian_map([[0, 0, 3.0], [0, 0, 1.0], [0, 0, 2.0]], 200.0, logit)
    camera = CAMERAS["erp"]
    out = Renderer(camera).forward(sheets, np.eye(4), count_touched=True)
    hemisphere = int((camera.rays()[..., 2] > 0.1).sum())
    assert out.touched is not None
    assert out.touched.tolist() == [0, hemisphere, hemisphere]


def test_touched_is_only_counted_when_asked_for() -> None:
    renderer = Renderer(CAMERAS["erp"])
    g = random_scene(20, 32, "erp")
    plain, counted = renderer.forward(g, POSE), renderer.forward(g, POSE, count_touched=True)
    assert plain.touched is None
    assert counted.touched is not None
    np.testing.assert_array_equal(plain.colour, counted.colour)
