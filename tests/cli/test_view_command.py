from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from panobench.bench.records.map_views import MapSequence
from panobench.cameras.erp import ErpCamera
from panobench.cli.main import run
from panobench.datasets.files.images import decode_image, read_image
from panobench.datasets.files.trajectory_io import write_tum
from panobench.datasets.inspection.guess import guess
from panobench.datasets.inspection.look_around import look_around_page
from panobench.geometry import directions_from_lonlat
from panobench.splat.ply import write_ply
from panobench.types import Trajectory

sys.path.insert(0, str(Path(__file__).parents[1] / "datasets"))
from dataset_samples import panorama, save, synpano_scene, video


def view(*arguments: object) -> int:
    return run(["view", *map(str, arguments)])


def ray_coloured(width: int) -> np.ndarray:
    """A panorama whose colour is its viewing direction."""
    return (127.5 + 120 * ErpCamera(width, width // 2).rays()).round().astype(np.uint8)


def frames_of(page: Path) -> list[dict[str, str]]:
    found = re.search(r"const frames = (\[.*?\]);\n", page.read_text())
    assert found
    frames: list[dict[str, str]] = json.loads(found[1].replace("<\\/", "</"))
    return frames


def test_an_image_gives_a_sheet_and_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    image = save(tmp_path / "room.png", ray_coloured(256))
    assert view(image, "--as", "pinhole", "-o", tmp_path / "o") == 0
    assert capsys.readouterr().out.split() == [str(tmp_path / "o/room.sheet.png"), str(tmp_path / "o/room.html")]
    sheet = read_image(tmp_path / "o/room.sheet.png")
    # Four 120x60 views beside the panorama: forward has blue in its middle, left no red, right no lack of it.
    assert (np.abs(sheet.astype(int) - [127, 127, 247]).max(axis=-1) < 12).sum() > 100  # forward, z = 1
    assert (np.abs(sheet.astype(int) - [7, 127, 127]).max(axis=-1) < 12).sum() > 100  # left, x = -1
    frames = frames_of(tmp_path / "o/room.html")
    assert [f["label"] for f in frames] == ["room.png, 0.00 s"]
    jpeg = base64.b64decode(frames[0]["src"].partition(",")[2])
    assert np.abs(decode_image(jpeg, "x").astype(int) - ray_coloured(256)).mean() < 3


def test_the_page_needs_no_network(tmp_path: Path) -> None:
    text = look_around_page("<room> & co", [("a </script> b", panorama(0))])
    assert "http" not in text.replace("http-equiv", "")
    assert text.count("</script>") == 1
    assert "<title>&lt;room&gt; &amp; co</title>" in text


@pytest.mark.parametrize("kind", ["synpano", "video", "folder"])
def test_sequences_are_recognised(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "data" / "room"
    if kind == "video":
        path.parent.mkdir()
        path = video(tmp_path / "data/room.mp4", 9)
    else:
        synpano_scene(path, 9)
        if kind == "folder":
            assert run(f"convert synpano --root {path} --to erp --out {tmp_path / 'f'} -q".split()) == 0
            path = tmp_path / "f"
    assert view(path, "--frames", 3, "-o", tmp_path / "o") == 0
    frames = frames_of(tmp_path / "o/room.html")
    assert len(frames) == 3
    assert frames[0]["label"].startswith("000000")
    assert frames[-1]["label"].startswith("000008")


@pytest.mark.parametrize(
    ("file", "dataset"),
    [
        ("room1/mav0/cam0/data.csv", "tum-vi"),
        ("hall/mapping/day/camera_pose.json", "360loc"),
        ("scene/transform.json", "omniblender"),
        ("scene/Egocentric/cameras/00000_cam.json", "omniblender"),
        ("dual_fisheye.yaml", "insta360-dual-fisheye"),
    ],
)
def test_layouts_are_recognised(tmp_path: Path, file: str, dataset: str) -> None:
    root = tmp_path / "data"
    (root / file).parent.mkdir(parents=True)
    (root / file).write_text("")
    (root / "walk.mp4").write_text("")
    assert guess(root).dataset == dataset


def test_a_narrow_camera_gets_no_page(tmp_path: Path) -> None:
    image = save(tmp_path / "photo.png", panorama(0))
    assert view(image, "--camera", "pinhole:60", "-o", tmp_path / "o") == 0
    assert [p.name for p in (tmp_path / "o").iterdir()] == ["photo.sheet.png"]


def test_a_cubemap_as_a_panorama(tmp_path: Path) -> None:
    faces = np.repeat(np.arange(6, dtype=np.uint8)[None, :, None] * 40 + 20, 3, axis=2).repeat(32, 0).repeat(32, 1)
    image = save(tmp_path / "cube.png", faces.reshape(32, 192, 3))
    assert view(image, "--camera", "cubemap", "--as", "erp,pal", "-o", tmp_path / "o") == 0
    page = frames_of(tmp_path / "o/cube.html")
    erp = decode_image(base64.b64decode(page[0]["src"].partition(",")[2]), "x")
    assert abs(int(erp[erp.shape[0] // 2, erp.shape[1] // 2, 0]) - 20) < 4  # the first face is the front


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none.png",), "no such file"),
        (("photo.png",), "or with --camera what took it (erp,"),
        (("photo.png", "--camera", "pinhole"), "pinhole:90"),
        (("photo.png", "--camera", "pinhole:200"), "below 180 degrees"),
        (("photo.png", "--camera", "fish:90"), "did you mean"),
        (("photo.png", "--camera", "pal"), "the calibration is for 60x45 images, these are 60x40"),
        (("room.png", "--as", "pinhle"), "did you mean 'pinhole'"),
        (("room.png", "--as", ","), "--as is empty"),
        (("notes.md",), "nothing here that is read"),
        (("broken.png",), "truncated"),
        (("photo.png", "--camera", "pinhole:60", "--as", "pinhole:back"), "sees nothing"),
        (("walk.mp4", "--camera", "erp"), "models are for single images"),
    ],
)
def test_bad_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    save(tmp_path / "photo.png", panorama(0, (60, 40)))
    whole = save(tmp_path / "room.png", panorama(0)).read_bytes()
    (tmp_path / "broken.png").write_bytes(whole[:-40])
    (tmp_path / "notes.md").write_text("hello")
    video(tmp_path / "walk.mp4", 2)
    assert view(tmp_path / arguments[0], *arguments[1:], "-o", tmp_path / "o") == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not (tmp_path / "o").exists()


@pytest.mark.browser
@pytest.mark.parametrize(("lon", "lat"), [(179, 0), (-60, 35)])
def test_the_browser_shows_the_direction_it_says(tmp_path: Path, lon: float, lat: float) -> None:
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium")
    page = tmp_path / "p.html"
    page.write_text(look_around_page("directions", [("one", ray_coloured(1024))]))
    shot = tmp_path / "p.png"
    flags = "--headless=new --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --ignore-gpu-blocklist"
    subprocess.run(
        [chromium, *flags.split(), "--window-size=600,600", "--virtual-time-budget=3000", f"--screenshot={shot}"]
        + [f"--user-data-dir={tmp_path / 'profile'}", f"{page.as_uri()}#lon={lon}&lat={lat}&fov=60"],
        check=True,
        capture_output=True,
        timeout=120,
    )
    picture = read_image(shot)
    middle = picture[290:310, 290:310].reshape(-1, 3).mean(axis=0)
    expected = 127.5 + 120 * directions_from_lonlat(np.deg2rad(lon), np.deg2rad(lat))
    np.testing.assert_allclose(middle, expected, atol=6)


def test_a_map_is_seen_from_its_origin_and_a_run_from_its_poses(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(400, 3))
    means = 2.0 * points / np.linalg.norm(points, axis=1, keepdims=True)
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (400, 1))
    red = np.tile([1.0, 0.0, 0.0], (400, 1))
    write_ply(tmp_path / "shell.ply", means, np.full((400, 3), -1.5), quats, np.full(400, 4.0), red)
    assert view(tmp_path / "shell.ply", "--out", tmp_path) == 0
    assert (tmp_path / "shell.html").is_file()
    sheet = read_image(tmp_path / "shell.sheet.png")
    assert sheet[..., 0].mean() > 1.3 * sheet[..., 1].mean()
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.json").write_text("{}")
    assert view(folder, "--out", tmp_path) == 2
    (tmp_path / "shell.ply").rename(folder / "map.ply")
    T_wc = np.tile(np.eye(4), (3, 1, 1))
    write_tum(folder / "trajectory.tum", Trajectory(np.arange(3.0), T_wc))
    assert len(MapSequence(folder)) == 3
