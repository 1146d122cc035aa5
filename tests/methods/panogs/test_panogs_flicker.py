"""Flicker: bands that wander over the frames are taken out, and nothing else is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.tracking.flicker import Flicker, row_gains
from panobench.types import Frame

HEIGHT, WIDTH = 64, 128


def scene() -> NDArray[np.float64]:
    """(H, W, 3) of 255: texture of 80 to 160."""
    return np.random.default_rng(0).uniform(80, 160, (HEIGHT, WIDTH, 1)).repeat(3, axis=2)


def banded(image: NDArray[np.float64], phase: float, share: float = 0.2) -> NDArray[np.uint8]:
    rows = 1 + share * np.sin(2 * np.pi * (phase + np.arange(HEIGHT) / HEIGHT))
    return np.rint(image * rows[:, None, None]).astype(np.uint8)


def test_bands_are_taken_out() -> None:
    flicker = Flicker(enabled=True)
    given = [banded(scene(), phase) for phase in (0.0, 0.3, 0.7)]
    steady = [flicker.steady(Frame(k, k / 15, image)).image.astype(float) for k, image in enumerate(given)]
    assert np.array_equal(steady[0], given[0])  # what the others are brought to
    for before, image in zip(given[1:], steady[1:]):
        assert np.abs(before.astype(float) - given[0]).mean() > 10
        assert np.abs(image - steady[0]).mean() < 2.5


def test_a_turn_of_the_camera_is_no_flicker() -> None:
    image = scene().mean(axis=2).astype(np.float32) / 255
    assert np.abs(np.log(row_gains(np.roll(image, 17, axis=1), image))).max() < 0.03


def test_rows_that_are_dark_or_saturated_tell_nothing() -> None:
    image = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    before = image.copy()
    image[:32], before[:32] = 1.0, 0.2
    assert np.abs(np.log(row_gains(image, before))).max() == 0


def test_it_is_off_unless_asked_for() -> None:
    frame = Frame(0, 0.0, banded(scene(), 0.3))
    assert Flicker(enabled=False).steady(frame) is frame
