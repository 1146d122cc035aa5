"""The mask from geometry alone: operators are found, rooms stay whole, and what cannot be told is said."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import pytest
from mask_walks import walk

from panobench.cameras.erp import ErpCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.capture.sequence import CapturedSequence
from panobench.datasets.base import FrameSequence
from panobench.datasets.writing.converted import ConvertedSequence
from panobench.geometry import so3_exp, so3_log
from panobench.masks import geometry
from panobench.masks.base import NOT_RIGID, MaskEstimate
from panobench.masks.empty import empty_part
from panobench.masks.geometry import GeometryMask, Votes, _Frames, view_share
from panobench.masks.panorama import Panorama
from panobench.plugins import registry
from panobench.specs import MaskSpec
from panobench.testing import check_spec


class Frames(FrameSequence):
    """Given images."""

    name, dataset = "frames", "frames"

    def __init__(self, camera: ErpCamera, images: list[np.ndarray]) -> None:
        self.camera, self._images, self.times = camera, images, np.arange(len(images)) / 15

    def image(self, index: int) -> np.ndarray:
        return self._images[index]


def estimate(sequence: FrameSequence) -> MaskEstimate:
    return GeometryMask().estimate(sequence)


@lru_cache
def found_on(name: str) -> MaskEstimate:
    """The mask of a walk, which several tests look at."""
    return estimate(walk(name))


def scores(sequence: CapturedSequence, found: MaskEstimate) -> tuple[float, float]:
    """Mean share of the carrier that is hidden, and share of the sphere hidden where it never is."""
    area = sequence.camera.solid_angle() / (4 * np.pi)
    true = {i: sequence.hidden(i)[0] for i in range(0, len(sequence), 6)}
    hidden = {i: ~(found.valid & found.frames.get(i, found.valid)) for i in true}
    ever = np.any(list(true.values()), axis=0)
    recall = np.mean([area[hidden[i] & t].sum() / area[t].sum() for i, t in true.items()])
    return float(recall), float(np.mean([area[h & ~ever].sum() for h in hidden.values()]))


@pytest.mark.parametrize(
    "name", ["tiny+operator-15", "tiny+operator-5+seed-1", "tiny+car-20", "tiny+operator-15+tilt-15+locked"]
)
def test_whoever_carries_the_camera_is_hidden(name: str) -> None:
    sequence = walk(name)
    assert isinstance(sequence, CapturedSequence)
    found = found_on(name)
    recall, wrongly = scores(sequence, found)
    assert found.ok
    assert len(found.details["pairs"]) > 5  # five left half a face unhidden that turns
    assert recall > 0.9
    assert wrongly < 0.08  # images of 192 pixels: a rim of two degrees is a fifth of the operator


def test_what_is_black_in_all_frames_is_no_scene() -> None:
    """One fisheye in a panorama's frame, of a black border that compression has blurred. A dark thing is a thing."""
    room = walk("tiny")
    behind = room.camera.rays()[..., 2] < 0.05
    images = [np.where(behind[..., None], 0, room.image(i)).astype(np.uint8) for i in range(30)]
    images = [cv2.imdecode(cv2.imencode(".jpg", image)[1], cv2.IMREAD_COLOR) for image in images]
    found = estimate(Frames(room.camera, images))
    assert found.valid[behind].mean() < 0.03
    assert found.valid[~behind].mean() > 0.95
    assert "black in all frames" in found.message
    assert not empty_part(room).any()
    assert not empty_part(Frames(room.camera, [np.zeros_like(images[0])] * 3)).any()


def test_too_much_to_hide_is_said_and_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(geometry, "MOST", 0.1)
    found = estimate(walk("tiny+car-20"))
    assert not found.ok
    assert found.valid.all()
    assert found.details[NOT_RIGID] > 0.15


def test_whoever_turns_in_a_levelled_picture_is_hidden_where_she_is() -> None:
    sequence = walk("tiny+operator-15+tilt-25+levelled")
    assert isinstance(sequence, CapturedSequence)
    found = estimate(sequence)
    assert set(found.frames) == set(range(len(sequence)))
    assert found.whole is not None
    area = sequence.camera.solid_angle() / (4 * np.pi)
    missed = {"frames": 0.0, "whole": 0.0}
    for i in range(0, len(sequence), 6):
        carrier = sequence.hidden(i)[0]
        assert (found.frames[i] <= found.valid).mean() > 0.99
        missed["frames"] += area[carrier & found.frames[i]].sum()
        missed["whole"] += area[carrier & found.whole].sum()
    assert missed["frames"] < 0.3 * missed["whole"]
    assert "turns in the picture" in found.message
    with pytest.raises(KeyError):
        found.frames[len(sequence)]


def test_who_swings_fast_is_followed_from_where_one_pair_of_frames_saw_her() -> None:
    """In steps of 0.3 s she would be lost, and what she has swept over is scene for the most part."""
    panorama, rng = Panorama(256), np.random.default_rng(0)
    looks = [3 * cv2.GaussianBlur(rng.uniform(-255, 255, (128, 256, 3)), (0, 0), 2.0) + 128 for _ in range(2)]
    scene, carrier = (np.clip(look, 0, 255).astype(np.float32) for look in looks)
    there = (panorama.rays[..., 1] > 0.1) & (panorama.rays[..., 2] > 0.3)
    true = [so3_exp([0.0, np.deg2rad(64) * np.sin(np.pi * (i - 15) / 15), 0.0]) for i in range(31)]
    images, where = [], []
    for R in true:
        back = panorama.rays @ R
        where.append(panorama.at(there.astype(np.float32), back) > 0.5)
        images.append(np.where(where[-1][..., None], panorama.at(carrier, back), scene).astype(np.uint8))
    votes = [Votes(i, np.where(where[i], 1.0, -1.0), np.ones((128, 256))) for i in (0, 5, 15, 22, 30)]
    turns = _Frames(Frames(panorama.camera, images), panorama.camera).turns(votes, np.any(where, axis=0))
    assert turns is not None
    assert max(np.linalg.norm(so3_log(R.T @ T)) for R, T in zip(true, turns)) < np.deg2rad(4)


def test_what_is_lost_once_it_is_followed_is_hidden_where_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """As a hand before a lens for a while: by turns that are none of a carrier's, no vote is left to hide anything."""
    rng = np.random.default_rng(0)
    monkeypatch.setattr(
        geometry._Frames, "turns", lambda self, *_: [so3_exp(rng.normal(0, 2, 3)) for _ in range(len(self.sequence))]
    )
    found = estimate(walk("tiny+operator-15"))
    assert not found.frames
    assert not found.valid.all()
    assert "turns in the picture" not in found.message


def test_who_only_sways_gets_one_mask_for_all_frames() -> None:
    found = found_on("tiny+operator-15")
    assert not found.frames
    assert found.whole is None


def test_a_room_with_nobody_in_it_stays_whole() -> None:
    found = estimate(walk("tiny"))
    assert found.ok
    assert found.valid.all()
    assert "nothing moves with the camera" in found.message


def test_a_still_camera_says_that_it_cannot_tell() -> None:
    sequence = walk("tiny+operator-15")
    found = estimate(Frames(ErpCamera(192, 96), [sequence.image(0)] * 20))
    assert not found.ok
    assert found.valid.all()
    assert "hardly moves" in found.message


def test_a_camera_that_only_turns_hides_nothing_but_what_turns_with_it() -> None:
    from panobench.cameras.reproject import Reprojector

    camera = ErpCamera(192, 96)
    scene, images = walk("tiny").image(0), []
    for i in range(24):
        images.append(Reprojector(camera, camera, so3_exp([0.01 * np.sin(i), 0.05 * i, 0.0])).image(scene))
    assert estimate(Frames(camera, images)).valid.all()
    pattern = np.random.default_rng(0).integers(0, 255, (12, 24, 3)).repeat(4, axis=0).repeat(4, axis=1)
    for image in images:
        image[48:, 48:144] = pattern[:48, :96]
    hidden = ~estimate(Frames(camera, images)).valid
    assert hidden[52:90, 56:136].mean() > 0.9
    assert hidden[:40].mean() < 0.02


def test_other_cameras_and_masks_that_are_there_already() -> None:
    source = walk("tiny+operator-15")
    fisheye = KannalaBrandtCamera(128, 128, 42.0, 42.0, 64.0, 64.0, fov_deg=170.0)
    down = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    found = estimate(ConvertedSequence(source, fisheye, down))
    assert found.ok
    assert 0.1 < view_share(fisheye.solid_angle(), fisheye.valid_mask() & ~found.valid) < 0.8
    rows = np.arange(96)[:, None].repeat(192, axis=1)
    camera = ErpCamera(192, 96, mask=rows < 60)
    clean = walk("tiny")
    masked = [np.where(camera.valid_mask()[..., None], clean.image(i), 0) for i in range(len(clean))]
    assert np.array_equal(estimate(Frames(camera, masked)).valid, camera.valid_mask())


def test_it_keeps_the_contract_of_mask_estimators() -> None:
    checks = check_spec(registry().get(MaskSpec, "geometry"))
    assert [f"{c.name}: {c.message}" for c in checks if c.outcome == "fail"] == []
    assert {c.name for c in checks} >= {"answer", "determinism", "short"}


def test_bands_of_flickering_light_are_taken_out_of_what_is_looked_at() -> None:
    texture = np.random.default_rng(0).uniform(80, 160, (64, 128, 1)).repeat(3, axis=2)
    waves = [1 + 0.2 * np.sin(2 * np.pi * (0.41 * k + 1.3 * np.arange(64) / 64)) for k in range(14)]
    camera = ErpCamera(128, 64)
    given = [
        np.rint(np.roll(texture, k, axis=1) * wave[:, None, None]).astype(np.uint8) for k, wave in enumerate(waves)
    ]
    looked_at = _Frames(Frames(camera, given), camera)
    remover = looked_at._remover_at(12)  # near the end, where fewer frames follow than it takes
    assert remover is not None
    off = remover.steady(given[12], 12 / 15) - np.roll(texture, 12, axis=1)
    assert np.abs(off).mean() < 0.2 * np.abs(given[12] - np.roll(texture, 12, axis=1)).mean()
    steady = [np.rint(np.roll(texture, k, axis=1)).astype(np.uint8) for k in range(14)]
    assert _Frames(Frames(camera, steady), camera)._remover is None
