"""Disturbed streams: what each disturbance does, that it is repeatable, and that the truth stays true."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.reproject import Reprojector
from panobench.datasets.open import open_sequence
from panobench.datasets.synthetic.disturb import Disturbances, Disturber, roll_columns, streak
from panobench.errors import UnknownNameError, UsageError
from panobench.plugins import registry
from panobench.specs import DatasetSpec
from panobench.testing import check_spec

GREY = np.full((64, 128, 3), 128, np.uint8)


def disturber(text: str, frames: int = 40, camera: ErpCamera | None = None) -> Disturber:
    return Disturber(Disturbances.parse(text.split(":")), camera or ErpCamera(128, 64), frames)


def test_noise_has_the_strength_asked_for_and_repeats() -> None:
    noise = disturber("noise=0.03")
    difference = (noise(GREY, 3).astype(float) - 128) / 255
    assert difference.std() == pytest.approx(0.03, rel=0.03)
    assert np.array_equal(noise(GREY, 3), noise(GREY, 3))
    assert not np.array_equal(noise(GREY, 3), noise(GREY, 4))


def test_a_streak_spreads_a_column_over_its_length_and_keeps_the_sum() -> None:
    line = np.zeros((4, 32, 3))
    line[:, 0] = 1.0
    blurred = streak(line, 2.0, wrap=True)
    assert blurred.sum() == pytest.approx(line.sum())
    offsets = (np.arange(32) + 16) % 32 - 16
    profile = blurred[0, :, 0]
    assert profile @ offsets == pytest.approx(0.0, abs=1e-12)
    # a box of length 2 has variance 1/3, linear interpolation adds about 1/6
    assert profile @ offsets**2 == pytest.approx(1 / 3 + 1 / 6, abs=0.02)
    assert streak(line, 2.0, wrap=False)[0, -1, 0] == 0.0


def test_exposure_swings_by_the_share_asked_for() -> None:
    rolling = disturber("rolling=0.3")
    gains = [rolling(GREY, i).mean() / 128 for i in range(24)]
    assert (min(gains), max(gains)) == (pytest.approx(0.7, abs=0.01), pytest.approx(1.3, abs=0.01))


def test_the_occluder_hides_its_share_of_the_sphere_and_moves() -> None:
    occluder = disturber("occluder=0.25")
    area = ErpCamera(128, 64).solid_angle()
    hidden = [(occluder(GREY, i) != 128).any(axis=-1) for i in (0, 30)]
    for seen in hidden:
        assert (seen * area).sum() / area.sum() == pytest.approx(0.25, abs=0.01)
    assert (hidden[0] != hidden[1]).mean() > 0.1


def test_black_frames_are_in_the_middle() -> None:
    black = disturber("black=20", frames=120)
    assert [i for i in range(120) if not black(GREY, i).any()] == list(range(50, 70))


def test_turning_agrees_with_reprojection_and_with_the_true_poses() -> None:
    camera = ErpCamera(128, 64)
    u, v = np.meshgrid(np.arange(128), np.arange(64))
    waves = 0.5 + 0.3 * np.sin(2 * np.pi * (3 * u + 2 * v) / 128)
    image = np.uint8(np.round(255 * np.repeat(waves[..., None], 3, axis=2)))
    yaw = disturber("yaw=6", camera=camera)
    expected = Reprojector(camera, camera, yaw.rotation(7)[:3, :3].T).image(image)
    assert np.abs(yaw(image, 7).astype(int) - expected.astype(int)).mean() < 1.0
    assert np.allclose(roll_columns(waves[..., None], 5.0), np.roll(waves[..., None], -5, axis=1))
    plain, turned = (open_sequence("disturbed", name, width=64) for name in ("tiny", "tiny:yaw=6"))
    assert plain.groundtruth is not None
    assert turned.groundtruth is not None
    relative = plain.groundtruth.T_wc[10, :3, :3].T @ turned.groundtruth.T_wc[10, :3, :3]
    assert np.degrees(np.arccos((np.trace(relative) - 1) / 2)) == pytest.approx(60.0)
    assert np.allclose(relative @ [0, 0, 1], [np.sin(np.pi / 3), 0, 0.5])


def test_several_disturbances_by_name_and_none_at_all() -> None:
    plain, same = open_sequence("rooms", "tiny", width=64), open_sequence("disturbed", "rooms/tiny", width=64)
    assert np.array_equal(plain.image(5), same.image(5))
    both = open_sequence("disturbed", "rooms/tiny:noise=0.01:black", width=64)
    assert both.provenance()["disturbances"] == {"version": 1, "seed": 0, "noise": 0.01, "black": 20.0}
    assert not both.image(20).any()


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("tiny:nois=1", UnknownNameError, "did you mean 'noise'"),
        ("tiny:noise=much", UsageError, "'much' is not a number"),
        ("tiny:noise=nan", UsageError, "must be between"),
        ("tiny:blur=99", UsageError, "must be between"),
        ("disturbed/tiny", UsageError, "not disturbed yet"),
        ("rooms/tinny", UnknownNameError, "did you mean 'tiny'"),
    ],
)
def test_mistakes_in_names_are_said(name: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        open_sequence("disturbed", name, width=64)


def test_only_full_panoramas_turn() -> None:
    camera = ErpCamera(64, 32, mask=np.arange(32)[:, None].repeat(64, axis=1) < 20)
    with pytest.raises(UsageError, match="full panoramas"):
        disturber("yaw", camera=camera)


def test_it_keeps_the_datasets_contract(monkeypatch: pytest.MonkeyPatch) -> None:
    from panobench.datasets.synthetic.disturbed import DisturbedDataset

    monkeypatch.setattr(DisturbedDataset, "sequences", lambda self: ["rooms/tiny:yaw=6:noise=0.03"])
    checks = check_spec(registry().get(DatasetSpec, "disturbed"))
    assert [f"{c.name}: {c.message}" for c in checks if c.outcome == "fail"] == []
