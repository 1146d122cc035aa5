"""stella_vslam's adapter against a stand-in with run_image_slam's command line and files."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from panobench_stella_vslam import SPEC
from panobench_stella_vslam.fbow import SIGNATURE
from panobench_stella_vslam.method import VOCABULARY, StellaVslam, StellaVslamConfig, camera_values, pixels_per_feature

from panobench import InputError, MethodContext, MethodError, UnavailableError, UnsupportedError
from panobench.external import VOCABULARY_VARIABLE
from panobench.testing import (
    FakeCamera,
    TinySequence,
    assert_conforms,
    ate_rmse,
    camera_from_dict,
    erp_camera,
    fisheye_camera,
    pinhole_camera,
    pose_rows,
    run_method,
    write_program,
)

STAND_IN = """
import os, sys
options, words = {}, sys.argv[1:]
while words:
    name = words.pop(0)
    options[name] = words.pop(0) if words and not words[0].startswith("--") else True
known = {"--vocab", "--without-vocab", "--img-dir", "--config", "--mask", "--no-sleep", "--auto-term"}
known |= {"--eval-log-dir", "--viewer", "--start-timestamp"}
assert set(options) <= known, options
assert options["--start-timestamp"] == "0" and options["--viewer"] == "none"
text = open(options["--config"]).read()
assert "setup: monocular" in text and "color_order: BGR" in text and %(expect)r in text, text
images = sorted(os.listdir(options["--img-dir"]))
if "--vocab" in options:
    open(options["--vocab"], "rb").read(1)
print("vocabulary" if "--vocab" in options else "no vocabulary", flush=True)
folder = options["--eval-log-dir"] + "/"
rows = %(rows)r
if rows:
    open(folder + "frame_trajectory.txt", "w").write(rows)
    open(folder + "keyframe_trajectory.txt", "w").write(rows.splitlines()[0] + "\\n")
open(folder + "track_times.txt", "w").write("0.01\\n" * len(images))
"""


@pytest.fixture(autouse=True)
def without_a_vocabulary(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VOCABULARY, "none")  # none is trained for these tests
    monkeypatch.delenv(VOCABULARY_VARIABLE, raising=False)


def program(path: Path, rows: str, expect: str = "model: equirectangular") -> StellaVslamConfig:
    path = write_program(path / "run_image_slam", STAND_IN % {"rows": rows, "expect": expect})
    return StellaVslamConfig(command=str(path), levels=2)


def by_rate(sequence: TinySequence, rate: float) -> str:
    """As stella_vslam saves it: frame i at i / fps, whatever the frames' times are."""
    assert sequence.groundtruth is not None
    rows = pose_rows(sequence.groundtruth)
    return "".join(f"{i / rate:.15g} " + " ".join(f"{v:.9g}" for v in row[1:]) + "\n" for i, row in enumerate(rows))


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_STELLA_VSLAM_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


def test_panoramas_go_in_and_poses_come_out(tmp_path: Path) -> None:
    sequence = TinySequence(n=6)
    run = run_method(StellaVslam(program(tmp_path, by_rate(sequence, 10.0))), sequence)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)
    assert ate_rmse(run, sequence) < 1e-6
    assert run.estimate.keyframes == [0]
    assert run.estimate.frames[3] == {"program_tracking_s": 0.01}
    assert any("loops are not closed" in line for line in run.log)


def test_uneven_times_are_matched_by_number(tmp_path: Path) -> None:
    sequence = TinySequence(n=6)
    rows = by_rate(sequence, 10.0)
    sequence.times = np.array([5.0, 5.1, 5.2, 5.31, 5.4, 5.52])
    run = run_method(StellaVslam(program(tmp_path, rows)), sequence)
    assert np.array_equal(run.estimate.trajectory.times, sequence.times)


def test_a_named_vocabulary_is_handed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = tmp_path / "orb_vocab.fbow"
    named.write_bytes(SIGNATURE + b"x")
    monkeypatch.setenv(VOCABULARY, str(named))
    sequence = TinySequence(n=3)
    method = StellaVslam(program(tmp_path, by_rate(sequence, 10.0)))
    run = run_method(method, sequence)
    assert any(line == "| vocabulary" for line in run.log)
    assert f"--vocab {named}" in run.log[0]
    assert method.files() == [tmp_path / "run_image_slam", named]  # both count for a suite's cells
    monkeypatch.setenv(VOCABULARY, str(tmp_path / "none.fbow"))
    with pytest.raises(InputError, match="no such vocabulary"):
        run_method(StellaVslam(program(tmp_path, "")), sequence)


def test_a_dbow2_vocabulary_is_converted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = tmp_path / "ORBvoc.txt"
    named.write_text("10 6 0 0\n0 1 " + "0 " * 32 + "0.5\n")
    monkeypatch.delenv(VOCABULARY)
    monkeypatch.setenv(VOCABULARY_VARIABLE, str(named))
    sequence = TinySequence(n=3)
    method = StellaVslam(program(tmp_path, by_rate(sequence, 10.0)))
    run = run_method(method, sequence)
    assert any(line == "| vocabulary" for line in run.log)
    assert "/vocabulary.fbow" in run.log[0]
    assert method.files()[1] == named


def test_the_doctor_says_what_becomes_of_loops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert StellaVslam.diagnose()[-1].detail == "none: loops are not closed"
    monkeypatch.setenv(VOCABULARY, str(tmp_path / "missing.fbow"))
    assert not StellaVslam.diagnose()[-1].ok
    monkeypatch.delenv(VOCABULARY)
    assert "one is trained" in StellaVslam.diagnose()[-1].detail


def test_a_mask_goes_along(tmp_path: Path) -> None:
    mask = np.ones((64, 128), dtype=bool)
    mask[48:] = False
    sequence = TinySequence(TinySequence().camera.with_mask(mask), n=3)
    run = run_method(StellaVslam(program(tmp_path, by_rate(sequence, 10.0))), sequence)
    assert "--mask" in run.log[1]


def test_no_map_no_file_is_lost_not_crashed(tmp_path: Path) -> None:
    assert len(run_method(StellaVslam(program(tmp_path, "")), TinySequence(n=3)).estimate.trajectory) == 0


def test_a_crash_shows_the_log(tmp_path: Path) -> None:
    path = write_program(tmp_path / "run_image_slam", "import sys; print('Invalid setup type'); sys.exit(1)")
    with pytest.raises(MethodError, match="exit code 1; the log ends: Invalid setup type"):
        run_method(StellaVslam(StellaVslamConfig(command=str(path), levels=2)), TinySequence(n=3))


def test_it_is_unavailable_without_its_program(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_STELLA_VSLAM_COMMAND", "no-such-program")
    with pytest.raises(UnavailableError, match="PANOBENCH_STELLA_VSLAM_COMMAND"):
        run_method(StellaVslam(), TinySequence(n=2))


def test_cameras_become_stellas() -> None:
    values = {"model": "pinhole", "width": 96, "height": 64, "fx": 50.0, "fy": 51.0, "cx": 48.0, "cy": 32.0}
    pinhole = yaml.safe_load(yaml.safe_dump(camera_values(camera_from_dict(values), 30.0)))
    assert pinhole["model"] == "perspective"
    assert pinhole["cx"] == 47.5
    assert pinhole["k3"] == 0.0
    assert camera_values(fisheye_camera(96, 120), 30.0)["model"] == "fisheye"
    with pytest.raises(UnsupportedError, match="no fake camera"):
        camera_values(FakeCamera(), 30.0)


def test_features_enough_for_small_images() -> None:
    assert pixels_per_feature(erp_camera(1920)) == 800
    assert pixels_per_feature(erp_camera(512)) == 57
    assert pixels_per_feature(erp_camera(3840)) == 800
    assert pixels_per_feature(pinhole_camera(640, 110, 90)) == 200
    assert pixels_per_feature(pinhole_camera(288, 120, 60)) == 20


def test_images_on_which_it_crashes_are_refused(tmp_path: Path) -> None:
    """stella_vslam ended with std::bad_alloc on views of 288x96."""
    sequence = TinySequence(pinhole_camera(288, 120, 60), n=2)
    config = dataclasses.replace(program(tmp_path, "", "model: perspective"), levels=8)
    with pytest.raises(UnsupportedError, match=r"288x96 pixels are too few for 8 .*--set levels=6$"):
        run_method(StellaVslam(config), sequence)
    assert len(run_method(StellaVslam(dataclasses.replace(config, levels=6)), sequence).estimate.trajectory) == 0


def test_a_fisheye_is_masked_where_the_program_cannot_see(tmp_path: Path) -> None:
    """With all of a 190 degree image it never started a map: it carries keypoints to the plane z = 1."""
    lens = fisheye_camera(96, 190)
    method = StellaVslam(StellaVslamConfig(levels=2))
    job = method.prepare(TinySequence(lens, n=2), MethodContext(work=tmp_path))
    assert job.arguments[job.arguments.index("--mask") + 1] == str(tmp_path / "mask.png")
    mask = cv2.imread(str(tmp_path / "mask.png"), cv2.IMREAD_GRAYSCALE)
    angle = np.rad2deg(np.arccos(np.clip(lens.rays()[..., 2], -1, 1)))
    assert mask[angle < 84].min() == 255
    assert mask[angle > 86].max() == 0
