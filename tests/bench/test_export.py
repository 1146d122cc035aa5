"""What is written for other programs reads back as what was stored."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import panobench
from panobench.bench.export import FORMATS, ExportOptions, export_run
from panobench.bench.export.frames import frames_of
from panobench.cameras.calibration import colmap, nerfstudio
from panobench.cameras.calibration.result import ReadOptions
from panobench.cli.main import run as command
from panobench.datasets.files.images import read_image
from panobench.datasets.files.trajectory_io import read_kitti, read_tum
from panobench.errors import OutputError, UnknownNameError, UsageError
from panobench.geometry import matrix_from_quaternion
from panobench.splat.ply import write_ply

TINY = {"dataset": "rooms", "sequence": "tiny", "width": 64, "max_frames": 4}


@pytest.fixture(scope="module", params=["erp", "pinhole"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> panobench.Run:
    """A stored run with a map of three Gaussians, one of them transparent."""
    folder = tmp_path_factory.mktemp("runs") / "one"
    settings = {"passes": 1, "seeds": 1, "sweep_views": 1}
    made = panobench.run(folder, method="reconstruct", camera=request.param, settings=settings, **TINY)
    means = np.array([[0.0, 0.0, 2.0], [1.0, 0.5, 3.0], [9.0, 9.0, 9.0]])
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    colours = np.array([[1.0, 0.0, 0.0], [0.0, 0.5, 1.0], [1.0, 1.0, 1.0]])
    write_ply(folder / "map.ply", means, np.full((3, 3), -3.0), quats, np.array([4.0, 4.0, -4.0]), colours)
    return panobench.Run(made.folder)


def test_trajectories_read_back(run: panobench.Run, tmp_path: Path) -> None:
    tum = read_tum(export_run(run, "tum", tmp_path / "a.txt"))
    kitti = read_kitti(export_run(run, "kitti", tmp_path / "b.txt"), run.trajectory.times)
    for found in (tum, kitti):
        assert np.abs(found.T_wc - run.trajectory.T_wc).max() < 1e-9
    times = np.loadtxt(tmp_path / "b.times.txt")
    assert np.abs(times - run.trajectory.times).max() < 1e-8


def test_points_are_the_opaque_gaussians(run: panobench.Run, tmp_path: Path) -> None:
    path = export_run(run, "ply-points", tmp_path / "p.ply")
    header, data = path.read_bytes().split(b"end_header\n")
    assert b"element vertex 2\n" in header
    table = np.frombuffer(data, dtype=[("xyz", "<f4", 3), ("rgb", "u1", 3)])
    assert table["xyz"].tolist() == [[0.0, 0.0, 2.0], [1.0, 0.5, 3.0]]
    assert table["rgb"].tolist() == [[255, 0, 0], [0, 128, 255]]


def test_a_colmap_model_reads_back(run: panobench.Run, tmp_path: Path) -> None:
    folder = export_run(run, "colmap", tmp_path / "m")
    assert len(list((folder / "images").iterdir())) == 4
    camera = colmap.read(folder / "sparse" / "0" / "cameras.txt", ReadOptions()).camera
    assert camera.to_dict() == run.camera.to_dict()
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    assert (model.num_images(), model.num_points3D()) == (4, 2)
    images = sorted(model.images.values(), key=lambda image: image.name)
    for image, T_wc in zip(images, run.trajectory.T_wc):
        T_cw = np.eye(4)
        T_cw[:3] = image.cam_from_world().matrix()
        assert np.abs(T_cw @ T_wc - np.eye(4)).max() < 1e-9
        point = np.array([0.3, -0.2, 1.5])  # in front of the camera, in its axes
        assert np.abs(image.camera.img_from_cam(point) - run.camera.project(point[None])[0][0]).max() < 1e-3


def test_frames_are_read_again_at_the_width_that_is_asked_for(run: panobench.Run) -> None:
    assert [frames_of(run, width).image(3).shape[1] for width in (None, 96)] == [run.camera.width, 96]
    assert len(frames_of(run, 96)) == 4


def test_a_nerfstudio_model_reads_back(run: panobench.Run, tmp_path: Path) -> None:
    folder = export_run(run, "nerfstudio", tmp_path / "n")
    path = folder / "transforms.json"
    assert nerfstudio.read(path, ReadOptions()).camera.to_dict() == run.camera.to_dict()
    frames = json.loads(path.read_text())["frames"]
    assert all((folder / frame["file_path"]).is_file() for frame in frames)
    for frame, T_wc in zip(frames, run.trajectory.T_wc):
        M = np.array(frame["transform_matrix"])
        assert np.abs(M[:3, 2] + T_wc[:3, 2]).max() < 1e-12, "OpenGL's camera looks along -z"
        assert np.abs(M[:3, 3] - T_wc[:3, 3]).max() < 1e-12


def test_faces_of_panoramas_are_pinhole_pictures_of_what_the_panorama_shows(run: panobench.Run, tmp_path: Path) -> None:
    if run.camera.kind != "erp":
        with pytest.raises(UsageError, match="for panoramas"):
            export_run(run, "colmap", tmp_path / "m", ExportOptions(faces=True))
        return
    folder = export_run(run, "colmap", tmp_path / "m", ExportOptions(faces=True, width=32))
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    assert (model.num_images(), model.num_cameras()) == (6 * 4, 1)
    rig = json.loads((folder / "rig_config.json").read_text())[0]["cameras"]
    rotations = {c["image_prefix"]: c.get("cam_from_rig_rotation", [1, 0, 0, 0]) for c in rig}
    panorama = read_image(export_run(run, "colmap", tmp_path / "p") / "images" / "000000.png")
    fronts = {i.name: i for i in model.images.values()}
    worst = []
    for image in model.images.values():
        face, _, name = image.name.partition("/")
        T_cw = np.eye(4)
        T_cw[:3] = image.cam_from_world().matrix()
        front = np.eye(4)
        front[:3] = fronts[f"front/{name}"].cam_from_world().matrix()
        assert np.abs(T_cw @ np.linalg.inv(front) - _pose_of(rotations[face + "/"])).max() < 1e-9, "the rig"
        for point in np.random.default_rng(1).normal(size=(200, 3)):
            there = T_cw[:3, :3] @ point + T_cw[:3, 3]
            if there[2] <= 0.05 or abs(there[:2] / there[2]).max() > 0.99:
                continue
            pixel = image.camera.img_from_cam(there)
            where = np.linalg.inv(run.trajectory.T_wc[int(name[:6])])
            seen, _ = run.camera.project((where[:3, :3] @ point + where[:3, 3])[None])
            ray = T_cw[:3, :3] @ run.trajectory.T_wc[int(name[:6]), :3, :3] @ run.camera.unproject(seen)[0]
            worst.append(np.abs(image.camera.img_from_cam(ray) - pixel).max())
        if name == "000000.png":
            picture = read_image(folder / "images" / image.name)
            middle = image.camera.cam_from_img(np.array([16.0, 16.0]))
            ray = run.trajectory.T_wc[0, :3, :3].T @ T_cw[:3, :3].T @ np.array([*middle, 1.0])
            u, v = run.camera.project(ray[None])[0][0]
            rows, columns = (slice(max(int(w) - 1, 0), int(w) + 2) for w in (v, u))
            near = panorama[rows, columns].reshape(-1, 3).mean(axis=0)
            assert np.abs(picture[15:17, 15:17].reshape(-1, 3).mean(axis=0) - near).max() < 40
    assert len(worst) > 500
    assert max(worst) < 0.5
    frames = json.loads(
        (export_run(run, "nerfstudio", tmp_path / "n", ExportOptions(faces=True)) / "transforms.json").read_text()
    )
    assert len(frames["frames"]) == 24
    assert frames["w"] == frames["h"] == 20


def _pose_of(rotation: list[float]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = matrix_from_quaternion(rotation)
    return T


def test_images_can_be_left_out_and_nothing_is_overwritten(run: panobench.Run, tmp_path: Path) -> None:
    assert command(["export", str(run.folder), "--to", "colmap", "-o", str(tmp_path / "m"), "--no-images"]) == 0
    assert not (tmp_path / "m" / "images").exists()
    with pytest.raises(OutputError, match="there already"):
        export_run(run, "colmap", tmp_path / "m")
    with pytest.raises(UnknownNameError):
        export_run(run, "obj")


def test_a_run_without_a_map_says_so(run: panobench.Run, tmp_path: Path) -> None:
    bare = panobench.Run(run.folder)
    bare.__dict__["map"] = None
    with pytest.raises(UsageError, match="no map"):
        export_run(bare, "ply-points", tmp_path / "x.ply")
    for name in ("mesh", "splat", "spz", "sog", "ply-sh3", "mp4"):
        with pytest.raises(UsageError, match="no map"):
            FORMATS[name].write(bare, tmp_path / "x", ExportOptions())
