from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from panobench.cameras.erp import ErpCamera
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.reproject import Reprojector
from panobench.cameras.stitching import Stitcher
from panobench.cameras.views import look_rotation
from panobench.datasets.formats.dual_fisheye import read_dual_fisheye
from panobench.datasets.open import open_sequence
from panobench.errors import CalibrationError, DatasetError, UsageError

LENS = KannalaBrandtCamera.equidistant(128, 200.0)


def world(width: int = 256) -> np.ndarray:
    """A smooth panorama without a seam."""
    rays = ErpCamera(width, width // 2).rays()
    return (
        np.asarray(127.5 + 60 * rays + 50 * np.sin(6 * rays[..., [1, 2, 0]]), dtype=np.float64).round().astype(np.uint8)
    )


def rig_values() -> dict[str, object]:
    camera = LENS.to_dict()
    return {
        "blend_deg": 8,
        "lenses": [
            {"x": 0, "y": 4, "camera": camera},
            {"x": 136, "y": 4, "camera": camera, "yaw_pitch_roll_deg": [179, 1, 90]},
        ],
    }


def frame() -> np.ndarray:
    """Both circles in a 272x136 frame."""
    out = np.zeros((136, 272, 3), np.uint8)
    for x, R in ((0, np.eye(3)), (136, look_rotation(179, 1, 90))):
        seen = Reprojector(ErpCamera(256, 128), LENS, R).image(world())
        out[4:132, x : x + 128] = seen
    return out


def write(folder: Path, values: object) -> Path:
    path = folder / "dual_fisheye.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def test_stitching_gives_the_world_back(tmp_path: Path) -> None:
    rig = read_dual_fisheye(write(tmp_path, rig_values()))
    stitcher = Stitcher(rig.rig, ErpCamera(192, 96), rig.blend_deg)
    assert stitcher.valid.all()
    expected = world(192).astype(float)
    error = np.abs(stitcher.image(rig.pictures(frame())).astype(float) - expected)
    assert error.mean() < 1.5
    assert np.percentile(error, 99.5) < 8


def test_what_no_lens_sees_is_masked(tmp_path: Path) -> None:
    values = rig_values()
    narrow = KannalaBrandtCamera.equidistant(128, 160.0).to_dict()
    for lens in values["lenses"]:  # type: ignore[attr-defined]
        lens["camera"] = narrow
    stitcher = Stitcher(read_dual_fisheye(write(tmp_path, values)).rig, ErpCamera(128, 64))
    assert 0.6 < stitcher.valid.mean() < 0.9
    assert not stitcher.valid[0].any()  # the zenith lies in the gap between the lenses


def test_a_video_of_two_circles(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "walk.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, (272, 136))
    for _ in range(3):
        writer.write(frame()[..., ::-1])
    writer.release()
    with pytest.raises(CalibrationError, match=r"dual_fisheye\.yaml: the calibration of the two lenses is missing"):
        open_sequence("insta360-dual-fisheye", None, tmp_path)
    write(tmp_path, rig_values())
    sequence = open_sequence("insta360-dual-fisheye", "walk", tmp_path, 192)
    assert len(sequence) == 3
    assert (sequence.camera.kind, sequence.camera.width, sequence.camera.mask) == ("erp", 192, None)
    assert np.abs(sequence.image(1).astype(float) - world(192)).mean() < 5  # the codec costs some
    assert sequence.provenance()["files"] == 2
    native = open_sequence("insta360-dual-fisheye", "walk", tmp_path).camera.width
    assert [
        open_sequence("insta360-dual-fisheye", "walk", tmp_path, width).enlargement for width in (native, 2 * native)
    ] == [1.0, 2.0]
    with pytest.raises(UsageError, match="must be even"):
        open_sequence("insta360-dual-fisheye", "walk", tmp_path, 255)
    values = rig_values()
    values["lenses"][1]["x"] = 200  # type: ignore[index]
    write(tmp_path, values)
    with pytest.raises(CalibrationError, match=r"lens 1 reaches to \(328, 132\), the frame is 272x136"):
        open_sequence("insta360-dual-fisheye", "walk", tmp_path)
    with pytest.raises(DatasetError, match="no such file"):
        open_sequence("insta360-dual-fisheye", None, tmp_path / "none.mp4")


def test_lenses_whose_centres_are_known_are_a_rig(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "walk.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, (272, 136))
    writer.write(frame()[..., ::-1])
    writer.release()
    write(tmp_path, rig_values())
    central = open_sequence("insta360-dual-fisheye", "walk", tmp_path, 120)
    assert central.rig is None
    assert central.lens_images(0) == ()
    values = rig_values()
    for lens, z in zip(values["lenses"], (0.02, -0.021)):  # type: ignore[call-overload]
        lens["t_rig_lens"] = [0.0, 0.0, z]
    write(tmp_path, values)
    sequence = open_sequence("insta360-dual-fisheye", "walk", tmp_path, 120)
    rig = sequence.rig
    assert rig is not None
    assert rig.baseline_m == pytest.approx(0.041)
    pictures = sequence.lens_images(0)
    assert [p.shape[1] for p in pictures] == [lens.camera.width for lens in rig.lenses]
    assert 50 < pictures[0].shape[1] < 128
    assert np.abs(pictures[0].astype(float).mean() - frame()[4:132, :128].mean()) < 4
    values["lenses"][0]["t_rig_lens"] = [0, 1]  # type: ignore[index]
    write(tmp_path, values)
    with pytest.raises(CalibrationError, match="must be three numbers"):
        open_sequence("insta360-dual-fisheye", "walk", tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"lenses": []}, "a list of two"),
        ({"lenses": [{}, {}]}, "lens 0 has no 'camera'"),
        ({"blend_deg": 0}, "'blend_deg'"),
        ({"lenses": [{"camera": {"model": "fishy"}}, {}]}, "lens 0: unknown camera model 'fishy'"),
        ({"lenses": [{"camera": LENS.to_dict(), "yaw": 3}, {}]}, "lens 0: unknown key 'yaw'"),
        ({"lenses": [{"camera": LENS.to_dict(), "yaw_pitch_roll_deg": [1, 2]}, {}]}, "lens 0: "),
        ({"lenses": [{"camera": LENS.to_dict(), "R_rig_lens": [[1, 0, 0]]}, {}]}, "not a rotation"),
        ({"lenses": [{"camera": "none.yaml"}, {}]}, "none.yaml"),
    ],
)
def test_bad_calibrations_name_the_lens(tmp_path: Path, change: dict[str, object], message: str) -> None:
    path = write(tmp_path, {**rig_values(), **change})
    with pytest.raises(CalibrationError, match=r"dual_fisheye\.yaml") as caught:
        read_dual_fisheye(path)
    assert message in str(caught.value)
