"""Two lenses behind a stitched panorama: what each of them saw, and where the panorama shows a thing."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.two_lenses import TwoLenses


@pytest.fixture
def rays() -> np.ndarray:
    """Unit rays (500, 3), none at the seam."""
    d = np.random.default_rng(3).normal(size=(500, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return d[np.abs(d[:, 2]) > 0.1]


@pytest.mark.parametrize("inverse_distance", [0.0, 0.5])
def test_what_the_panorama_shows_is_seen_from_the_lens(rays: np.ndarray, inverse_distance: float) -> None:
    lenses = TwoLenses(0.06, inverse_distance)
    depth = np.random.default_rng(4).uniform(0.6, 6.0, len(rays))
    shown = lenses.stitched(rays, 1 / depth)
    from_lens = depth[:, None] * rays - lenses.origins(rays)
    from_lens /= np.linalg.norm(from_lens, axis=1, keepdims=True)
    np.testing.assert_allclose(lenses.seen(shown), from_lens, atol=1e-12)
    assert np.abs(shown - rays).max() > 0.01


def test_things_at_the_distance_it_was_stitched_for_are_in_place(rays: np.ndarray) -> None:
    lenses = TwoLenses(0.06, 0.5)
    np.testing.assert_allclose(lenses.stitched(rays, np.full(len(rays), 0.5)), rays, atol=1e-12)
    assert not lenses.parallax(rays, np.full(len(rays), 0.5)).any()


def test_parallax_is_how_far_apart_the_two_lenses_show_a_thing() -> None:
    """Beside the seam, where one lens alone is seen, a thing is off by half of it."""
    lenses, near, angle = TwoLenses(0.04, 0.5), np.array([1.25]), np.deg2rad(4.5)
    beside = np.array([[np.cos(angle), 0.0, np.sin(angle)]])
    shift = float(np.linalg.norm(lenses.stitched(beside, near) - beside))
    assert shift == pytest.approx(0.5 * lenses.parallax(beside, near)[0], rel=0.02)


def test_in_the_seam_a_thing_is_shown_twice_and_is_taken_for_in_between() -> None:
    lenses, middle = TwoLenses(0.04, 0.5), np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(lenses.stitched(middle, np.array([1.25]))[0, 1:], 0, atol=1e-12)
