"""Runs of the Hilti challenge, made by ``synth hilti-360`` and read as the organisers' are."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import yaml

from panobench.capture.imu import ImuNoise
from panobench.capture.stroll import StrollOptions
from panobench.cli.main import run as command
from panobench.datasets.files.trajectory_io import read_tum
from panobench.datasets.hilti.calibration import (
    GRAVITY,
    STAMP_SHIFT_S,
    UNJUDGED_S,
    chain_calibration,
    operator_mask,
    published_calibration,
)
from panobench.datasets.hilti.dataset import HiltiSequence, paired
from panobench.datasets.hilti.layout import find_runs, run_name
from panobench.datasets.hilti.synth import HiltiSynthOptions, write_hilti_run
from panobench.datasets.open import open_sequence
from panobench.errors import CalibrationError, DatasetError, UsageError
from panobench.geometry import so3_log

NAME = "floor_synthetic_2026-01-01_run_1"
RATE = 4.0
CLEAN = HiltiSynthOptions(
    room="tiny",
    width=92,
    rate=RATE,
    readout_s=0.0,
    operator=0.0,
    walk=StrollOptions(seconds=7.0),
    noise=ImuNoise(),
    sensor_noise=0.0,
)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("hilti")
    write_hilti_run(out, CLEAN)
    return out


def opened(root: Path, width: int = 128) -> HiltiSequence:
    sequence = open_sequence("hilti-360", None, root, width)
    assert isinstance(sequence, HiltiSequence)
    return sequence


def test_the_lenses_look_forward_and_back_and_are_upright() -> None:
    rig = published_calibration().rig()
    front, back = (lens.T_rig_lens for lens in rig.lenses)
    np.testing.assert_allclose(front[:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=1e-9)
    np.testing.assert_allclose(back[:3, 2], [0, 0, -1], atol=0.02)
    np.testing.assert_allclose(back[:3, 1], [0, -1, 0], atol=0.03)  # stored upside down, too
    np.testing.assert_allclose(front[:3, 3], -back[:3, 3], atol=1e-9)
    assert 0.039 < rig.baseline_m < 0.042


def test_layout_and_stamps(root: Path) -> None:
    assert list(find_runs(root)) == [NAME]
    folder = find_runs(root)[NAME]
    assert folder == root / "floor_synthetic" / "2026-01-01" / "run_1"
    assert run_name(folder / "rosbag") == NAME
    assert list(find_runs(folder)) == list(find_runs(folder / "rosbag")) == [NAME]
    for place in (root, folder, folder / "rosbag"):
        sequence = opened(place)
        assert (sequence.name, len(sequence)) == (NAME, 28)
    lens = sequence.recording.contents[0].size[0]
    assert [HiltiSequence(sequence.recording, width).enlargement for width in (lens, 4 * lens)] == [1.0, 2.0]
    (root / "floor_synthetic" / "2026-01-01" / "run_2.partial").mkdir()  # as an interrupted synthesis leaves it
    assert list(find_runs(root)) == [NAME]
    np.testing.assert_allclose(sequence.times, STAMP_SHIFT_S + np.arange(28) / RATE, atol=1e-6)


def test_truth_is_that_of_the_rig_and_leaves_the_first_seconds_out(root: Path) -> None:
    sequence = opened(root)
    cam0 = read_tum(root / "groundtruth" / f"{NAME}.txt")
    truth = sequence.groundtruth
    assert truth is not None
    assert truth.times[0] == pytest.approx(STAMP_SHIFT_S + UNJUDGED_S)
    same = cam0.select(np.flatnonzero(cam0.times >= truth.times[0] - 1e-6))
    apart = np.linalg.norm(truth.positions - same.positions, axis=1)
    np.testing.assert_allclose(apart, 0.5 * published_calibration().rig().baseline_m, atol=1e-6)
    up = sequence.world_up
    assert up is not None
    assert (truth.T_wc[:, :3, 1] @ up < -0.9).all()  # y points down
    assert (same.T_wc[:, :3, 1] @ up > 0.9).all()  # cam0 is upside down


def test_pictures_are_taken_from_where_the_truth_says(root: Path) -> None:
    """Against the room rendered by one camera at the rig's origin: 2 cm of parallax in a room of 4 m are left."""
    from panobench.cameras.erp import ErpCamera
    from panobench.capture.scene import RayField, RoomScene
    from panobench.rooms.render import to_image
    from panobench.rooms.world import World

    sequence = opened(root)
    truth = sequence.groundtruth
    assert truth is not None
    camera = ErpCamera(128, 64)
    scene = RoomScene(World("tiny", 0, None), camera)
    seen = sequence.camera.valid_mask()
    for k in (0, len(truth) - 1):
        index = int(np.searchsorted(sequence.times, truth.times[k] - 1e-6))
        linear = scene.radiance(RayField.of(camera), truth.T_wc[k])
        error = np.abs(sequence.image(index).astype(float) - to_image(linear))[seen]
        turned = np.abs(np.roll(sequence.image(index), 4, axis=1).astype(float) - to_image(linear))[seen]
        assert error.mean() < 0.4 * turned.mean()


def test_the_rigs_pictures_and_masks(root: Path) -> None:
    sequence = opened(root)
    rig = sequence.rig
    assert rig is not None
    for picture, lens in zip(sequence.lens_images(3), rig.lenses, strict=True):
        assert picture.shape == (lens.camera.height, lens.camera.width, 3) == (63, 64, 3)
        valid = lens.camera.valid_mask()
        assert picture[valid].mean() > 30
        assert 0.4 < valid.mean() < 0.75
        # Upside down: what the operator is hidden by lies at the top of the picture.
        assert valid[:10].sum() < 0.7 * valid[-10:].sum()
    hidden = ~operator_mask(sequence.camera)
    assert not (sequence.camera.valid_mask() & hidden).any()
    np.testing.assert_array_equal(sequence.image(3), sequence.image(3 - len(sequence)))


def test_the_imu_measures_the_cameras_motion(root: Path) -> None:
    sequence = opened(root)
    imu, truth = sequence.imu, sequence.groundtruth
    assert imu is not None
    assert truth is not None
    assert imu.T_body_cam is not None
    assert imu.gravity == GRAVITY
    assert np.median(np.diff(imu.times)) == pytest.approx(1e-3, rel=1e-3)
    assert imu.times[0] < sequence.times[0] - 0.05
    # Between two frames the integrated rates turn the camera as the truth does.
    R_bc = imu.T_body_cam[:3, :3]
    a, b = truth.times[1], truth.times[2]
    inside = (imu.times >= a) & (imu.times < b)
    from panobench.geometry import so3_exp

    R = np.eye(3)
    for w in imu.gyro[inside]:
        R = R @ so3_exp(w * 1e-3)
    expected = R_bc @ (truth.T_wc[1, :3, :3].T @ truth.T_wc[2, :3, :3]) @ R_bc.T
    assert np.degrees(np.linalg.norm(so3_log(R.T @ expected))) < 0.2
    # Specific force points up on average.
    R_wb = truth.T_wc[:, :3, :3] @ R_bc.T
    near = np.searchsorted(imu.times, truth.times)
    up = np.einsum("nij,nj->ni", R_wb, imu.accel[near]).mean(axis=0)
    assert up[2] > 0.9 * np.linalg.norm(up)


def test_the_published_noise_is_there(tmp_path: Path) -> None:
    from panobench.capture.imu import BodyMotion, simulate_imu
    from panobench.datasets.hilti.calibration import NOISE
    from panobench.types import Trajectory

    still = BodyMotion(Trajectory(np.linspace(0, 60, 61), np.tile(np.eye(4), (61, 1, 1))))
    times = np.arange(60_000) / 1000
    made = simulate_imu(still, times, 1000.0, np.array([0, 0, 1.0]), NOISE, np.random.default_rng(0), GRAVITY)
    white = made.gyro - made.gyro_bias
    assert white.std() == pytest.approx(NOISE.gyro * np.sqrt(1000), rel=0.02)
    steps = np.diff(made.accel_bias, axis=0)
    assert steps.std() == pytest.approx(NOISE.accel_walk / np.sqrt(1000), rel=0.02)
    assert (made.accel - made.accel_bias).mean(axis=0) == pytest.approx([0, 0, GRAVITY], abs=2e-3)


def test_pictures_without_a_partner_are_left_out() -> None:
    first = np.array([0.0, 0.1, 0.2, 0.3])
    second = np.array([0.001, 0.1, 0.25, 0.301, 0.4])
    np.testing.assert_array_equal(paired(first, second), [[0, 0], [1, 1], [3, 3]])
    assert paired(first, np.zeros(0)).shape == (0, 2)


def test_a_calibration_of_ones_own(root: Path, tmp_path: Path) -> None:
    calibration = published_calibration()
    chain = {
        f"cam{k}": {
            "camera_model": "pinhole",
            "distortion_model": "equidistant",
            "intrinsics": [c.fx, c.fy, c.cx - 0.5, c.cy - 0.5],  # type: ignore[attr-defined]
            "distortion_coeffs": list(c.k),  # type: ignore[attr-defined]
            "resolution": [c.width, c.height],
            "T_cam_imu": calibration.T_cam_imu[k].tolist(),
            "timeshift_cam_imu": calibration.time_offset_s,
        }
        for k, c in enumerate(calibration.cameras)
    }
    path = tmp_path / "chain.yaml"
    path.write_text(yaml.safe_dump(chain))
    found = chain_calibration(path)
    np.testing.assert_allclose(found.T_imu_rig, calibration.T_imu_rig, atol=1e-9)
    assert found.time_offset_s == pytest.approx(calibration.time_offset_s)
    rays = found.cameras[0].rays()
    np.testing.assert_allclose(rays, calibration.cameras[0].rays(), atol=1e-6, equal_nan=True)
    del chain["cam1"]["T_cam_imu"]
    path.write_text(yaml.safe_dump(chain))
    with pytest.raises(CalibrationError, match="cam1 has no T_cam_imu"):
        chain_calibration(path)


def test_what_is_not_a_run(root: Path, tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no run here"):
        open_sequence("hilti-360", None, tmp_path)
    with pytest.raises(UsageError, match="must be even"):
        opened(root, 127)
    shutil.copytree(root, tmp_path / "copy")
    bag = next((tmp_path / "copy").rglob("rosbag.db3"))
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size // 2])
    with pytest.raises(DatasetError, match="truncated or damaged"):
        opened(tmp_path / "copy")


def test_bad_options_of_the_synthesiser(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, message in ((["--run", "walk"], "floor_X"), (["--room", "romm"], "room"), (["--rate", "0"], "--rate")):
        assert command(["synth", "hilti-360", "--out", str(tmp_path / "x"), "--quiet", *words]) == 2
        assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_a_run_is_not_overwritten_and_says_how_it_was_made(root: Path) -> None:
    with pytest.raises(UsageError, match="exists already"):
        write_hilti_run(root, CLEAN)
    facts = json.loads((find_runs(root)[NAME] / "truth.json").read_text())
    assert facts["options"]["walk"]["seconds"] == 7.0
    assert len(facts["gyro_bias"]) == len(facts["bias_times"]) >= 7
