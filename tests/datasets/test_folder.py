from __future__ import annotations

import errno
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from dataset_samples import panorama, poses, save

from panobench.cameras.erp import ErpCamera
from panobench.datasets.formats.folder import Folder
from panobench.datasets.writing import writer as writer_module
from panobench.datasets.writing.writer import SequenceWriter, write_sequence
from panobench.errors import CalibrationError, DatasetError, OutputError, UsageError
from panobench.types import Imu, NovelView, Trajectory

TIMES = np.array([0.5, 0.6, 0.75])


def frames() -> Iterator[tuple[float, np.ndarray, np.ndarray | None]]:
    for i, t in enumerate(TIMES):
        depth = np.full((32, 64), 1.0 + i, np.float32)
        depth[0, 0] = np.nan
        yield t, panorama(i), depth if i != 1 else None


def camera(masked: bool = True) -> ErpCamera:
    mask = np.ones((32, 64), bool)
    mask[-6:] = False
    return ErpCamera(64, 32, hfov_deg=300, mask=mask if masked else None)


def write(path: Path) -> Path:
    imu = Imu(np.array([0.5, 0.505]), np.array([[1, 2, 3], [4, 5, 6.0]]), np.array([[0, 0, 9.81], [0, 1, 9.8]]))
    truth = Trajectory(TIMES[:2], poses(2))
    return write_sequence(path, camera(), frames(), groundtruth=truth, imu=imu, meta={"source": "a test"})


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    write(tmp_path / "seq")
    sequence = Folder(tmp_path).open("seq")
    assert sequence.camera == camera()
    np.testing.assert_allclose(sequence.times, TIMES, atol=1e-9)
    np.testing.assert_array_equal(sequence.image(2), panorama(2))
    depth = sequence.depth(2)
    assert depth is not None
    assert np.isnan(depth[0, 0])
    assert depth[5, 5] == 3
    assert sequence.depth(1) is None
    assert sequence.groundtruth is not None
    np.testing.assert_array_equal(sequence.groundtruth.times, sequence.times[:2])
    np.testing.assert_allclose(sequence.groundtruth.T_wc, poses(2), atol=1e-11)
    assert sequence.imu is not None
    np.testing.assert_array_equal(sequence.imu.gyro[1], [4, 5, 6])
    np.testing.assert_array_equal(sequence.imu.accel[0], [0, 0, 9.81])
    assert sequence.provenance()["meta"]["source"] == "a test"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["seq"]
    half = Folder(tmp_path).open(width=32)
    assert half.camera.valid_mask().shape == (16, 32)
    assert (sequence.enlargement, half.enlargement) == (1.0, 1.0)
    assert Folder(tmp_path).open(width=128).enlargement == 2.0


def test_a_calibration_written_by_hand_counts_with_all_it_says(tmp_path: Path) -> None:
    """A mask.png that the file does not name is used besides the file's own ring; pose and clock apply to imu.csv."""
    write(tmp_path / "seq")
    (tmp_path / "seq/camera.yaml").write_text(
        "model: erp\nwidth: 64\nheight: 32\nannulus: {centre: [32, 16], r_min: 4, r_max: 30}\ntime_offset_s: 0.25\n"
        "body_T_cam: [[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    )
    sequence = Folder(tmp_path).open()
    valid = sequence.camera.valid_mask()
    ring = np.hypot(*(sequence.camera.pixel_grid() - [32, 16]).transpose(2, 0, 1))
    np.testing.assert_array_equal(valid, (ring >= 4) & (ring <= 30) & np.asarray(camera().mask))
    assert sequence.imu is not None
    np.testing.assert_allclose(sequence.imu.times, [0.25, 0.255])
    assert sequence.imu.T_body_cam is not None
    assert sequence.imu.T_body_cam[0, 3] == 0.5


def test_novel_views_round_trip(tmp_path: Path) -> None:
    views = [NovelView(f"v{k}", panorama(7 + k), camera(), poses(3)[k]) for k in range(2)]
    write_sequence(tmp_path / "seq", camera(), frames(), novel=views)
    back = Folder(tmp_path).open().novel_views()
    assert len(back) == 2
    np.testing.assert_array_equal(back[1].image, panorama(8))
    np.testing.assert_allclose(back[1].T_wc, poses(3)[1], atol=1e-12)
    assert back[0].camera == camera()
    path = tmp_path / "seq/novel.csv"
    path.write_text(path.read_text().replace("novel/001.png", "novel/009.png"))
    with pytest.raises(DatasetError, match=r"novel\.csv:3: image 'novel/009\.png' is missing"):
        Folder(tmp_path).open().novel_views()


def test_nested_sequences_are_found_and_unfinished_ones_are_not(tmp_path: Path) -> None:
    write(tmp_path / "a/erp")
    write(tmp_path / "b/erp")
    (tmp_path / "b/erp").rename(tmp_path / "b/pal.partial")
    assert Folder(tmp_path).sequences() == ["a/erp"]
    assert len(Folder(tmp_path / "a/erp").open()) == 3
    with pytest.raises(DatasetError, match="unfinished conversion"):
        Folder(tmp_path / "b/pal.partial").open()


@pytest.mark.parametrize(
    ("file", "line", "text", "message"),
    [
        ("frames.csv", 3, "0.6;images/000001.png", r"frames\.csv:3: the row has 1 values"),
        ("frames.csv", 3, "nan,images/000001.png", r"frames\.csv:3: 'nan' is not a finite"),
        ("frames.csv", 3, "0.4,images/000001.png", r"frames\.csv:3: time 0\.4 s is not later"),
        ("frames.csv", 3, "0.6,images/none.png", r"frames\.csv:3: image 'images/none\.png' is missing"),
        ("frames.csv", 3, "0.6,../../etc/x.png", r"frames\.csv:3: .*does not lie inside"),
        ("groundtruth.tum", 2, "0.5 0 0 0 0 0 0", r"groundtruth\.tum:2: the row has 7"),
        ("imu.csv", 2, "0.5,1,2,3,4,5", r"imu\.csv:2: the row has 6"),
        ("camera.yaml", 1, "model: erpp", r"camera\.yaml:1: unknown camera model 'erpp': did you mean 'erp'"),
        ("camera.yaml", 1, "model: [", r"camera\.yaml:\d: "),
        ("meta.json", 1, "{{", r"meta\.json:1: not valid JSON"),
    ],
)
def test_bad_files_are_named(tmp_path: Path, file: str, line: int, text: str, message: str) -> None:
    path = write(tmp_path / "seq") / file
    rows = path.read_text().splitlines()
    rows[line - 1] = text
    path.write_text("\n".join(rows))
    with pytest.raises((DatasetError, CalibrationError), match=message):
        Folder(tmp_path).open()


def test_empty_sequence_and_foreign_times(tmp_path: Path) -> None:
    path = write(tmp_path / "seq")
    (path / "groundtruth.tum").write_text("99 0 0 0 0 0 0 1\n")
    sequence = Folder(tmp_path).open()
    assert sequence.groundtruth is None
    assert sequence.recorded_truth is not None
    (path / "frames.csv").write_text("time,file\n")
    with pytest.raises(DatasetError, match=r"frames\.csv: the sequence is empty"):
        Folder(tmp_path).open()


def test_an_image_that_does_not_fit_the_camera(tmp_path: Path) -> None:
    path = write(tmp_path / "seq")
    save(path / "images/000001.png", panorama(1, (32, 16)))
    with pytest.raises(DatasetError, match=r"000001\.png, frame 1: the image is 32x16 pixels, the camera is 64x32"):
        Folder(tmp_path).open()


def test_a_failing_writer_leaves_nothing(tmp_path: Path) -> None:
    def broken() -> Iterator[tuple[float, np.ndarray, None]]:
        yield 0.0, panorama(0), None
        raise RuntimeError("boom")

    with pytest.raises(RuntimeError, match="boom"):
        write_sequence(tmp_path / "seq", camera(), broken())
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(DatasetError, match="no frame"):
        write_sequence(tmp_path / "seq", camera(), [])
    assert list(tmp_path.iterdir()) == []
    write(tmp_path / "seq")
    with pytest.raises(UsageError, match="exists already"):
        write(tmp_path / "seq")


def test_resuming_keeps_intact_frames_and_drops_damaged_ones(tmp_path: Path) -> None:
    def start(**what: object) -> SequenceWriter:
        return SequenceWriter(tmp_path / "seq", camera(), fingerprint=dict(what))

    first = start(every=1)
    for i in range(3):
        first.add(i, TIMES[i], panorama(i))
    (first.partial / "images/000001.png").write_bytes(b"half writ")
    with (first.partial / "journal.jsonl").open("a") as journal:
        journal.write('{"index": 3, "time"')  # the crash hit here
    first.close()
    with pytest.raises(UsageError, match="other options"):
        start(every=2)
    second = start(every=1)
    assert second.done == {0, 2}
    second.add(1, TIMES[1], panorama(1))
    second.finish()
    sequence = Folder(tmp_path).open()
    for i in range(3):
        np.testing.assert_array_equal(sequence.image(i), panorama(i))
    meta = json.loads((tmp_path / "seq/meta.json").read_text())
    assert set(meta["checksums"]) >= {f"images/{i:06d}.png" for i in range(3)} | {"camera.yaml", "mask.png"}


def test_two_writers_do_not_meet(tmp_path: Path) -> None:
    first = SequenceWriter(tmp_path / "seq", camera())
    first.add(0, 0.0, panorama(0))
    for restart in (False, True):
        with pytest.raises(UsageError, match="seq is being written by another process"):
            SequenceWriter(tmp_path / "seq", camera(), restart=restart)
    first.close()
    second = SequenceWriter(tmp_path / "seq", camera())
    assert second.done == {0}
    second.finish()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["seq"]
    assert not [p.name for p in (tmp_path / "seq").iterdir() if p.name.startswith(".")]


def test_a_full_disk_is_explained_and_leaves_no_sequence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = Path.write_bytes

    def full(self: Path, data: bytes) -> int:
        if self.name == "000001.png":
            raise OSError(errno.ENOSPC, "No space left on device", str(self))
        return real(self, data)

    writer = writer_module.SequenceWriter(tmp_path / "seq", camera())
    writer.add(0, 0.0, panorama(0))
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match="the disk is full"):
        writer.add(1, 0.1, panorama(1))
    assert not (tmp_path / "seq").exists()
