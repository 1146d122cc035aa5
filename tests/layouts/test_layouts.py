"""Every layout is read back as the panorama it was made of, and recognised by what it looks like."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from clips import clip
from packed_spheres import SIZE, barred, half_panorama, projected, resized, shifted, world

from panobench.datasets.formats.image_folder import ImageFolder
from panobench.datasets.formats.video import Video
from panobench.errors import DatasetError, UnknownNameError, UsageError
from panobench.layouts.cells import Panorama
from panobench.layouts.evidence import tear
from panobench.layouts.layout import Layout, directions, rotation
from panobench.layouts.metadata import Said
from panobench.layouts.names import LAYOUTS, layout_named, two_fisheyes
from panobench.layouts.recognise import recognise, tornness

UP_DOWN = np.concatenate([world(), shifted(world())])
PICTURES = {
    "top-bottom": UP_DOWN,
    "left-right": np.concatenate([world(), shifted(world())], axis=1),
    "eac": projected("e:eac", 576, 384),
    "cube-3x2": projected("e:c3x2", 576, 384),
    "cube-6x1": projected("e:c6x1", 1152, 192),
    "cube-1x6": projected("e:c1x6", 192, 1152),
    "cube-strip": projected("e:c6x1:out_forder=frblud", 1152, 192),
}


def cross() -> np.ndarray:
    """A lying cross: right left up down front back of a row of faces, put around the front one."""
    faces = dict(zip("rludfb", np.split(PICTURES["cube-6x1"], 6, axis=1)))
    faces[" "] = np.zeros_like(faces["f"])
    rows = [[faces[k] for k in row] for row in (" u  ", "lfrb", " d  ")]
    return np.concatenate([np.concatenate(row, axis=1) for row in rows])


PICTURES["cube-cross"] = cross()


def close(found: np.ndarray, expected: np.ndarray, within: float = 4.0) -> None:
    assert found.shape == expected.shape
    assert np.abs(found.astype(int) - expected).mean() < within


@pytest.mark.parametrize("name", PICTURES)
def test_a_layout_is_read_as_the_panorama_it_was_made_of(name: str) -> None:
    picture = PICTURES[name]
    stored = picture.shape[1::-1]
    layout = layout_named(name).fitted(stored)
    close(layout.unpack(picture, SIZE), world())
    half = layout.picture_size(stored, (256, 128))
    close(layout.unpack(resized(picture, *half), (256, 128)), resized(world(), 256, 128), 6.0)
    assert layout.seen(SIZE).all()


@pytest.mark.parametrize("name", PICTURES)
def test_a_layout_is_recognised_by_its_edges(name: str) -> None:
    picture = PICTURES[name]
    found = recognise([picture], picture.shape[1::-1], Said())
    assert found.refusal == ""
    assert found.layout.name == name
    assert found.layout.remark


@pytest.mark.parametrize("rim", [180, 190, 200, 220])
def test_two_fisheyes_are_refused_with_a_command_that_works(rim: int) -> None:
    picture = projected(f"e:dfisheye:h_fov={rim}:v_fov={rim}", 512, 256)
    found = recognise([picture], (512, 256), Said())
    assert "two fisheye circles" in found.refusal
    assert f"--layout fisheyes:{rim}" in found.refusal
    # FFmpeg has the lens that looks behind on the left
    close(two_fisheyes(rim).unpack(picture, SIZE), np.roll(world(), 256, axis=1), 5.0)
    circles = picture.copy()
    y, x = np.mgrid[0:256, 0:256]
    outside = np.tile(np.hypot(x - 127.5, y - 127.5) > 128, (1, 2))
    circles[outside] = 0
    assert "two fisheye circles" in recognise([circles], (512, 256), Said()).refusal


def test_two_eyes_of_half_the_sphere_are_refused_with_a_command_that_works() -> None:
    half = half_panorama(world())
    picture = np.concatenate([half, shifted(half)], axis=1)
    found = recognise([picture], (512, 256), Said())
    assert "two eyes" in found.refusal
    assert "--layout vr180" in found.refusal
    layout = layout_named("vr180")
    assert layout.panorama_size(512, 256) == (512, 256)
    seen = layout.seen(SIZE)
    assert seen.mean() == pytest.approx(0.5)
    read = layout.unpack(picture, SIZE)
    close(read[:, 130:382], world()[:, 130:382])
    assert (read[~seen] == 0).all()


@pytest.mark.parametrize("size", [(512, 288), (640, 360), (480, 270)])
def test_stretched_panoramas_and_such_between_bars_are_read(size: tuple[int, int]) -> None:
    stretched = resized(world(), *size)
    found = recognise([stretched], size, Said())
    assert found.refusal == ""
    assert "stretched to 2:1" in found.layout.remark
    close(found.layout.unpack(stretched, SIZE), world(), 6.0)
    inner = resized(world(), size[0], size[0] // 2)
    framed = barred(inner, *size)
    found = recognise([framed], size, Said())
    assert "black bars are cut off" in found.layout.remark
    assert found.layout.panorama_size(*size) == (size[0], size[0] // 2)
    close(found.layout.unpack(framed, (size[0], size[0] // 2)), inner)


@pytest.mark.parametrize("size", [(512, 258), (512, 250), (510, 256)])
def test_sizes_that_an_encoder_rounded_are_taken(size: tuple[int, int]) -> None:
    found = recognise([resized(world(), *size)], size, Said())
    assert found.refusal == ""
    assert found.layout.remark == f"{size[0]}x{size[1]} pixels are stretched to 2:1"


def test_panoramas_are_panoramas_and_other_pictures_are_not() -> None:
    for turn in (0, 77, 180):
        found = recognise([world(turn)], SIZE, Said())
        assert (found.layout, found.refusal) == (Layout(), "")
    flat = world()[60:200, 100:380]  # a camera's picture: nothing continues anywhere
    found = recognise([flat], (280, 140), Said())
    assert found.refusal == ""
    assert "may be no panorama" in found.layout.remark
    refused = recognise([world()[:, :342]], (342, 256), Said())
    assert "twice as wide as high" in refused.refusal
    assert "--layout" in refused.refusal
    plain = np.full((256, 512, 3), 90, np.uint8)  # fog tells nothing
    assert tornness([plain], Panorama()) is None
    assert recognise([plain], SIZE, Said()).layout == Layout()
    assert tear(plain, Panorama()) is None


def test_a_logo_at_the_foot_makes_no_other_layout_of_a_panorama() -> None:
    picture = world().copy()
    sectors = np.arange(SIZE[0]) // 64 % 2 == 0
    picture[217:] = np.where(sectors[None, :, None], 240, 10)
    torn = tornness([picture], Panorama())
    assert torn is not None
    assert torn > 0.3
    seam = tornness([picture], Panorama(), within_deg=45.0)
    assert seam is not None
    assert seam < 0.1
    found = recognise([picture], SIZE, Said())
    assert (found.layout, found.refusal) == (Layout(), "")
    framed = barred(picture, 512, 288)
    assert "black bars are cut off" in recognise([framed], (512, 288), Said()).layout.remark


@pytest.mark.parametrize("harm", ["dark", "noise", "blur", "plain sky", "black foot", "black caps", "tilted"])
def test_a_genuine_panorama_stays_one(harm: str) -> None:
    def harmed(turn: int) -> np.ndarray:
        image = world(turn).astype(float)
        if harm == "dark":
            image *= 0.06
        elif harm == "noise":
            image += np.random.default_rng(turn).normal(0, 40, image.shape)
        elif harm == "blur":
            image = cv2.GaussianBlur(np.concatenate([image] * 3, axis=1), (0, 0), 9)[:, 512:1024]
        elif harm == "plain sky":
            image[:140] = 235
        elif harm == "black foot":
            image[170:] = 0
        elif harm == "black caps":
            image[:30] = image[-30:] = 0
        else:
            return Layout(yaw_pitch_roll_deg=(20, 70, 40)).unpack(world(turn), SIZE)
        return np.clip(image, 0, 255).astype(np.uint8)

    pictures = [harmed(turn) for turn in (0, 50, 200)]
    for size in (SIZE, (512, 258), (512, 288)):
        found = recognise([resized(p, *size) for p in pictures], size, Said())
        assert found.refusal == ""
        assert found.layout.name == "erp"
        assert "may be no panorama" not in found.layout.remark


def test_names() -> None:
    for name in LAYOUTS:
        assert layout_named(name).name == name
    assert layout_named("fisheyes:203.5").packing.rim_deg == 203.5  # type: ignore[attr-defined]
    with pytest.raises(UnknownNameError, match="did you mean 'eac'"):
        layout_named("eacs")
    for wrong in ("eac:3", "fisheyes:x", "fisheyes:20"):
        with pytest.raises(UsageError, match="only fisheyes takes a number"):
            layout_named(wrong)


def test_a_tilted_sphere_is_turned_upright() -> None:
    assert rotation((0, 0, 0)) == pytest.approx(np.eye(3))
    ahead = np.array([0.0, 0.0, 1.0])
    assert rotation((90, 0, 0)) @ ahead == pytest.approx([-1, 0, 0])  # to the left
    assert rotation((0, 90, 0)) @ ahead == pytest.approx([0, -1, 0])  # upwards
    assert rotation((0, 0, 90)) @ np.array([0.0, -1.0, 0.0]) == pytest.approx([1, 0, 0])  # clockwise
    quarter = Layout(yaw_pitch_roll_deg=(90.0, 0.0, 0.0)).unpack(world(), SIZE)
    close(quarter, np.roll(world(), -128, axis=1))
    assert directions((4, 2)).shape == (2, 4, 3)


def test_a_video_in_a_layout_and_its_mask(tmp_path: Path) -> None:
    picture = PICTURES["eac"]
    clip(tmp_path / "v.mp4", [0, 0.1, 0.2], size=(576, 384), frame=lambda i, size: picture, crf=8)
    sequence = Video(tmp_path / "v.mp4").open(width=256)
    assert sequence.camera.kind == "erp"
    close(sequence.image(1), resized(world(), 256, 128), 7.0)
    assert any("equi-angular cubemap" in remark for remark in sequence.remarks())
    assert sequence.provenance()["layout"]["name"] == "eac"
    front = np.full((384, 576), 255, np.uint8)
    front[:192, 192:384] = 0  # of the pictures as they are
    cv2.imwrite(str(tmp_path / "v.mask.png"), front)
    masked = Video(tmp_path / "v.mp4").open(width=256)
    valid = masked.camera.valid_mask()
    assert not valid[64, 128]
    assert valid[64, 10]
    assert (~valid).mean() == pytest.approx(0.12, abs=0.02)


def test_videos_that_are_no_panoramas_are_one_line(tmp_path: Path) -> None:
    picture = projected("e:dfisheye:h_fov=190:v_fov=190", 512, 256)
    clip(tmp_path / "v.mp4", [0, 0.1], size=(512, 256), frame=lambda i, size: picture, crf=8)
    with pytest.raises(DatasetError, match=r"v\.mp4: the pictures show two fisheye circles \(about 190 degrees\)"):
        Video(tmp_path / "v.mp4").open()


def test_folders_of_images_in_a_layout(tmp_path: Path) -> None:
    for i in range(3):
        cv2.imwrite(str(tmp_path / f"{i}.png"), PICTURES["top-bottom"][..., ::-1])
    sequence = ImageFolder(tmp_path).open(width=256)
    assert len(sequence) == 3
    close(sequence.image(0), resized(world(), 256, 128))
    assert any("one per eye" in remark for remark in sequence.remarks())
