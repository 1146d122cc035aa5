from __future__ import annotations

import errno
import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from panobench.cameras.factory import parse_camera_option
from panobench.cli.main import run
from panobench.datasets.formats.synpano import SynPano
from panobench.datasets.open import open_dataset, open_sequence
from panobench.datasets.writing.converted import ConvertedSequence

sys.path.insert(0, str(Path(__file__).parents[1] / "datasets"))
from dataset_samples import save, synpano_scene, video

SIZE = (128, 64)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A scene whose colour is the viewing direction: any camera's pixel must show its own ray, turned."""
    folder = tmp_path / "data" / "room"
    synpano_scene(folder, 5)
    rays = SynPano(folder).open(width=SIZE[0]).camera.rays()
    for i in range(5):
        colours = 127.5 + 120 * rays
        save(folder / f"images/{i:06d}.png", colours.round().astype(np.uint8))
    np.save(make(folder / "depth") / "000002.npy", np.full(SIZE[::-1], 2.0, np.float32))
    return folder


def make(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def convert(*arguments: object) -> int:
    return run(["convert", *map(str, arguments), "--quiet"])


def test_pinhole_views_see_what_they_should(scene: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert convert("synpano", "--root", scene, "--to", "pinhole", "--out", out, "--width", 96) == 0
    folder = open_dataset("folder", out)
    assert folder.sequences() == ["room-front", "room-left", "room-right"]
    source = SynPano(scene).open()
    assert source.groundtruth is not None
    for name in folder.sequences():
        sequence = folder.open(name)
        assert len(sequence) == 5
        assert sequence.camera.kind == "pinhole"
        assert sequence.groundtruth is not None
        np.testing.assert_allclose(sequence.times, source.times, atol=1e-9)
        # World directions of the target's pixels, taken back to the source's axes, are the colours it must show.
        R = source.groundtruth.T_wc[3, :3, :3].T @ sequence.groundtruth.T_wc[3, :3, :3]
        expected = 127.5 + 120 * sequence.camera.rays() @ R.T
        assert np.abs(sequence.image(3).astype(float) - expected).max() < 4
        np.testing.assert_allclose(sequence.groundtruth.positions, source.groundtruth.positions, atol=1e-9)
    depth = folder.open("room-left").depth(2)
    assert depth is not None
    np.testing.assert_allclose(depth, 2.0, rtol=1e-6)
    assert folder.open("room-left").depth(1) is None
    rays = folder.open("room-front").camera.rays()
    assert np.degrees(np.arctan2(rays[0, -1, 0], rays[0, -1, 2])) == pytest.approx(60, abs=1)


@pytest.mark.parametrize("target", ["erp", "pal", "fisheye", "cubemap"])
def test_every_target_camera(scene: Path, tmp_path: Path, target: str) -> None:
    out = tmp_path / "out"
    width = {"erp": 64, "pal": 160, "fisheye": 64, "cubemap": 192}[target]
    assert convert("synpano", "--root", scene, "--to", target, "--out", out, "--width", width, "--every", 2) == 0
    sequence = open_sequence("folder", None, out)
    assert sequence.camera.kind == target
    assert sequence.camera.width == width
    assert len(sequence) == 3
    source = SynPano(scene).open()
    assert source.groundtruth is not None
    assert sequence.groundtruth is not None
    R = source.groundtruth.T_wc[4, :3, :3].T @ sequence.groundtruth.T_wc[2, :3, :3]
    valid = sequence.camera.valid_mask()
    expected = 127.5 + 120 * sequence.camera.rays()[valid] @ R.T
    assert valid.mean() > 0.4
    assert np.abs(sequence.image(2)[valid].astype(float) - expected).max() < 6


def test_novel_views_are_converted_too(scene: Path, tmp_path: Path) -> None:
    (scene / "novel").mkdir()
    shutil.copy(scene / "images/000001.png", scene / "novel/000.png")
    row = (scene / "groundtruth.txt").read_text().splitlines()[2].split()
    (scene / "novel_groundtruth.txt").write_text(" ".join(["0", "000.png", *row[2:]]))
    assert (
        convert("synpano", "--root", scene, "--to", "pinhole", "--views", "left", "--width", 64, "--out", tmp_path) == 0
    )
    sequence = open_sequence("folder", "room-left", tmp_path)
    (view,) = sequence.novel_views()
    assert sequence.groundtruth is not None
    np.testing.assert_array_equal(view.image, sequence.image(1))
    np.testing.assert_allclose(view.T_wc, sequence.groundtruth.T_wc[1], atol=1e-9)


def test_a_second_run_continues_and_a_third_has_nothing_to_do(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    arguments = ("synpano", "--root", scene, "--to", "erp", "--width", 64, "--out", out, "--workers", 1)
    real = Path.write_bytes

    def full(self: Path, data: bytes) -> int:
        if self.name == "000003.png":
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(self, data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        assert convert(*arguments) == 2
    message = capsys.readouterr().err
    assert "the disk is full" in message
    assert len(message.strip().splitlines()) == 1
    assert [p.name for p in out.iterdir()] == ["room.partial"]
    assert run(["run", "--dataset", "folder", "--root", str(out), "--method", "x"]) == 2  # no sequence there yet

    first = {p.name: p.stat().st_mtime_ns for p in (out / "room.partial/images").glob("00000[0-2].png")}
    assert len(first) == 3
    assert convert(*arguments, "--every", 2) == 2
    assert "made with other options" in capsys.readouterr().err
    assert convert(*arguments) == 0
    assert {n: (out / "room/images" / n).stat().st_mtime_ns for n in first} == first
    assert len(open_sequence("folder", None, out)) == 5
    capsys.readouterr()
    assert convert(*arguments) == 0
    assert "was finished already" in capsys.readouterr().out

    image = out / "room/images/000001.png"
    image.write_bytes(image.read_bytes()[:-1])
    assert convert(*arguments) == 2
    assert "000001.png: the file changed since it was written" in capsys.readouterr().err


def test_dry_run_writes_nothing(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert convert("synpano", "--root", scene, "--to", "pinhole", "--width", 64, "--out", out, "--dry-run") == 0
    text = capsys.readouterr().out
    assert "room-left: 5 frames, pinhole 64x21" in text
    assert "images + ground truth" in text
    assert "nothing was written" in text
    assert not out.exists()


def test_video_to_jpeg(tmp_path: Path) -> None:
    clip = video(tmp_path / "walk.mp4", 8)
    assert (
        convert("video", "--root", clip, "--to", "erp", "--width", 32, "--format", "jpg", "--out", tmp_path / "o") == 0
    )
    sequence = open_sequence("folder", "walk", tmp_path / "o")
    assert len(sequence) == 8
    assert sequence.frame_name(3) == "000003.jpg"
    # JPEG stores colour at half the resolution: near edges it differs.
    error = np.abs(sequence.image(3).astype(float) - open_sequence("video", None, clip, 32).image(3))
    assert error.mean() < 3


def test_meta_says_where_it_came_from(scene: Path, tmp_path: Path) -> None:
    assert convert("synpano", "--root", scene, "--to", "erp", "--width", 64, "--out", tmp_path / "o") == 0
    meta = json.loads((tmp_path / "o/room/meta.json").read_text())
    assert meta["source"]["dataset"] == "synpano"
    assert meta["source"]["sha256"] == SynPano(scene).open().provenance()["sha256"]
    assert meta["conversion"]["camera"] == "erp"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--to", "erpp"), "did you mean 'erp'"),
        (("--to", "erp", "--views", "front"), "--views goes with --to pinhole or fisheye"),
        (("--to", "pinhole", "--views", "frnt"), "did you mean 'front'"),
        (("--to", "pinhole", "--views", ","), "--views is empty"),
        (("--to", "pinhole", "--fov", "wide"), "120x60"),
        (("--to", "erp", "--format", "gif"), "choose one of png, jpg"),
        (("--to", "erp", "--sequence", "rom"), "did you mean 'room'"),
        (("--to", "none.yaml"), "none.yaml"),
        (("--to", "erp", "--every", "0"), "--every"),
    ],
)
def test_bad_options(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], message: str
) -> None:
    out = tmp_path / "out"
    assert convert("synpano", "--root", scene, "--out", out, *arguments) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1
    assert not out.exists()


def test_a_view_the_source_does_not_see(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert convert("synpano", "--root", scene, "--to", "pinhole", "--width", 64, "--out", tmp_path / "a") == 0
    assert (
        convert(
            *("folder", "--root", tmp_path / "a", "--sequence", "room-front"),
            *("--to", "pinhole", "--views", "back", "--fov", "60", "--out", tmp_path / "b"),
        )
        == 2
    )
    assert "sees nothing of the source" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_a_source_broken_in_the_middle_leaves_no_sequence(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = scene / "images/000003.png"
    path.write_bytes(path.read_bytes()[:-30])
    assert convert("synpano", "--root", scene, "--to", "erp", "--width", 64, "--out", tmp_path / "o") == 2
    assert "000003.png, frame 3: the PNG is truncated" in capsys.readouterr().err
    assert [p.name for p in (tmp_path / "o").iterdir()] == ["room.partial"]


def test_out_that_is_a_file(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "o").write_text("")
    assert convert("synpano", "--root", scene, "--to", "erp", "--out", tmp_path / "o" / "x") == 2
    assert "a file is in the way" in capsys.readouterr().err


@pytest.mark.data
def test_palvio_to_erp(tmp_path: Path) -> None:
    bag = Path(os.environ.get("PANOBENCH_TEST_DATA", "/nonexistent"), "palvio/ID01.bag")
    if not bag.is_file():
        pytest.skip("PANOBENCH_TEST_DATA has no palvio/ID01.bag")
    out = tmp_path / "o"
    assert convert("palvio", "--root", bag, "--to", "erp", "--width", 512, "--every", 12, "--out", out) == 0
    sequence = open_sequence("folder", "ID01", out)
    room = open_sequence("synpano", "devroom", bag.parents[1] / "synpano", 512)
    assert sequence.imu is not None
    assert sequence.imu.T_body_cam is not None
    valid = sequence.camera.valid_mask()
    for k in range(3):
        grey = room.image(12 * k).astype(float) @ [0.299, 0.587, 0.114]
        error = (sequence.image(k)[..., 0] - grey)[valid]
        assert 10 * np.log10(255**2 / np.mean(error**2)) > 32


def test_a_generator_renders_for_the_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Views of 512 pixel panoramas at 256 pixels would be enlarged 1.5 times; rendered ones have their own detail."""
    monkeypatch.setenv("PANOBENCH_CACHE", str(tmp_path / "cache"))
    out, every = tmp_path / "out", 20
    arguments = ("rooms", "--sequence", "tiny", "--to", "pinhole", "--views", "front,left", "--every", every)
    assert convert(*arguments, "--width", 160, "--fov", "60x60", "--out", out) == 0
    room = open_sequence("rooms", "tiny")
    for view in ("front", "left"):
        written = open_sequence("folder", f"tiny-{view}", out)
        choice = parse_camera_option(f"pinhole:{view}", room.camera, 160, "60x60")
        reprojected = ConvertedSequence(room, choice.camera, choice.R_target_source)
        assert written.groundtruth is not None
        assert reprojected.groundtruth is not None
        np.testing.assert_allclose(written.groundtruth.T_wc[1], reprojected.groundtruth.T_wc[every], atol=1e-9)
        sharp, soft = written.image(1).astype(float), reprojected.image(every).astype(float)
        assert np.abs(sharp - soft).mean() < 8  # the same view
        assert np.abs(np.diff(sharp, axis=1)).mean() > 1.1 * np.abs(np.diff(soft, axis=1)).mean()
        depth, expected = written.depth(1), reprojected.depth(every)
        assert depth is not None
        assert expected is not None
        assert np.nanmedian(np.abs(depth - expected)) < 0.02


def test_recordings_that_are_enlarged_are_warned_of(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert convert("synpano", "--root", scene, "--to", "pinhole", "--views", "front", "--out", tmp_path / "a") == 0
    assert "enlarged" not in capsys.readouterr().err
    wide = ("--to", "pinhole", "--views", "front", "--width", 320, "--out", tmp_path / "b")
    assert convert("synpano", "--root", scene, *wide) == 0
    said = capsys.readouterr().err
    assert "room-front: images are enlarged 4." in said
    assert "(128x64 to pinhole 320x" in said
