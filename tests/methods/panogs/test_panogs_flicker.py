"""Flicker: bands that wander over the frames are found and taken out, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.methods.panogs.tracking.flicker import AGAIN, Flicker
from panobench.photometric.bands import WINDOW, find_bands, log_row_gains
from panobench.types import Frame

HEIGHT, WIDTH, FPS = 64, 128, 15.0


def scene(moved: int = 0) -> NDArray[np.float64]:
    """(H, W, 3) of 255: texture of 80 to 160, lighter above, moved to the side."""
    texture = np.random.default_rng(0).uniform(80, 160, (HEIGHT, WIDTH, 1)) + np.linspace(30, 0, HEIGHT)[:, None, None]
    return np.roll(texture, moved, axis=1).repeat(3, axis=2)


def banded(image: NDArray[np.float64], phase: float, share: float, cycles: float = 1.37) -> NDArray[np.uint8]:
    rows = 1 + share * np.sin(2 * np.pi * (phase + cycles * np.arange(HEIGHT) / HEIGHT))
    return np.rint(image * rows[:, None, None]).astype(np.uint8)


def frames(share: float, count: int = 30) -> list[Frame]:
    """Of a camera that turns below a lamp of 100 Hz."""
    return [Frame(k, k / FPS, banded(scene(k), 100 / FPS * k, share)) for k in range(count)]


def watched(flicker: Flicker, given: list[Frame]) -> list[Frame]:
    """The frames as a map would be made of them, while there is none."""
    out: list[Frame] = []
    for frame in given:
        again = flicker.watch(frame, waiting=True) if flicker.watching else []
        out = again or [*out, flicker.steady(frame)]
    return out


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_bands_are_found_and_taken_out_of_all_frames(share: float) -> None:
    said: list[str] = []
    flicker, given = Flicker("auto", said.append), frames(share)
    steady = watched(flicker, given)
    assert [f.index for f in steady] == list(range(len(given)))
    assert flicker.bands is not None
    assert not flicker.watching
    assert flicker.bands.cycles == pytest.approx(1.37, abs=0.08)
    assert flicker.bands.amplitude == pytest.approx(share, rel=0.15)
    assert len(said) == 1
    assert "flicker" in said[0]
    for k, (before, after) in enumerate(zip(given, steady)):
        off = after.image.astype(float) - scene(k)
        assert np.abs(off).mean() < max(0.2 * np.abs(before.image - scene(k)).mean(), 0.7)


def test_bands_that_fade_are_followed() -> None:
    flicker = Flicker("auto", lambda _: None)
    watched(flicker, frames(0.1))
    for k in range(30, 50):
        after = flicker.steady(Frame(k, k / FPS, banded(scene(k), 0.0, 0.0)))
    assert np.abs(after.image.astype(float) - scene(49)).mean() < 0.7


def test_where_nothing_flickers_frames_stay_as_they_are() -> None:
    flicker, given = Flicker("auto", lambda _: None), frames(0.0)
    steady = watched(flicker, given)
    assert flicker.bands is None
    assert all(a is b for a, b in zip(given, steady))


def test_it_watches_until_there_is_a_map() -> None:
    flicker, given = Flicker("auto", lambda _: None), frames(0.0)
    for k, frame in enumerate(given[: WINDOW + AGAIN + 1]):
        assert flicker.watching
        flicker.watch(frame, waiting=k < 4)
    assert not flicker.watching


def test_it_can_be_told() -> None:
    assert not Flicker(False, lambda _: None).watching
    weak = frames(0.008)
    for mode, found in (("auto", False), (True, True)):
        flicker = Flicker(mode, lambda _: None)  # type: ignore[arg-type]
        watched(flicker, weak)
        assert (flicker.bands is not None) == found


def test_rows_that_are_dark_or_saturated_tell_nothing() -> None:
    image = np.full((HEIGHT, WIDTH), 0.5, np.float32)
    before = image.copy()
    image[:32], before[:32] = 1.0, 0.2
    gains = log_row_gains(before, image)
    assert np.isnan(gains[:32]).all()
    assert np.all(gains[32:] == 0)
    assert find_bands([gains] * WINDOW, [k / FPS for k in range(WINDOW + 1)]) is None
