"""A carrier that turns in the picture is followed by its look."""

from __future__ import annotations

import cv2
import numpy as np

from panobench.geometry import so3_exp, so3_log
from panobench.masks.panorama import Image, Panorama
from panobench.masks.turning import follow_carrier, interpolated

PANORAMA = Panorama(96)


def textured(seed: int) -> Image:
    """(H, W, 3): blobs of a few pixels."""
    noise = np.random.default_rng(seed).standard_normal((PANORAMA.height, PANORAMA.width, 3)).astype(np.float32)
    return np.asarray(3 * cv2.GaussianBlur(noise, (0, 0), 1.5), dtype=np.float32)


def test_the_turns_of_what_looks_the_same_are_found_before_a_scene_that_does_not_turn() -> None:
    region = PANORAMA.rays[..., 1] > 0.5  # below the camera
    scene, carrier = textured(0), textured(1)
    true = {i: so3_exp(np.deg2rad([3.0 * i, 0.0, -4.0 * i])) for i in range(-4, 5)}
    images = {}
    for i, R in true.items():
        back = PANORAMA.rays @ R  # where each direction of the picture was in the middle frame
        inside = PANORAMA.at(region.astype(np.float32), back)[..., None] > 0.5
        images[i] = np.where(inside, PANORAMA.at(carrier, back), scene).astype(np.float32)
    found = follow_carrier(PANORAMA, images, region, 0)
    for i, R in true.items():
        assert np.linalg.norm(so3_log(R.T @ found.turns[i])) < np.deg2rad(2)
    assert found.apart < 0.5
    assert abs(np.degrees(found.angle) - 20) < 2


def test_what_stays_in_the_picture_does_not_turn() -> None:
    image = textured(2)
    found = follow_carrier(PANORAMA, dict.fromkeys(range(5), image), PANORAMA.rays[..., 1] > 0.5, 2)
    assert found.angle < np.deg2rad(1)
    assert found.apart == 1.0


def test_turns_between_frames_are_in_between() -> None:
    turns = interpolated({0: np.eye(3), 4: so3_exp([0.0, 0.0, 0.4])}, 7)
    assert np.allclose(so3_log(turns[1]), [0, 0, 0.1])
    assert np.allclose(turns[6], turns[4])
    assert np.allclose(interpolated({3: turns[1]}, 2), turns[1])
