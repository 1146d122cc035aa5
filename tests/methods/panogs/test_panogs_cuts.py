"""Where a recording goes on at another place."""

from __future__ import annotations

import numpy as np

from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import so3_exp
from panobench.methods.panogs.several_maps.cuts import CutDetector
from panobench.testing import TinySequence, erp_camera
from panobench.types import Frame


def cuts(images: list[np.ndarray], indices: list[int] | None = None) -> list[int]:
    detector = CutDetector(erp_camera(96), 0.5)
    numbers = indices or list(range(len(images)))
    return [i for i, image in zip(numbers, images) if detector.look(Frame(i, i / 10, image))]


def test_a_cut_is_where_two_frames_in_a_row_show_different_places() -> None:
    one, other = (TinySequence(erp_camera(96), 20, seed=seed) for seed in (0, 99))
    images = [one.image(i) for i in range(10)] + [other.image(i) for i in range(10)]
    assert cuts(images) == [10]
    assert cuts(images, [*range(10), *range(20, 30)]) == []  # nobody knows what was in between


def test_turns_and_exposure_are_no_cuts() -> None:
    sequence = TinySequence(erp_camera(96), 8)
    turned = []
    for i in range(8):
        T = sequence.pose_at(i / 10).copy()
        T[:3, :3] = T[:3, :3] @ so3_exp([0.0, 0.7 * i, 0.0])
        turned.append(sequence.image_from(T))
    assert cuts(turned) == []
    assert cuts([sequence.image(0), np.clip(0.5 * sequence.image(1), 0, 255).astype(np.uint8)]) == []


def test_frames_that_always_differ_a_lot_are_no_cuts() -> None:
    images = [TinySequence(erp_camera(96), 1, seed=seed).image(0) for seed in range(12)]
    assert cuts(images) == []


def test_a_narrow_view_that_turns_away_is_not_cut() -> None:
    camera = PinholeCamera.from_fov(96, 72, 70)
    one, other = (TinySequence(camera, 2, seed=seed) for seed in (0, 99))
    detector = CutDetector(camera, 0.5)
    assert not detector.look(Frame(0, 0.0, one.image(0)))
    assert not detector.look(Frame(1, 0.1, other.image(1)))
