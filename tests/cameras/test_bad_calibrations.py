"""Calibration files that are refused: the message names file, line and mistake."""

from __future__ import annotations

from pathlib import Path

import pytest
from camera_strategies import EXAMPLES, QUICK
from hypothesis import given, settings
from hypothesis import strategies as st

from panobench.cameras.calibration import (
    WRITTEN,
    builtin_calibration,
    read_calibration,
    write_calibration,
)
from panobench.errors import CalibrationError, PanobenchError, UnknownNameError


def refusal(path: Path, format: str) -> str | None:
    """The message with which the file is refused, or None if it is read."""
    try:
        read_calibration(path, format)
    except PanobenchError as error:
        return str(error)
    return None


def test_mask_beside_the_camera_file(tmp_path: Path) -> None:
    up = builtin_calibration("palvio_up").scaled(160)
    write_calibration(up, tmp_path / "camera.yaml")
    assert (tmp_path / "mask.png").is_file()
    assert read_calibration(tmp_path / "camera.yaml") == up
    (tmp_path / "mask.png").write_bytes(b"no image")
    with pytest.raises(CalibrationError, match=r"camera.yaml:\d+: the mask file mask.png is not an image"):
        read_calibration(tmp_path / "camera.yaml")
    (tmp_path / "mask.png").unlink()
    with pytest.raises(CalibrationError, match="missing"):
        read_calibration(tmp_path / "camera.yaml")
    text = (tmp_path / "camera.yaml").read_text()
    (tmp_path / "camera.yaml").write_text(text.replace("mask.png", "../mask.png"))
    with pytest.raises(CalibrationError, match="beside"):
        read_calibration(tmp_path / "camera.yaml")


def test_calibration_for_another_resolution(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    write_calibration(builtin_calibration("palvio_up"), path)
    assert read_calibration(path, size=(1280, 960)).width == 1280
    with pytest.raises(CalibrationError, match=r"is for 1280x960 images, these are 640x480; .*scale"):
        read_calibration(path, size=(640, 480))
    with pytest.raises(CalibrationError, match=r"is for 1280x960 images, these are 1280x720$"):
        read_calibration(path, size=(1280, 720))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("model: pinhole\nwidth: 10\nheight: 10\nfx: 1\nfy: 1\ncx: 5\n", "'cy' is missing"),
        ("model: erp\nwidth: wide\nheight: 10\n", r":2: .*width must be a whole number from 1 to 65536, not 'wide'"),
        ("model: erp\nwidth: 21\nheight: 10\n", "a panorama's width must be even, not 21"),
        ("model: pinhole\nwidth: 10\nheight: 10\nfx: 1\nfy: one\ncx: 5\ncy: 5\n", "fy must be a number, not 'one'"),
        ("model: pinhole\nwidth: 10\nheight: 10\nfx: -1\nfy: 1\ncx: 5\ncy: 5\n", "positive"),
        ("model: pinhole\nwidth: 10.5\nheight: 10\nfx: 1\nfy: 1\ncx: 5\ncy: 5\n", "width must be a whole number"),
        ("model: pinhol\nwidth: 10\n", "did you mean 'pinhole'"),
        ("model: erp\nwidth: 20\nwidth: 20\nheight: 10\n", r":3: 'width' is given twice"),
        ("model: erp\nwidth: 20\nheight: 10\nhfov: 10\n", r":4: .*unknown value 'hfov'"),
        ("model: erp\nwidth: &a 20\nheight: *a\n", "aliases are not allowed"),
        ("model: erp\nwidth: !!python/object/apply:os.system [ls]\n", "not valid YAML"),
        ("model: erp\n  width: 20\n", r":2: not valid YAML"),
        ("model: [" + "[" * 1500, "nested too deeply|not valid YAML"),
        ("5 -244 0 0.001\n", "five lines"),
        ("hello\n", "not recognised"),
        ("{width: 64, height: 32}\n", "not recognised"),
        ("{model: erp,\n width: wide, height: 10}\n", r":2: .*width must be a whole number"),
        ("{model: erp, width: 64\n", "not valid YAML"),
        ("{" * 1500, "nested too deeply|not valid YAML"),
    ],
)
def test_bad_files_are_explained(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / ("camera.txt" if text[:1] in "5h" else "camera.yaml")
    path.write_text(text)
    with pytest.raises(CalibrationError, match=message) as caught:
        read_calibration(path, "ocamcalib" if text.startswith("5") else None)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_are_not_text(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    with pytest.raises(CalibrationError, match="missing"):
        read_calibration(path)
    path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0")
    with pytest.raises(CalibrationError, match=r"not a text file|not UTF-8 text"):
        read_calibration(path)
    path.write_bytes(b"a: 1\n" * 300_000)
    with pytest.raises(CalibrationError, match="over 1 MiB, too large for calibration file"):
        read_calibration(path)
    with pytest.raises(CalibrationError, match="this is a folder"):
        read_calibration(tmp_path)
    with pytest.raises(UnknownNameError, match="did you mean 'kalibr'"):
        read_calibration(path, "calibr")
    with pytest.raises(UnknownNameError, match="palvio_up"):
        builtin_calibration("palvio")


@pytest.mark.parametrize("format", sorted(WRITTEN))
def test_damaged_files_never_crash(tmp_path: Path, format: str) -> None:
    """Cut, duplicated and altered characters give a camera or a CalibrationError, nothing else."""
    path = tmp_path / "x.yaml"
    model = "pal" if format in ("ocamcalib", "lfvio") else "fisheye"
    camera = builtin_calibration("palvio_up") if model == "pal" else EXAMPLES[model]
    write_calibration(camera, path, format)
    good = path.read_text()

    @settings(QUICK, max_examples=80)
    @given(
        st.integers(0, len(good)),
        st.integers(0, 30),
        st.one_of(st.text(max_size=4), st.sampled_from(["1e999", ".nan", "-", "[", "{", ": ", "\n", "\t", "!!map "])),
    )
    def check(start: int, length: int, insert: str) -> None:
        path.write_text(good[:start] + insert + good[start + length :], encoding="utf-8", errors="replace")
        message = refusal(path, format)
        assert message is None or (str(path) in message and "\n" not in message)

    check()


def test_keys_of_several_kinds_are_refused_in_one_line() -> None:
    from panobench.cameras.erp import ErpCamera

    with pytest.raises(CalibrationError, match="unknown value '7'"):
        ErpCamera.from_dict({"model": "erp", "width": 20, "height": 10, 7: 1, "hfov": 10})
