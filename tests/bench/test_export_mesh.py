"""The surface of a map, and films of it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import numpy as np
import pytest
from plyfile import PlyData

from panobench.bench.export import FORMATS, ExportOptions
from panobench.bench.export.movie import flight
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import UsageError
from panobench.geometry import fibonacci_sphere, make_pose, so3_exp
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.types import Trajectory

RADIUS = 1.5


@pytest.fixture(scope="module")
def run() -> Any:
    """A stored run in a hollow sphere, red above and blue below, with a far shell around it."""
    rays = fibonacci_sphere(6000)
    far = fibonacci_sphere(20)
    means = np.concatenate([RADIUS * rays, 400.0 * far])
    z = np.array([0.0, 0.0, 1.0])
    half = np.concatenate([rays, far]) + z
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    quats = np.concatenate([np.zeros((len(half), 1)), half], axis=1)  # half a turn about the mean takes z to the ray
    scales = np.log(np.tile([0.05, 0.05, 0.002], (len(means), 1)))
    colours = np.where(means[:, 1:2] < 0, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    gaussians = GaussianMap(
        *(np.asarray(a, np.float32) for a in (means, scales, quats, np.full(len(means), 4.0), colours))
    )
    t = np.linspace(0, 1, 7)
    positions = np.stack([0.4 * np.sin(3 * t), 0.1 * t, 0.3 * np.cos(3 * t)], axis=1)
    T_wc = make_pose(so3_exp(np.stack([0 * t, t, 0 * t], axis=1)), positions)
    return SimpleNamespace(map=gaussians, folder=Path("run"), trajectory=Trajectory(t, T_wc))


def test_the_mesh_lies_on_the_surface_and_faces_the_camera(run: Any, tmp_path: Path) -> None:
    pytest.importorskip("skimage")
    FORMATS["mesh"].write(run, tmp_path / "m.ply", ExportOptions(images=False, voxel=0.04))
    document = PlyData.read(tmp_path / "m.ply")
    vertex = document["vertex"]
    points = np.stack([vertex[n] for n in "xyz"], axis=1).astype(float)
    faces = np.stack(document["face"]["vertex_indices"])
    radii = np.linalg.norm(points, axis=1)
    assert np.abs(radii - RADIUS).mean() < 0.01
    assert np.abs(radii - RADIUS).max() < 0.06
    a, b, c = (points[faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1).sum() / 2
    assert area == pytest.approx(4 * np.pi * RADIUS**2, rel=0.03), "closed, and nothing besides"
    inwards = (normals * -a).sum(axis=1) > 0
    assert inwards.mean() > 0.99
    red, blue = vertex["red"].astype(int), vertex["blue"].astype(int)
    above = points[:, 1] < -0.2
    assert (red > blue)[above].mean() > 0.99
    assert (blue > red)[points[:, 1] > 0.2].mean() > 0.99


def test_the_frames_of_a_panorama_are_asked_where_they_can_be_read(
    run: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("skimage")
    camera, asked, widths = ErpCamera(128, 64), [], []
    renderer = Renderer(camera)

    def image(index: int) -> np.ndarray:
        asked.append(index)
        colour = renderer.forward(run.map, run.trajectory.T_wc[index]).colour
        return np.rint(255 * np.clip(np.nan_to_num(colour), 0, 1)).astype(np.uint8)

    def opened(run: Any, width: int | None) -> SimpleNamespace:
        widths.append(width)
        return SimpleNamespace(camera=camera, image=image)

    monkeypatch.setattr("panobench.bench.export.frames.frames_of", opened)
    stored = SimpleNamespace(**vars(run), camera=camera, frames={"time": run.trajectory.times})
    FORMATS["mesh"].write(stored, tmp_path / "m.ply", ExportOptions(voxel=0.04, width=128))
    assert asked == list(range(7))
    assert widths == [128]
    vertex = PlyData.read(tmp_path / "m.ply")["vertex"]
    radii = np.linalg.norm(np.stack([vertex[n] for n in "xyz"], axis=1), axis=1)
    assert len(radii) > 1000
    assert np.median(np.abs(radii - RADIUS)) < 0.02


def test_voxels_that_make_no_mesh_are_refused(run: Any, tmp_path: Path) -> None:
    pytest.importorskip("skimage")
    for voxel in (1e-4, 0.0, float("nan")):
        with pytest.raises(UsageError, match="voxel"):
            FORMATS["mesh"].write(run, tmp_path / "m.ply", ExportOptions(images=False, voxel=voxel))


@pytest.mark.parametrize(
    ("camera", "made"), [("erp", ErpCamera(128, 64)), ("pinhole:90", PinholeCamera.from_fov(128, 90, 58.7155))]
)
def test_a_film_shows_the_map_along_the_path(camera: str, made: Any, run: Any, tmp_path: Path) -> None:
    options = ExportOptions(camera=camera, width=128, seconds=0.5)
    FORMATS["mp4"].write(run, tmp_path / "a.mp4", options)
    with av.open(tmp_path / "a.mp4") as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        assert container.streams.video[0].average_rate == 24
    assert len(frames) == 12
    assert frames[0].shape == (made.height, made.width, 3)
    renderer = Renderer(made, "pinhole" if made.kind == "pinhole" else "sphere")
    for k, pose in ((0, flight(run.trajectory.T_wc, 12)[0]), (11, flight(run.trajectory.T_wc, 12)[-1])):
        expected = 255 * np.clip(renderer.forward(run.map, pose).colour, 0, 1)
        assert np.abs(frames[k].astype(float) - expected).mean() < 12, "but for the codec"


@pytest.mark.parametrize(
    "options", [{"camera": "fisheye"}, {"camera": "pinhole:170"}, {"seconds": 0}, {"seconds": 1e9}]
)
def test_films_that_cannot_be_made_are_refused(options: dict[str, Any], run: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        FORMATS["mp4"].write(run, tmp_path / "a.mp4", ExportOptions(**options))


def test_the_flight_follows_the_path_at_constant_speed() -> None:
    t = np.concatenate([np.linspace(0, 0.2, 50), np.linspace(0.2, 1, 10)])  # slow, then fast
    T_wc = make_pose(so3_exp(np.stack([0 * t, 2 * t, 0 * t], axis=1)), np.stack([t, 0 * t, t**2], axis=1))
    made = flight(T_wc, 100)
    steps = np.linalg.norm(np.diff(made[:, :3, 3], axis=0), axis=1)[10:-10]
    assert steps.max() < 1.6 * steps.min()
    assert np.abs(made[50, 2, 3] - made[50, 0, 3] ** 2) < 0.02
    assert np.allclose(np.linalg.det(made[:, :3, :3]), 1.0)
    assert np.abs(flight(T_wc[:1], 5) - T_wc[0]).max() == 0
