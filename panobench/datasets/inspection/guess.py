"""What a path holds, and which dataset reads it: for `--root` alone, `panobench view` and `panobench probe`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from panobench.datasets.bags.files import BagFile
from panobench.datasets.bags.layout import find_bags, is_bag_name
from panobench.datasets.files.archive import is_archive, unpacked
from panobench.datasets.files.cameras_in_names import by_camera
from panobench.datasets.files.images import IMAGE_SUFFIXES, list_images
from panobench.datasets.files.listing import children, visible
from panobench.datasets.files.trajectory_io import is_tum
from panobench.datasets.formats.folder import find_sequences, is_sequence
from panobench.datasets.formats.image_folder import image_folders
from panobench.datasets.formats.reconstructions import TRANSFORMS, colmap_model
from panobench.datasets.formats.video import VIDEO_SUFFIXES, video_files
from panobench.datasets.palvio.calibration import OVERRIDE, published_calibration
from panobench.errors import DatasetError, PanobenchError

#: The true poses of a SynPano scene.
_POSES = "groundtruth.txt"


@dataclass(frozen=True)
class Guess:
    """The dataset that reads ``root``, and what that is in words: "a folder of 24 images".

    root: of an archive, the folder that it was unpacked to.
    """

    dataset: str
    root: Path
    what: str


def guess(path: Path) -> Guess:
    """What is at ``path``. Raises DatasetError that says what is read, if it is nothing of that."""
    if not path.exists():
        raise DatasetError("no such file or folder", path)
    if is_archive(path):
        folder = unpacked(path)
        found = guess(folder)
        return Guess(found.dataset, found.root, f"an archive, unpacked to {folder}: {found.what}")
    looks = _FILE_LOOKS if path.is_file() else _FOLDER_LOOKS
    for look in looks:
        answer = look(path)
        if answer is not None:
            return Guess(answer[0], path, answer[1])
    unread = _unread_images(path)
    if unread:
        raise DatasetError(f"{unread}: these are not read; convert them to JPEG, PNG or TIFF", path)
    raise DatasetError(
        "nothing here that is read: images, a video, a bag, a COLMAP or nerfstudio project, an archive of such or a "
        "data set (`panobench list datasets`); name its --dataset",
        path,
    )


Answer = tuple[str, str] | None


def _video_file(path: Path) -> Answer:
    return _video(path, "a video") if path.suffix.lower() in VIDEO_SUFFIXES else None


def _video(path: Path, what: str) -> Answer:
    """Footage of two lenses has their calibration beside it; GoPro's .360 has cubemaps."""
    described = (path.with_name(f"{path.stem}.dual.yaml"), path.with_name("dual_fisheye.yaml"))
    both = path.suffix.lower() != ".360" and any(p.is_file() for p in described)
    return ("insta360-dual-fisheye", f"{what} of two fisheye lenses") if both else ("video", what)


def _bag_file(path: Path) -> Answer:
    return _bag(path, "a bag") if is_bag_name(path.name) else None


def _bag(path: Path, what: str) -> Answer:
    """PALVIO's is known by its topics, or by a palvio.yaml beside it that says which of its topics are which."""
    if (path.parent / OVERRIDE).is_file():
        return "palvio", what
    try:
        found = BagFile(path)
    except (PanobenchError, ImportError):  # opening it says what is wrong, or what to install
        return "bag", what
    if published_calibration().image_topic in found.topics:
        return "palvio", f"{what} with PALVIO's topics"
    return "bag", f"{what} of {found.kind}"


def _transforms_file(path: Path) -> Answer:
    return ("nerfstudio", "a project of nerfstudio") if path.name in TRANSFORMS else None


def _image_file(path: Path) -> Answer:
    if path.suffix.lower() in IMAGE_SUFFIXES:
        raise DatasetError("this is one image; name the folder of all, or look at it with `panobench view`", path)
    return None


def _panobench(path: Path) -> Answer:
    if is_sequence(path) and (path / "frames.csv").is_file():
        return "folder", "a panobench sequence"
    found = [name for name in find_sequences(path, levels=2) if (path / name / "frames.csv").is_file()]
    return ("folder", f"{len(found)} panobench sequences") if found else None


def _pattern(dataset: str, what: str, *patterns: str) -> Callable[[Path], Answer]:
    def look(path: Path) -> Answer:
        found = any(visible(p) for pattern in patterns for p in path.glob(pattern))
        return (dataset, what) if found else None

    return look


def _synpano(path: Path) -> Answer:
    """By groundtruth.txt, whose rows name images; TUM's RGB-D recordings have a file of that name with times."""
    tables = [p for pattern in (_POSES, f"*/{_POSES}") for p in sorted(path.glob(pattern)) if visible(p)]
    return ("synpano", "a SynPano scene") if any(not is_tum(table) for table in tables) else None


def _bags(path: Path) -> Answer:
    """Bags directly here, or in folders: ROS 2 has a folder for each."""
    bags = list(find_bags(path).values())
    return _bag(bags[0], f"{len(bags)} bags" if len(bags) > 1 else "a bag") if bags else None


def _colmap(path: Path) -> Answer:
    return ("colmap", "a COLMAP project") if colmap_model(path) is not None else None


def _videos(path: Path) -> Answer:
    if not any(p.suffix.lower() in VIDEO_SUFFIXES and p.is_file() for p in children(path)):
        return None
    videos = list(video_files(path).values())
    return _video(videos[0], "a video" if len(videos) == 1 else f"{len(videos)} videos")


def _images(path: Path) -> Answer:
    found = image_folders(path)
    if not found:
        return None
    images = list_images(next(iter(found.values())))
    if len(found) == 1:
        cameras = len(by_camera(images))
        return "images", f"a folder of {len(images)} images" + (f" of {cameras} cameras" if cameras else "")
    return "images", f"{len(found)} folders of images"


#: Endings of pictures that people have and that are not read.
_OTHER_PICTURES = {
    *(".heic", ".heif", ".avif", ".jxl", ".jp2", ".exr", ".hdr", ".gif"),
    *(".dng", ".raw", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2", ".gpr"),
}


def _unread_images(path: Path) -> str:
    """ "5 .heic files", or "" where there are none here or in a folder below."""
    names = [path.name] if path.is_file() else [p.name for p in [*path.glob("*"), *path.glob("*/*")] if visible(p)]
    endings = Counter(Path(name).suffix.lower() for name in names if Path(name).suffix.lower() in _OTHER_PICTURES)
    return ", ".join(f"{count} {ending} files" for ending, count in endings.most_common(3))


_FILE_LOOKS = (_video_file, _bag_file, _transforms_file, _image_file)
#: In this order: layouts that describe themselves before those that are recognised by what is in them.
_FOLDER_LOOKS = (
    _panobench,
    _synpano,
    _bags,
    _pattern("tum-vi", "a recording in TUM-VI's layout", "mav0", "*/mav0"),
    _pattern("360loc", "360Loc", "camera_pose.json", "*/*/*/camera_pose.json"),
    _pattern("omniblender", "a scene of OmniBlender", "transform.json", "*/transform.json"),
    _pattern("omniblender", "a scene of OB3D", "Egocentric/cameras", "*/Egocentric/cameras"),
    _pattern("nerfstudio", "a project of nerfstudio", *TRANSFORMS),
    _colmap,
    _videos,
    _images,
)
