"""`panobench probe`, and `panobench run --root` without a dataset."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import pytest

from panobench.cli.main import run as panobench
from panobench.testing import TinySequence


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six panoramas, and nothing else."""
    root = tmp_path_factory.mktemp("data") / "walk"
    root.mkdir()
    sequence = TinySequence(n=6)
    for i in range(6):
        cv2.imwrite(str(root / f"{i}.png"), sequence.image(i)[..., ::-1])
    return root


def test_probing_a_camera_of_a_file_and_a_lens_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lens = "camera_model: pinhole\n  distortion_model: radtan\n  distortion_coeffs: [0, 0, 0, 0]\n"
    sizes = ("[640, 480]", "[320, 240]")
    chain = [f"cam{i}:\n  {lens}  intrinsics: [300, 300, 160, 120]\n  resolution: {sizes[i]}\n" for i in (0, 1)]
    (tmp_path / "chain.yaml").write_text("".join(chain))
    assert panobench(["probe", f"{tmp_path}/chain.yaml#cam1"]) == 0
    assert "(kalibr): pinhole 320x240" in capsys.readouterr().out
    values = {"camera_model": "OPENCV", "w": 640, "h": 480, "fl_x": 300, "fl_y": 300, "cx": 320, "cy": 240}
    (tmp_path / "transforms.json").write_text(json.dumps({**values, "frames": []}))
    assert panobench(["probe", str(tmp_path / "transforms.json")]) == 0
    assert "(nerfstudio): pinhole 640x480" in capsys.readouterr().out


@pytest.mark.usefixtures("fake_plugin")
def test_a_root_alone_is_enough(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "--method", "fake-still", "--root", str(folder), "--width", "128", "--check", "none"]
    code = panobench([*words, "--rate", "5", "--out", str(tmp_path / "out")])
    assert code == 0
    said = capsys.readouterr()
    assert "a folder of 6 images: --dataset images" in said.err
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (run["spec"]["dataset"], run["spec"]["sequence"], run["spec"]["rate"]) == ("images", "walk", 5.0)
    assert f"--dataset images --root {folder} --rate 5" in run["provenance"]["command"]
    rows = (tmp_path / "out" / "frames.csv").read_text().splitlines()
    assert [row.split(",")[1] for row in rows[1:3]] == ["0.000000000", "0.200000000"]
    # an import finds the same frames
    (tmp_path / "them.tum").write_text("".join(f"{i / 5} {i} 0 0 0 0 0 1\n" for i in range(6)))
    words = ["import", str(tmp_path / "them.tum"), "--root", str(folder), "--rate", "5", "--width", "128"]
    assert panobench([*words, "--out", str(tmp_path / "imported"), "--quiet"]) == 0


def test_probing_images(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["probe", str(folder), "--width", "128"]) == 0
    said = capsys.readouterr().out
    assert "a folder of 6 images (--dataset images)" in said
    assert "6, 0.5 s, 10 a second" in said
    assert "128x64 erp" in said
    assert "nothing says when the images were taken" in said
    assert said.rstrip().endswith(f"try: panobench run --method sparse --root {folder} --width 128")
    assert panobench(["probe", str(folder), "--json", "--rate", "3"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["dataset"], found["frames"], found["rate_hz"]) == ("images", 6, pytest.approx(3))
    assert {cost["method"] for cost in found["costs"]} == {"sparse", "panogs"}
    assert all(0 < cost["seconds"] < 60 for cost in found["costs"])


def test_probing_what_is_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lens.yaml").write_text("model: erp\nwidth: 64\nheight: 32\n")
    assert panobench(["probe", str(tmp_path / "lens.yaml")]) == 0
    assert "a calibration file (panobench): erp 64x32" in capsys.readouterr().out
    (tmp_path / "path.txt").write_text("0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")
    assert panobench(["probe", str(tmp_path / "path.txt")]) == 0
    assert "a trajectory (tum): 2 poses by time" in capsys.readouterr().out
    (tmp_path / "notes.md").write_text("hello")
    assert panobench(["probe", str(tmp_path / "notes.md")]) == 2
    assert "nothing here that is read" in capsys.readouterr().err
    assert panobench(["probe", str(tmp_path / "nowhere")]) == 2


def test_a_calibration_or_trajectory_with_a_mistake_is_told_what_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lens = "cam0:\n  camera_model: pinhole\n  intrinsics: [30, 30, 32, 16]\n  resolution: [64, 32]\n"
    (tmp_path / "chain.yaml").write_text(f"{lens}  distortion_model: fov\n  distortion_coeffs: [0.9]\n")
    assert panobench(["probe", str(tmp_path / "chain.yaml")]) == 2
    assert "chain.yaml:5: distortion_model 'fov' is not known here; known: radtan" in capsys.readouterr().err
    (tmp_path / "path.csv").write_text("time,x,y,z\n0,1,2,3\n1,1,2,3\n")
    assert panobench(["probe", str(tmp_path / "path.csv")]) == 2
    assert "path.csv: the header names no quaternion" in capsys.readouterr().err
    (tmp_path / "K.txt").write_text("300 0 160\n0 300 120\n0 0 1\n")
    assert panobench(["probe", str(tmp_path / "K.txt")]) == 2
    assert "K.txt:1: the row has 3 values, which no format has" in capsys.readouterr().err


def test_the_error_of_a_named_dataset_says_how_to_go_on(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for dataset in ("folder", "synpano"):
        assert panobench(["run", "--method", "sparse", "--dataset", dataset, "--root", str(folder)]) == 2
        assert "a folder of images is read without --dataset, or with --dataset images" in capsys.readouterr().err
