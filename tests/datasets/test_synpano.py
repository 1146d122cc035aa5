from __future__ import annotations

import os
import struct
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import panorama, poses, save, synpano_scene

from panobench.datasets.formats.synpano import SynPano, raw_to_camera_axes
from panobench.datasets.open import open_sequence
from panobench.errors import DatasetError, UnknownNameError, UsageError


@pytest.mark.parametrize("header", [True, False])
def test_reads_images_times_and_poses(tmp_path: Path, header: bool) -> None:
    true = synpano_scene(tmp_path / "room", header=header)
    sequence = SynPano(tmp_path).open("room")
    assert len(sequence) == 4
    np.testing.assert_array_equal(sequence.image(2), panorama(2))
    np.testing.assert_allclose(sequence.times, np.arange(4) / 15)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.T_wc, true, atol=1e-8)
    np.testing.assert_array_equal(sequence.groundtruth.times, sequence.times)


def test_blender_camera_looks_along_minus_z_with_y_up() -> None:
    T = raw_to_camera_axes(np.eye(4))
    np.testing.assert_array_equal(T[:3, 2], [0, 0, -1])  # forward
    np.testing.assert_array_equal(T[:3, 1], [0, -1, 0])  # down
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_root_may_be_the_scene_itself_and_width_is_applied(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room")
    sequence = open_sequence("synpano", None, tmp_path / "room", 32)
    assert sequence.name == "room"
    assert (sequence.camera.width, sequence.camera.height) == (32, 16)
    expected = panorama(1).reshape(16, 2, 32, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(sequence.image(1), expected, atol=1)  # the area filter: the mean of 2x2 pixels


def test_depth_png_is_millimetres_npy_is_metres_and_zero_is_unknown(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room")
    png = np.full((32, 64), 1500, np.uint16)
    png[3, 4] = 0
    save(tmp_path / "room/depth/000000.png", png)
    np.save(tmp_path / "room/depth/000002.npy", np.full((16, 32), 2.5, np.float32))
    sequence = SynPano(tmp_path).open()
    depth = sequence.depth(0)
    assert depth is not None
    assert depth.dtype == np.float32
    assert depth[0, 0] == pytest.approx(1.5)
    assert np.isnan(depth[3, 4])
    assert np.isnan(depth).sum() == 1
    assert sequence.depth(1) is None
    upsampled = sequence.depth(2)
    assert upsampled is not None
    np.testing.assert_allclose(upsampled, np.full((32, 64), 2.5), rtol=1e-6)


def test_novel_views_have_poses_and_follow_the_width(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room")
    synpano_scene(tmp_path / "extra", 2)
    (tmp_path / "extra/images").rename(tmp_path / "room/novel")
    (tmp_path / "extra/groundtruth.txt").rename(tmp_path / "room/novel_groundtruth.txt")
    views = SynPano(tmp_path / "room").open(width=32).novel_views()
    assert [v.name for v in views] == ["000000", "000001"]
    assert views[1].image.shape == (16, 32, 3)
    np.testing.assert_allclose(views[1].T_wc, poses(2)[1], atol=1e-8)


def test_provenance_changes_with_a_single_pixel(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room")
    before = SynPano(tmp_path).open().provenance()
    image = panorama(3)
    image[0, 0, 0] ^= 1
    save(tmp_path / "room/images/000003.png", image)
    after = SynPano(tmp_path).open().provenance()
    assert before["sha256"] != after["sha256"]
    assert before["files"] == 5


def damage_row(folder: Path, line: int, text: str) -> None:
    path = folder / "groundtruth.txt"
    rows = path.read_text().splitlines()
    rows[line - 1] = text
    path.write_text("\n".join(rows))


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1 000001.png 0 0 zero 0 0 0 1", "'zero' is not a number"),
        ("1 000001.png 0 0 nan 0 0 0 1", "'nan' is not a finite number"),
        ("1 000001.png 0 0 0 0 0 1", "8 values, expected 9"),
        ("1 000001.png 0 0 0 0 0 0 0", "norm 0"),
        ("0 000001.png 0 0 0 0 0 0 1", "not later than the one before"),
        ("nan 000001.png 0 0 0 0 0 0 1", "not a finite number"),
        ("1 gone.png 0 0 0 0 0 0 1", "image 'gone.png' is missing"),
        ("1 ../000001.png 0 0 0 0 0 0 1", "not a plain file name"),
    ],
)
def test_a_bad_row_is_named_with_file_and_line(tmp_path: Path, row: str, message: str) -> None:
    synpano_scene(tmp_path / "room")
    damage_row(tmp_path / "room", 3, row)
    with pytest.raises(DatasetError, match=r"groundtruth\.txt:3: ") as caught:
        SynPano(tmp_path).open()
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_image_of_another_size_is_found_before_the_run(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room")
    save(tmp_path / "room/images/000002.png", panorama(2, (32, 16)))
    with pytest.raises(DatasetError, match=r"000002\.png, frame 2: the image is 32x16 pixels, the camera is 64x32"):
        SynPano(tmp_path).open()


def test_a_panorama_that_is_not_twice_as_wide_as_high(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room")
    save(tmp_path / "room/images/000000.png", panorama(0, (60, 32)))
    with pytest.raises(DatasetError, match=r"000000\.png: the image is 60x32.*twice as wide"):
        SynPano(tmp_path).open()


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_truncated_image_is_named(tmp_path: Path, suffix: str) -> None:
    synpano_scene(tmp_path / "room", suffix=suffix)
    path = tmp_path / f"room/images/000002{suffix}"
    path.write_bytes(path.read_bytes()[:-60])
    sequence = SynPano(tmp_path).open()
    sequence.image(1)
    with pytest.raises(DatasetError, match=rf"000002\{suffix}, frame 2: .*truncated"):
        sequence.image(2)


def test_a_header_that_promises_a_huge_image_is_refused_before_decoding(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room")
    path = tmp_path / "room/images/000000.png"
    data = bytearray(path.read_bytes())
    data[16:24] = struct.pack(">II", 60000, 30000)
    path.write_bytes(bytes(data))
    with pytest.raises(DatasetError, match="claims 60000x30000 pixels"):
        SynPano(tmp_path).open()


def test_empty_and_absent_scenes(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="no synpano scene here"):
        SynPano(tmp_path).open()
    (tmp_path / "room/images").mkdir(parents=True)
    with pytest.raises(DatasetError, match="empty"):
        SynPano(tmp_path).open()
    (tmp_path / "room/groundtruth.txt").write_text("frame_id image_name x y z qx qy qz qw\n")
    with pytest.raises(DatasetError, match="has no pose"):
        SynPano(tmp_path).open()


def test_unknown_sequence_and_impossible_width(tmp_path: Path) -> None:
    synpano_scene(tmp_path / "room1")
    with pytest.raises(UnknownNameError, match="did you mean 'room1'"):
        SynPano(tmp_path).open("rom1")
    with pytest.raises(UsageError, match="--width 33"):
        open_sequence("synpano", None, tmp_path, 33)
    with pytest.raises(UsageError, match="between 16 and"):
        open_sequence("synpano", None, tmp_path, 2)


@pytest.mark.data
def test_devroom() -> None:
    data = os.environ.get("PANOBENCH_TEST_DATA")
    if not data or not Path(data, "synpano/devroom").is_dir():
        pytest.skip("PANOBENCH_TEST_DATA has no synpano/devroom")
    sequence = open_sequence("synpano", "devroom", Path(data) / "synpano", 512)
    assert len(sequence) == 120
    assert sequence.groundtruth is not None
    assert sequence.groundtruth.path_length() == pytest.approx(4.40, abs=0.01)
    depths = [i for i in range(120) if sequence.depth(i) is not None]
    assert depths == list(range(0, 120, 10))
    # With poses and axes right, a point seen in frame 0 is seen in frame 10 at its own depth.
    d0, d10 = sequence.depth(0), sequence.depth(10)
    assert d0 is not None
    assert d10 is not None
    world = sequence.camera.rays() * d0[..., None] @ sequence.groundtruth.T_wc[0, :3, :3].T
    world += sequence.groundtruth.positions[0]
    local = (world - sequence.groundtruth.positions[10]) @ sequence.groundtruth.T_wc[10, :3, :3]
    pixels, _ = sequence.camera.project(local)
    u, v = np.floor(pixels).astype(int).reshape(-1, 2).T
    error = np.abs(np.linalg.norm(local, axis=-1).ravel() - d10[v, u]) / d10[v, u]
    assert np.nanmedian(error) < 0.003
