"""From evidence to a mask."""

from __future__ import annotations

import numpy as np

from panobench.cameras.pinhole import PinholeCamera
from panobench.masks.panorama import Panorama
from panobench.masks.region import components, grown, hidden_region, to_camera

P = Panorama(128)


def cap(direction: tuple[float, float, float], degrees: float) -> np.ndarray:
    d = np.asarray(direction) / np.linalg.norm(direction)
    return P.rays @ d > np.cos(np.radians(degrees))


def region(share_hidden: np.ndarray, strength: float = 10.0) -> np.ndarray:
    return hidden_region(P, np.where(share_hidden, strength, -strength), np.full(share_hidden.shape, strength))


def test_regions_go_over_seam_and_poles() -> None:
    parts, _ = components(cap((0, 0, -1), 20) | cap((0, 1, 0), 10) | cap((1, 0, 0), 5))
    assert len(np.unique(parts)) == 4
    assert parts[32, 0] == parts[32, -1] > 0
    assert len(np.unique(parts[-1])) == 1


def test_what_is_found_is_widened_by_a_little_and_speckles_are_dropped() -> None:
    true = cap((0, 0.8, -0.6), 30)
    found = region(true)
    assert found[true].all()
    wider = found & ~true
    assert 0 < (wider * P.area).sum() < 0.35 * (true * P.area).sum()
    assert not region(cap((1, 0, 0), 1.5)).any()
    assert not region(np.zeros_like(true)).any()


def test_doubtful_evidence_beside_what_is_found_counts_and_by_itself_does_not() -> None:
    found, beside = cap((0, 0, 1), 20), cap((0, 0, 1), 40) & ~cap((0, 0, 1), 20)
    apart = cap((0, 0, -1), 20)
    weights = np.full(found.shape, 10.0)
    doubtful = hidden_region(P, np.select([found, beside | apart], [10.0, -1.4], -10.0), weights)
    assert doubtful[beside].mean() > 0.95
    assert not doubtful[apart].any()
    scene = hidden_region(P, np.select([found, beside | apart], [10.0, -2.5], -10.0), weights)
    assert scene[beside & ~cap((0, 0, 1), 30)].mean() < 0.05


def test_gaps_and_holes_are_filled_but_not_the_scene_between() -> None:
    true = cap((0, 1, 0), 60) & ~cap((0, 0.8, -0.6), 8)
    assert region(true)[cap((0, 0.8, -0.6), 7)].all()
    ring = ~cap((0, 1, 0), 60) & cap((0, 1, 0), 75)
    assert not region(ring)[cap((0, 1, 0), 45)].any()


def test_without_votes_nothing_is_hidden() -> None:
    none = np.zeros((64, 128))
    assert not hidden_region(P, none, none).any()


def test_growing_is_by_an_angle() -> None:
    for direction in ((0, 1, 0), (1, 0, 0)):
        wide = grown(P, cap(direction, 20), 2)
        assert cap(direction, 23)[wide].mean() > 0
        assert wide[cap(direction, 23)].mean() > 0.97
        assert not wide[~cap(direction, 30)].any()


def test_masks_come_to_any_camera() -> None:
    camera = PinholeCamera(64, 48, 40.0, 40.0, 32.0, 24.0)
    hidden = to_camera(P, cap((0, 0.5, 1), 25), camera.rays())
    inside = camera.rays() @ (np.array([0, 0.5, 1]) / np.linalg.norm([0, 0.5, 1])) > np.cos(np.radians(25))
    assert (hidden == inside).mean() > 0.96
