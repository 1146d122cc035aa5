"""Folders of images that nothing describes: their times, their camera, their order."""

from __future__ import annotations

import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from panobench.cameras.erp import ErpCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.datasets.base import FrameSequence
from panobench.datasets.files.image_times import ASSUMED_RATE_HZ, image_times
from panobench.datasets.given import Given
from panobench.datasets.open import open_sequence
from panobench.errors import CalibrationError, DatasetError, UsageError

LENS = "model: fisheye\nwidth: 64\nheight: 64\nfx: 20\nfy: 20\ncx: 32\ncy: 32\n"


def write(folder: Path, *names: str, size: tuple[int, int] = (64, 32)) -> list[Path]:
    """Images whose first pixel tells their number."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, name in enumerate(names):
        image = np.full((size[1], size[0], 3), 7 * k + 5, np.uint8)
        cv2.imwrite(str(folder / name), image)
    return [folder / name for name in names]


def opened(root: Path, **given: object) -> FrameSequence:
    return open_sequence("images", None, root, None, Given(**given))  # type: ignore[arg-type]


@pytest.mark.parametrize("place", ["", "images"])
def test_a_bare_folder_of_panoramas(tmp_path: Path, place: str) -> None:
    write(tmp_path / place, "p10.png", "p2.png", "p1.png")
    sequence = opened(tmp_path)
    assert sequence.camera == ErpCamera(64, 32)
    assert [sequence.frame_name(i) for i in range(3)] == ["p1.png", "p2.png", "p10.png"]
    assert sequence.times == pytest.approx(np.array([0, 1, 9]) / ASSUMED_RATE_HZ)  # images left out leave a gap
    assert "nothing says when the images were taken: 10 a second are assumed; say --rate" in sequence.remarks()
    assert sequence.groundtruth is None
    assert opened(tmp_path, rate=2.0).times == pytest.approx([0, 0.5, 4.5])


def test_several_folders_are_sequences(tmp_path: Path) -> None:
    from panobench.datasets.open import open_dataset

    write(tmp_path / "kitchen", "1.png")
    write(tmp_path / "hall" / "images", "1.png", "2.png")
    dataset = open_dataset("images", tmp_path)
    assert sorted(dataset.sequences()) == ["hall", "kitchen"]
    assert len(dataset.open("hall")) == 2
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="no images here"):
        open_dataset("images", tmp_path / "empty").sequences()


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["1403636579763555584.png", "1403636579813555456.png"], [0, 0.049999872]),  # EuRoC: nanoseconds
        (["cam0_1678901234123456.png", "cam0_1678901234223456.png"], [0, 0.1]),
        (["1678901234567.jpg", "1678901235067.jpg"], [0, 0.5]),
        (["frame_1678901234.250.png", "frame_1678901234.500.png"], [0, 0.25]),
        (["0.066667.png", "0.133333.png", "10.5.png"], [0, 0.066666, 10.433333]),
        (["IMG_20230412_153012_250.jpg", "IMG_20230412_153013_000.jpg"], [0, 0.75]),
        (["2023-04-12T15-30-12.500.png", "2023-04-12T15-31-12.500.png"], [0, 60]),
        (["20230412153012.png", "20230412163012.png"], [0, 3600]),
    ],
)
def test_times_in_names(tmp_path: Path, names: list[str], times: list[float]) -> None:
    found = image_times(write(tmp_path, *names))
    assert found.source == "the images' names"
    assert found.times == pytest.approx(times, abs=1e-9)
    assert not found.assumed


@pytest.mark.parametrize(
    "names",
    [
        ["IMG_20230412_153012.jpg", "IMG_20230412_153012_1.jpg", "IMG_20230412_153013.jpg"],  # two in one second
        ["R0010001.JPG", "R0010002.JPG"],
        ["99999999999999.png", "99999999999998.png"],
        ["20231342_999999.png", "20231342_999998.png"],
    ],
)
def test_names_that_are_no_times(tmp_path: Path, names: list[str]) -> None:
    assert image_times(write(tmp_path, *names)).assumed


def photograph(path: Path, taken: str, fraction: str | None = None) -> Path:
    exif = Image.Exif()
    block = exif.get_ifd(0x8769)
    block[0x9003] = taken
    if fraction is not None:
        block[0x9291] = fraction
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (64, 32)).save(path, exif=exif)
    return path


def test_times_in_exif(tmp_path: Path) -> None:
    start = datetime.datetime(2023, 4, 12, 15, 30, 59)
    paths = [
        photograph(tmp_path / f"R{k}.jpg", (start + datetime.timedelta(seconds=s)).strftime("%Y:%m:%d %H:%M:%S"), f)
        for k, (s, f) in enumerate([(0, "25"), (0, "750"), (2, "000")])
    ]
    found = image_times(paths)
    assert found.source == "EXIF"
    assert found.times == pytest.approx([0, 0.5, 1.75])
    photograph(paths[1], "2023:04:12 15:30:59", "25")  # twice the same: of no use
    assert image_times(paths).assumed
    paths[1].write_bytes(paths[1].read_bytes()[:40])
    assert image_times(paths).assumed


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("times.txt", "0.0\n0.5\n2.5\n"),
        ("timestamps.txt", "1700000000.0\n1700000000.5\n1700000002.5\n"),
        ("rgb.txt", "# time file\n5.0 rgb/1.png\n5.5 rgb/2.png\n7.5 rgb/3.png\n"),
        ("data.csv", "#timestamp [ns],filename\n500000000,1.png\n1000000000,2.png\n3000000000,3.png\n"),
        ("times.csv", "time,name\n7.5,3.png\n5.0,1.png\n5.5,2.png\n"),
        ("times.csv", "filename,timestamp_ms\n1.png,5000\n2.png,5500\n3.png,7500\n"),
        ("timestamps.txt", "# frame time\n1 5.0\n2 5.5\n3 7.5\n"),
        ("times.txt", "5.0, images\\1.png\n5.5, images\\2.png\n7.5, images\\3.png\n"),
        ("times.csv", "frame_id;timestamp;image\n0;5.0;1.png\n1;5.5;2.png\n2;7.5;3.png\n"),
    ],
)
@pytest.mark.parametrize("above", [False, True])
def test_times_in_a_list(tmp_path: Path, name: str, text: str, above: bool) -> None:
    paths = write(tmp_path / "images", "1.png", "2.png", "3.png")
    (tmp_path / ("" if above else "images") / name).write_text(text)
    found = image_times(paths)
    assert (found.source, found.times.tolist()) == (name, [0, 0.5, 2.5])
    assert image_times(paths, 4.0).times.tolist() == [0, 0.25, 0.5]  # what is asked for counts first


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0\n1\n", "the list has 2 times for 3 images"),
        ("0\n2\n1\n", "times.txt:3: time 1 s is not later"),
        ("0 x.png\n1 y.png\n", "names none of the images"),
        ("0\nx\n", "times.txt:2: 'x' is not a number"),
        ("", "empty"),
    ],
)
def test_a_list_that_does_not_fit(tmp_path: Path, text: str, message: str) -> None:
    paths = write(tmp_path, "1.png", "2.png", "3.png")
    (tmp_path / "times.txt").write_text(text)
    with pytest.raises(DatasetError, match=message):
        image_times(paths)


def test_the_camera_of_other_images(tmp_path: Path) -> None:
    write(tmp_path / "images", "1.png", "2.png", size=(64, 64))
    with pytest.raises(DatasetError, match=r"64x64.*--layout.*--calibration FILE which lens"):
        opened(tmp_path)
    (tmp_path / "lens.yaml").write_text(LENS)
    camera = opened(tmp_path, calibration=str(tmp_path / "lens.yaml")).camera
    assert isinstance(camera, KannalaBrandtCamera)
    # of images that were only resized
    (tmp_path / "lens.yaml").write_text(LENS.replace("64", "128").replace("32", "64").replace("20", "40"))
    assert opened(tmp_path, calibration=str(tmp_path / "lens.yaml")).camera.to_dict() == camera.to_dict()
    (tmp_path / "lens.yaml").write_text(LENS.replace("height: 64", "height: 48"))
    with pytest.raises(CalibrationError, match="the calibration is for 64x48 images, these are 64x64"):
        opened(tmp_path, calibration=str(tmp_path / "lens.yaml"))
    # beside the images it is found, and said
    (tmp_path / "camera.yaml").write_text(LENS)
    assert opened(tmp_path).camera.to_dict() == camera.to_dict()
    assert "the camera is from camera.yaml, which lies beside the images" in opened(tmp_path).remarks()


def test_a_mask_is_no_frame(tmp_path: Path) -> None:
    write(tmp_path, "1.png", "2.png")
    mask = np.full((32, 64), 255, np.uint8)
    mask[24:] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    sequence = opened(tmp_path)
    assert len(sequence) == 2
    assert sequence.camera.mask is not None
    assert not sequence.camera.mask[24:].any()


def test_options_that_a_dataset_has_no_use_for(tmp_path: Path) -> None:
    write(tmp_path / "images", "1.png")
    with pytest.raises(
        UsageError, match="--topic: dataset 'images' has no use for it; it takes --calibration, --layout, --rate"
    ):
        opened(tmp_path, topic="/cam")
    with pytest.raises(UsageError, match="--rate: dataset 'synpano' has no use for it; it takes no such option"):
        open_sequence("synpano", None, tmp_path, None, Given(rate=3.0))
    with pytest.raises(UsageError, match="--rate -1"):
        Given(rate=-1.0)


def test_one_frame_in_two_formats_is_refused(tmp_path: Path) -> None:
    write(tmp_path, "1.png", "1.jpg", "2.png")
    with pytest.raises(DatasetError, match=r"1.jpg and 1.png are the same frame twice"):
        opened(tmp_path)


@pytest.mark.parametrize(
    ("names", "cameras"),
    [
        (["frame_{}_left.png", "frame_{}_right.png"], ["left", "right"]),
        (["L{}.png", "R{}.png"], ["L", "R"]),
        (["cam0_{}.png", "cam1_{}.png", "cam10_{}.png"], ["cam0", "cam1", "cam10"]),
        (["{}.png", "{}_thumb.png"], ["plain", "thumb"]),
    ],
)
def test_cameras_whose_images_share_a_folder_are_sequences(
    tmp_path: Path, names: list[str], cameras: list[str]
) -> None:
    from panobench.datasets.inspection.guess import guess
    from panobench.datasets.open import open_dataset

    root = tmp_path / "walk"
    for k, name in enumerate(names):  # each of a brightness of its own
        for i in range(1, 12):
            root.mkdir(exist_ok=True)
            cv2.imwrite(str(root / name.format(i)), np.full((32, 64, 3), 50 * k, np.uint8))
    dataset = open_dataset("images", root)
    assert dataset.sequences() == [f"walk/{camera}" for camera in cameras]
    assert guess(root).what == f"a folder of {11 * len(names)} images of {len(names)} cameras"
    for k, camera in enumerate(cameras):
        sequence = dataset.open(f"walk/{camera}")
        assert {int(sequence.image(i)[0, 0, 0]) for i in range(len(sequence))} == {50 * k}
        assert len(sequence) == 11
        listed = ", ".join(cameras)
        line = f"the folder has images of {len(cameras)} cameras ({listed}); these are of {camera} (--sequence)"
        assert line in sequence.remarks()


@pytest.mark.parametrize(
    "names",
    [
        [f"frame{i}.png" for i in range(8)],
        [f"{i // 4}-{i % 4}.png" for i in range(8)],
        ["left1.png", "left2.png", "right1.png", "right2.png"],  # too few to tell
        [*(f"a{i}.png" for i in range(4)), *(f"b{i}.png" for i in range(90, 94))],
        ["kitchen.png", "hall.png", "stairs.png"],
    ],
)
def test_other_names_are_of_one_camera(tmp_path: Path, names: list[str]) -> None:
    assert len(opened_all(tmp_path, names)) == len(names)


def opened_all(root: Path, names: list[str]) -> FrameSequence:
    write(root, *names)
    return opened(root)


def test_folders_of_systems_and_of_other_pictures_are_no_sequences(tmp_path: Path) -> None:
    from panobench.datasets.open import open_dataset

    write(tmp_path / "2023" / "trip" / "take 1" / "out", "1.png", "2.png")
    for folder in ("@eaDir/1.png", "#recycle", "depth", "masks", "Thumbnails"):
        write(tmp_path / folder, "1.png")
    assert open_dataset("images", tmp_path).sequences() == ["2023/trip/take 1/out"]
    write(tmp_path / "only" / "depth", "1.png")
    assert open_dataset("images", tmp_path / "only").sequences() == ["depth"]


POSES = [f"{t} {t} 0 0 0 0 0 1" for t in (0, 0.5, 2.5)]


def test_true_poses_beside_the_images(tmp_path: Path) -> None:
    write(tmp_path / "rgb", "1.png", "2.png", "3.png")
    (tmp_path / "groundtruth.txt").write_text("# timestamp tx ty tz qx qy qz qw\n" + "\n".join(POSES))
    assert opened(tmp_path).groundtruth is None
    line = "groundtruth.txt beside the images is not used: nothing says when they were taken (--rate)"
    assert line in opened(tmp_path).remarks()
    (tmp_path / "rgb.txt").write_text("0.0 rgb/1.png\n0.5 rgb/2.png\n2.5 rgb/3.png\n")
    truth = opened(tmp_path).groundtruth
    assert truth is not None
    assert truth.T_wc[:, 0, 3].tolist() == [0, 0.5, 2.5]
    assert "ground truth is from groundtruth.txt, which lies beside the images" in opened(tmp_path).remarks()
    # of another clock, or damaged: named, not used
    (tmp_path / "groundtruth.txt").write_text("900 0 0 0 0 0 0 1\n901 1 0 0 0 0 0 1\n")
    assert opened(tmp_path).groundtruth is None
    assert any("groundtruth.txt beside the images is not used" in line for line in opened(tmp_path).remarks())
    (tmp_path / "groundtruth.txt").write_text("x")
    assert any("groundtruth.txt beside the images is not used" in line for line in opened(tmp_path).remarks())
    (tmp_path / "groundtruth.txt").rename(tmp_path / "poses.txt")
    line = "poses.txt beside the images is not used: --groundtruth FILE takes it as true"
    assert line in opened(tmp_path).remarks()


def test_stamps_since_1970_are_of_the_clock_of_the_images(tmp_path: Path) -> None:
    from panobench.trajectories.matching import Frames, place
    from panobench.trajectories.reading import read_poses
    from panobench.trajectories.reference import read_reference

    start = 1_678_901_234
    write(tmp_path / "images", *(f"{start + t:.6f}.png" for t in (0, 0.5, 2.5)))
    path = tmp_path / "them.tum"
    path.write_text("\n".join(f"{start + t:.6f} {t} 0 0 0 0 0 1" for t in (0, 0.5, 2.5)))
    frames = Frames.of(opened(tmp_path))
    assert frames.times == pytest.approx([0, 0.5, 2.5])
    assert read_reference(path, frames).trajectory.T_wc[:, 0, 3] == pytest.approx([0, 0.5, 2.5])
    placed = place(read_poses(path), frames, path)
    assert (placed.index.tolist(), placed.unplaced) == ([0, 1, 2], 0)
    assert len(place(read_poses(path), frames, path, time_offset=-float(start)).index) == 3  # said, not guessed
    path.write_text("\n".join(POSES))
    assert len(place(read_poses(path), frames, path).index) == 3


def test_a_file_called_calibration_that_is_none_is_named(tmp_path: Path) -> None:
    write(tmp_path, "1.png", "2.png")
    (tmp_path / "calib.txt").write_text("P0: 718 0 607 0 0 718 185 0 0 0 1 0\n")
    (tmp_path / "intrinsics.txt").write_text("718 0 607\n0 718 185\n0 0 1\n")
    sequence = opened(tmp_path)
    assert sequence.camera == ErpCamera(64, 32)
    for name in ("calib.txt", "intrinsics.txt"):
        assert f"{name} beside the images is no calibration that is read" in sequence.remarks()


def test_stamps_in_exif_that_several_images_share_are_named(tmp_path: Path) -> None:
    for k in range(4):
        photograph(tmp_path / f"R{k}.jpg", f"2023:04:12 15:30:0{k // 2}")
    line = "EXIF has whole seconds, which several images share: 10 images a second are assumed; say --rate"
    assert line in opened(tmp_path).remarks()
