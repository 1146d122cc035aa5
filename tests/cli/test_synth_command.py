from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from panobench.cli.main import run
from panobench.datasets.open import open_sequence

sys.path.insert(0, str(Path(__file__).parents[1] / "datasets"))
from dataset_samples import synpano_scene


def synth(*arguments: object) -> int:
    return run(["synth", "palvio", *map(str, arguments), "--quiet"])


def test_a_bag_holds_the_frames_asked_for_where_the_panoramas_were(tmp_path: Path) -> None:
    true = synpano_scene(tmp_path / "room", 7)
    source = ["--dataset", "synpano", "--root", tmp_path / "room", "--source-width", 64]
    assert synth("--out", tmp_path / "ID01.bag", *source, "--frames", 5, "--width", 160) == 0
    made = open_sequence("palvio", "ID01", tmp_path / "ID01.bag")
    assert len(made) == 5
    assert made.groundtruth is not None
    np.testing.assert_allclose(made.groundtruth.positions, true[:5, :3, 3], atol=1e-3)
    assert made.imu is not None
    assert made.imu.T_body_cam is not None


def test_the_seed_decides_the_noise(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room", 5)
    gyros = []
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        bag = tmp_path / name / "x.bag"
        options = ["--dataset", "synpano", "--root", tmp_path / "room", "--source-width", 64, "--width", 160]
        assert synth("--out", bag, *options, "--seed", seed) == 0
        imu = open_sequence("palvio", None, bag).imu
        assert imu is not None
        gyros.append(imu.gyro)
    np.testing.assert_array_equal(gyros[0], gyros[1])
    assert np.abs(gyros[0] - gyros[2]).max() > 1e-4


def test_a_walk_through_a_room_by_a_camera_that_looks_ahead(tmp_path: Path) -> None:
    walk = ["--sequence", "tiny", "--seconds", 2, "--frames", 22, "--still", 0, "--source-width", 64]
    lens = ["--camera", "pinhole", "--fov", "90x65", "--width", 160]
    assert synth("--out", tmp_path / "walk.bag", *walk, *lens) == 0
    made = open_sequence("palvio", "walk", tmp_path)
    assert (made.camera.kind, made.camera.width, len(made)) == ("pinhole", 160, 22)
    truth, imu = made.groundtruth, made.imu
    assert truth is not None
    assert imu is not None
    assert imu.T_body_cam is not None
    np.testing.assert_array_equal(truth.times, made.times)
    R_wb = truth.T_wc[:, :3, :3] @ imu.T_body_cam[:3, :3].T
    np.testing.assert_allclose(R_wb.mean(axis=0)[2], [0, 0, 1], atol=0.1)  # the body's z is up
    at = np.searchsorted(imu.times, truth.times[1:-1])
    up = np.einsum("nij,nj->ni", R_wb[1:-1], imu.accel[at]).mean(axis=0)
    np.testing.assert_allclose(up / np.linalg.norm(up), [0, 0, 1], atol=0.1)
    assert np.ptp([made.image(i) for i in (0, 20)]) > 50


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", "x.mp4"), "must end in .bag"),
        (("--frames", "2"), "--frames"),
        (("--dataset", "romms"), "did you mean 'rooms'"),
        (("--dataset", "synpano"), "needs --root"),
        (("--dataset", "synpano", "--seconds", "2"), "only the built-in rooms can be walked through"),
        (("--seconds", "2", "--sequence", "romm"), "built-in room"),
        (("--fov", "90"), "goes with --camera"),
    ],
)
def test_bad_options(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PANOBENCH_DATA", raising=False)
    assert synth("--source-width", 64, *arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
