"""Projects of COLMAP and nerfstudio as sequences whose truth has no scale."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from panobench.cameras.calibration import write_calibration
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.files.trajectory_io import rows_from_poses
from panobench.datasets.open import open_sequence
from panobench.errors import DatasetError
from panobench.geometry import invert_pose
from panobench.testing import TinySequence

N = 4
TRUTH = TinySequence(n=N).groundtruth
assert TRUTH is not None
T_WC = TRUTH.T_wc


def images(folder: Path, count: int = N, size: tuple[int, int] = (64, 32)) -> None:
    folder.mkdir(parents=True)
    for i in range(count):
        cv2.imwrite(str(folder / f"f{i}.png"), np.full((size[1], size[0], 3), i, np.uint8))


def images_txt(path: Path, names: list[str], cameras: list[int] | None = None) -> None:
    rows = rows_from_poses(invert_pose(T_WC))
    lines = []
    for i, name in enumerate(names):
        x, y, z, qx, qy, qz, qw = (float(v) for v in rows[i])
        lines += [f"{i + 1} {qw} {qx} {qy} {qz} {x} {y} {z} {cameras[i] if cameras else 1} {name}", ""]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("model", ["sparse/0", "sparse", "."])
def test_a_colmap_project(tmp_path: Path, model: str) -> None:
    images(tmp_path / "images", N + 2)  # two were not registered
    (tmp_path / model).mkdir(parents=True, exist_ok=True)
    write_calibration(ErpCamera(64, 32), tmp_path / model / "cameras.txt", "colmap")
    images_txt(tmp_path / model / "images.txt", ["f3.png", "f0.png", "f1.png", "f5.png"])
    sequence = open_sequence("colmap", None, tmp_path)
    assert sequence.camera == ErpCamera(64, 32)
    assert (len(sequence), sequence.groundtruth_scaled) == (6, False)
    truth = sequence.groundtruth
    assert truth is not None
    assert np.isin(sequence.times, truth.times).tolist() == [True, True, False, True, False, True]
    assert truth.T_wc == pytest.approx(T_WC[[1, 2, 0, 3]])
    if model == "sparse/0":  # the model's own folder will do
        assert len(open_sequence("colmap", None, tmp_path / model)) == 6


def test_a_model_of_several_cameras(tmp_path: Path) -> None:
    images(tmp_path / "images" / "a", 2)
    images(tmp_path / "images" / "b", 2)
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 32 40 40 32 16\n2 PINHOLE 64 32 50 50 32 16\n")
    images_txt(tmp_path / "images.txt", ["a/f0.png", "b/f0.png", "b/f1.png"], [1, 2, 2])
    sequence = open_sequence("colmap", None, tmp_path)
    assert sequence.camera == PinholeCamera(64, 32, 50, 50, 32, 16)
    assert len(sequence) == 2
    assert "of the model's cameras number 2 is taken: it has 2 of 3 images" in sequence.remarks()
    # one camera for each image, as COLMAP makes them, is one camera
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 32 40 40 32 16\n2 PINHOLE 64 32 40 40 32 16\n")
    assert len(open_sequence("colmap", None, tmp_path)) == 4


def test_cameras_calibrated_image_by_image_are_one(tmp_path: Path) -> None:
    images(tmp_path / "images")
    focal = [40.0, 40.3, 40.1, 39.9]
    rows = [f"{i + 1} PINHOLE 64 32 {f} {f} 32 16" for i, f in enumerate(focal)]
    (tmp_path / "cameras.txt").write_text("\n".join([*rows, "9 PINHOLE 64 32 90 90 32 16\n"]))  # of no image
    images_txt(tmp_path / "images.txt", [f"f{i}.png" for i in range(4)], [1, 2, 3, 4])
    sequence = open_sequence("colmap", None, tmp_path)
    assert isinstance(sequence.camera, PinholeCamera)
    assert sequence.camera.fx in (40.0, 40.1)
    assert sequence.groundtruth is not None
    assert len(sequence.groundtruth) == 4
    said = [line for line in sequence.remarks() if "cameras of their own" in line]
    assert len(said) == 1
    assert "the middle one is taken for all" in said[0]
    frames = {"fl_x": 0, "fl_y": 40.0, "cx": 32.0, "cy": 16.0, "w": 64, "h": 32}
    names = [f"images/f{i}.png" for i in range(4)]
    path = tmp_path / "transforms.json"
    transforms(path, names, camera_model="OPENCV")
    values = json.loads(path.read_text())
    values["frames"] = [{**frame, **frames, "fl_x": f} for frame, f in zip(values["frames"], focal)]
    path.write_text(json.dumps(values))
    sequence = open_sequence("nerfstudio", None, tmp_path)
    assert isinstance(sequence.camera, PinholeCamera)
    assert sequence.camera.fx in (40.0, 40.1)
    assert any(line.startswith("images have cameras of their own") for line in sequence.remarks())


def transforms(path: Path, names: list[str], **more: object) -> None:
    frames = [{"file_path": n, "transform_matrix": (T @ np.diag([1, -1, -1, 1])).tolist()} for n, T in zip(names, T_WC)]
    path.write_text(json.dumps({"frames": frames, **more}))


def test_a_nerfstudio_project(tmp_path: Path) -> None:
    images(tmp_path / "images")
    names = [f"images/f{i}.png" for i in (2, 0, 1, 3)]
    transforms(tmp_path / "transforms.json", names, camera_model="EQUIRECTANGULAR", w=64, h=32)
    for root in (tmp_path, tmp_path / "transforms.json"):
        sequence = open_sequence("nerfstudio", None, root)
        assert (sequence.camera, sequence.groundtruth_scaled) == (ErpCamera(64, 32), False)
        assert [sequence.frame_name(i) for i in range(4)] == ["f0.png", "f1.png", "f2.png", "f3.png"]
        assert sequence.groundtruth is not None
        assert sequence.groundtruth.T_wc == pytest.approx(T_WC[[1, 2, 0, 3]])


def test_blenders_transforms_have_neither_endings_nor_a_size(tmp_path: Path) -> None:
    images(tmp_path / "train")
    transforms(tmp_path / "transforms_train.json", [f"./train/f{i}" for i in range(4)], camera_angle_x=np.pi / 2)
    camera = open_sequence("nerfstudio", None, tmp_path).camera
    assert isinstance(camera, PinholeCamera)
    assert (camera.width, camera.height, camera.fx) == (64, 32, pytest.approx(32))


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"no transforms.json here"):
        open_sequence("nerfstudio", None, tmp_path)
    with pytest.raises(DatasetError, match="no COLMAP model here"):
        open_sequence("colmap", None, tmp_path)
    transforms(tmp_path / "transforms.json", ["images/f0.png"], w=64, h=32, fl_x=30)
    with pytest.raises(DatasetError, match=r"the image 'images/f0.png' is missing, and so are all others"):
        open_sequence("nerfstudio", None, tmp_path)
    images(tmp_path / "images", 2)
    names = ["images/f0.png", "images/f1.png", "images/f9.png", "../../etc/passwd"]
    transforms(tmp_path / "transforms.json", names, w=64, h=32, fl_x=30)
    remarks = open_sequence("nerfstudio", None, tmp_path).remarks()
    assert "2 of 4 images are missing, 'images/f9.png' first" in remarks
    write_calibration(ErpCamera(64, 32), tmp_path / "cameras.txt", "colmap")
    images_txt(tmp_path / "images.txt", ["other.png"])
    with pytest.raises(DatasetError, match=r"the image 'other.png' of the model is missing; images/ beside the model"):
        open_sequence("colmap", None, tmp_path)
