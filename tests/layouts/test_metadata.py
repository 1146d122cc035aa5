"""What the metadata of videos and images say of the sphere, and how it is read then."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import clip
from packed_spheres import (
    SIZE,
    box,
    half_panorama,
    photo_sphere,
    projected,
    resized,
    shifted,
    spherical_boxes,
    spherical_xml,
    with_boxes,
    world,
)

from panobench.cameras.erp import ErpCamera
from panobench.cameras.reproject import Reprojector
from panobench.datasets.base import FrameSequence
from panobench.datasets.formats.image_folder import ImageFolder
from panobench.datasets.formats.video import Video
from panobench.datasets.inspection.single_image import panorama_in
from panobench.errors import DatasetError
from panobench.layouts.cells import CUBE_3X2, Panorama
from panobench.layouts.layout import WHOLE, Layout, rotation
from panobench.layouts.metadata import Said, from_side_data, from_xml_text, from_xmp, xml_of_moov

FULL = b"\0\0\0\0"


def video(folder: Path, picture: np.ndarray, entry: bytes = b"", track: bytes = b"") -> FrameSequence:
    h, w = picture.shape[:2]
    path = clip(folder / "v.mp4", [0, 0.1, 0.2], size=(w, h), frame=lambda i, size: picture, crf=6)
    return Video(with_boxes(path, entry, track)).open(width=256)


def close(found: np.ndarray, expected: np.ndarray, within: float = 6.0) -> None:
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).mean() < within


SMALL = resized(world(), 256, 128)


def test_boxes_that_say_nothing_unusual_change_nothing(tmp_path: Path) -> None:
    sequence = video(tmp_path, world(), spherical_boxes())
    assert sequence.remarks() == []
    close(sequence.image(0), SMALL)


def test_stereo_by_its_box(tmp_path: Path) -> None:
    eyes = np.concatenate([world(), shifted(world(), 60)])  # too different to be recognised by their looks
    sequence = video(tmp_path, eyes, spherical_boxes(stereo=1))
    close(sequence.image(1), SMALL)
    assert sequence.remarks() == ["as its metadata say: two eyes, one above the other: the left one is used"]
    (tmp_path / "v.mp4").unlink()
    beside = resized(np.concatenate([world(), shifted(world(), 60)], axis=1), 512, 256)  # squeezed to 2:1
    sequence = video(tmp_path, beside, spherical_boxes(stereo=2))
    close(sequence.image(1), SMALL)
    assert "side by side: the left one is used" in sequence.remarks()[0]


def test_vr180_by_its_boxes_is_read_without_asking(tmp_path: Path) -> None:
    half = half_panorama(world())
    edges = struct.pack(">4I", 0, 0, 1 << 30, 1 << 30)  # a quarter of the sphere is missing on either side
    boxes = spherical_boxes(stereo=2, projection=box(b"equi", FULL, edges))
    sequence = video(tmp_path, np.concatenate([half, shifted(half)], axis=1), boxes)
    valid = sequence.camera.valid_mask()
    assert valid.mean() == pytest.approx(0.5, abs=0.01)
    close(sequence.image(0)[:, 66:190], SMALL[:, 66:190])
    assert "180 degrees of the sphere" in sequence.remarks()[0]


def test_the_part_of_a_sphere_that_its_boxes_name(tmp_path: Path) -> None:
    part = world()[64:192, 128:448]  # of 512x256: an eighth at the right, a quarter above, below, and at the left
    edges = struct.pack(">4I", 1 << 30, 1 << 30, 1 << 30, 1 << 29)
    sequence = video(tmp_path, part, spherical_boxes(projection=box(b"equi", FULL, edges)))
    assert isinstance(sequence.camera, ErpCamera)
    valid = sequence.camera.valid_mask()
    assert valid.mean() == pytest.approx(320 * 128 / (512 * 256), abs=0.01)
    close(sequence.image(0)[34:94, 66:222], SMALL[34:94, 66:222])
    assert sequence.remarks() == ["as its metadata say: a part of the sphere, 225 by 90 degrees"]


def test_a_pose_in_the_boxes_turns_the_sphere_upright(tmp_path: Path) -> None:
    turn = (30.0, 20.0, -10.0)
    camera = ErpCamera(*SIZE)
    # the picture looks in direction R^T d where the upright one looks in d
    tilted = Reprojector(camera, camera, rotation(turn).T).image(world())
    sequence = video(tmp_path, tilted, spherical_boxes(turned=turn))
    close(sequence.image(0), SMALL)
    assert sequence.remarks() == ["as its metadata say: turned upright by yaw 30.0, pitch 20.0, roll -10.0 degrees"]


def test_a_cubemap_by_its_box(tmp_path: Path) -> None:
    cube = box(b"cbmp", FULL, struct.pack(">2I", 0, 0))
    sequence = video(tmp_path, projected("e:c3x2", 576, 384), spherical_boxes(projection=cube))
    close(sequence.image(0), SMALL)
    assert sequence.remarks() == ["as its metadata say: a cubemap"]


def test_meshes_are_refused_in_one_line(tmp_path: Path) -> None:
    data = struct.pack("=Iiii4II", 9, 0, 0, 0, 0, 0, 0, 0, 0)
    assert from_side_data({"SPHERICAL": data}).unreadable == "number 9"
    fisheye = struct.pack("=Iiii4II", 5, 0, 0, 0, 0, 0, 0, 0, 0)
    assert from_side_data({"SPHERICAL": fisheye}).unreadable == "fisheye"
    with pytest.raises(DatasetError, match=r"projection is mesh, which is not read; say what they are with --layout"):
        video(tmp_path, world(), track=spherical_xml(ProjectionType="mesh"))


def test_the_first_version_of_the_metadata(tmp_path: Path) -> None:
    eyes = np.concatenate([world(), shifted(world(), 60)])
    sequence = video(tmp_path, eyes, track=spherical_xml(StereoMode="top-bottom"))
    close(sequence.image(0), SMALL)
    (tmp_path / "v.mp4").unlink()
    crop = {
        "FullPanoWidthPixels": 512,
        "FullPanoHeightPixels": 256,
        "CroppedAreaImageWidthPixels": 320,
        "CroppedAreaImageHeightPixels": 128,
        "CroppedAreaLeftPixels": 128,
        "CroppedAreaTopPixels": 64,
    }
    sequence = video(tmp_path, world()[64:192, 128:448], track=spherical_xml(**crop))
    close(sequence.image(0)[34:94, 66:222], SMALL[34:94, 66:222])
    assert "a part of the sphere, 225 by 90 degrees" in sequence.remarks()[0]


def test_a_crop_of_next_to_nothing_makes_no_giant() -> None:
    layout = from_xmp(
        b'GPano:FullPanoWidthPixels="1e8" GPano:FullPanoHeightPixels="5e7" GPano:CroppedAreaImageWidthPixels="640" '
        b'GPano:CroppedAreaImageHeightPixels="320" GPano:CroppedAreaLeftPixels="9" GPano:CroppedAreaTopPixels="9"'
    ).layout
    assert layout is not None
    assert layout.panorama_size(640, 320) == (16384, 8192)
    assert layout.seen((16384, 8192)).shape == (8192, 16384)


@pytest.mark.parametrize("name", ["moov", "uuid", ""])
def test_broken_metadata_are_none(tmp_path: Path, name: str) -> None:
    path = clip(tmp_path / "v.mp4", [0, 0.1], size=SIZE, frame=lambda i, size: world())
    if name:
        with_boxes(path, track=spherical_xml())
        data = path.read_bytes()
        at = data.index(name.encode()) - 4
        found = xml_of_moov(data[at : at + 30])
        assert isinstance(found, str)
    assert from_xml_text("<GSpherical:Spherical>false</GSpherical:Spherical>") == Said()
    assert from_xml_text("") == Said()
    assert from_side_data({"SPHERICAL": b"\0" * 8}) == Said()
    assert xml_of_moov(b"") == ""


# -- images ------------------------------------------------------------------------------------------------------------


def photo(path: Path, picture: np.ndarray, **values: object) -> Path:
    jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    path.write_bytes(photo_sphere(jpeg, **values) if values else jpeg)
    return path


CROP = {
    "FullPanoWidthPixels": 512,
    "FullPanoHeightPixels": 256,
    "CroppedAreaImageWidthPixels": 512,
    "CroppedAreaImageHeightPixels": 160,
    "CroppedAreaLeftPixels": 0,
    "CroppedAreaTopPixels": 40,
}


def test_a_phones_panorama_without_sky_and_floor(tmp_path: Path) -> None:
    photo(tmp_path / "p.jpg", world()[40:200], ProjectionType="equirectangular", **CROP)
    sequence = panorama_in(tmp_path / "p.jpg", None)
    assert (sequence.camera.width, sequence.camera.height) == SIZE
    valid = sequence.camera.valid_mask()
    assert valid[45:195].all()
    assert not valid[:39].any()
    close(sequence.image(0)[45:195], world()[45:195])
    assert sequence.remarks() == ["as its metadata say: a part of the sphere, 360 by 112 degrees"]


def test_folders_of_such_images(tmp_path: Path) -> None:
    for k in range(3):
        photo(tmp_path / f"{k}.jpg", world()[40:200], ProjectionType="equirectangular", **CROP)
    sequence = ImageFolder(tmp_path).open(width=256)
    valid = sequence.camera.valid_mask()
    assert valid.mean() == pytest.approx(160 / 256, abs=0.02)
    close(sequence.image(2)[24:96], SMALL[24:96])


def test_tilt_of_a_photo_sphere(tmp_path: Path) -> None:
    camera = ErpCamera(*SIZE)
    tilted = Reprojector(camera, camera, rotation((0, 15, -8)).T).image(world())
    said = photo(tmp_path / "p.jpg", tilted, PosePitchDegrees="15.0", PoseRollDegrees="-8", PoseHeadingDegrees="200")
    sequence = panorama_in(said, None)
    close(sequence.image(0), world())
    assert "pitch 15.0, roll -8.0" in sequence.remarks()[0]


def test_xmp_in_either_notation_and_nonsense() -> None:
    elements = "".join(f"<GPano:{k}>{v}</GPano:{k}>" for k, v in CROP.items()).encode()
    said = from_xmp(elements)
    assert said.layout is not None
    assert said.layout.packing == Panorama((0.0, 0.15625, 1.0, 0.78125))
    assert from_xmp(b"nothing") == Said()
    assert from_xmp(b'GPano:ProjectionType="cylindrical"').unreadable == "cylindrical"
    for wrong in ({"FullPanoWidthPixels": 0}, {"CroppedAreaTopPixels": 400}, {"CroppedAreaLeftPixels": "x1"}):
        text = " ".join(f'GPano:{k}="{v}"' for k, v in {**CROP, **wrong}.items()).encode()
        found = from_xmp(text)
        assert found.layout is not None
        assert found.layout.part == WHOLE
    assert from_xmp(b'GPano:UsePanoramaViewer="True"').layout == Layout()


def test_images_in_other_layouts(tmp_path: Path) -> None:
    photo(tmp_path / "cube.jpg", projected("e:c3x2", 576, 384))
    sequence = panorama_in(tmp_path / "cube.jpg", None)
    close(resized(sequence.image(0), 256, 128), SMALL)
    photo(tmp_path / "flat.jpg", world()[:, :340])
    with pytest.raises(DatasetError, match=r"340x256.*--layout.*--camera"):
        panorama_in(tmp_path / "flat.jpg", None)
    assert panorama_in(tmp_path / "flat.jpg", "erp").camera.width == 340


def test_boxes_of_a_cubemap_as_ffmpeg_has_them() -> None:
    said = from_side_data({"SPHERICAL": struct.pack("=Iiii4II", 1, 0, 0, 0, 0, 0, 0, 0, 0)})
    assert said.layout is not None
    assert said.layout.packing == CUBE_3X2
