"""OCamCalib's calib_results.txt in every order and sign that is found in the wild."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from camera_strategies import PALVIO_INVERSE, PALVIO_POLY

from panobench.cameras.calibration import (
    builtin_calibration,
    inspect_calibration,
    read_calibration,
    write_calibration,
)
from panobench.cameras.scaramuzza import ScaramuzzaCamera
from panobench.errors import CalibrationError


def ocamcalib_text(
    descending: bool = False,
    flipped: bool = False,
    theta_flipped: bool = False,
    swapped: bool = False,
    poly: Sequence[float] = PALVIO_POLY,
    affine: str = "1.0 0.0 0.0",
) -> str:
    poly = [-p for p in poly] if flipped else poly
    inverse = [q * (-1) ** i for i, q in enumerate(PALVIO_INVERSE)] if theta_flipped else PALVIO_INVERSE
    inverse = inverse[::-1] if descending else inverse
    centre = "645.107791 486.025172" if swapped else "486.025172 645.107791"
    lines = [f"5 {' '.join(map(repr, poly))} ", f"14 {' '.join(map(repr, inverse))}", centre, affine, "960 1280"]
    return "\n\n".join(f"# block {i}\n\n{line}" for i, line in enumerate(lines, 1)) + "\n"


@pytest.mark.parametrize(("descending", "flipped", "theta", "swapped"), list(itertools.product((0, 1), repeat=4)))
def test_ocamcalib_in_every_order_and_sign(
    tmp_path: Path, descending: int, flipped: int, theta: int, swapped: int
) -> None:
    path = tmp_path / "calib_results.txt"
    path.write_text(ocamcalib_text(bool(descending), bool(flipped), bool(theta), bool(swapped)))
    found = inspect_calibration(path)
    up = builtin_calibration("palvio_up")
    assert found.camera == up.with_mask(None)
    notes = " / ".join(found.notes)
    assert ("descending" in notes) == bool(descending)
    assert ("ascending" in notes) != bool(descending)
    assert ("positive constant term" in notes) == bool(flipped)
    assert ("sign of theta turned" in notes) == bool(theta)
    assert ("column, row" in notes) == bool(swapped)
    assert "agree to 0.0" in notes


def test_ocamcalib_native_axes(tmp_path: Path) -> None:
    """The native x axis runs along the rows: its affine matrix is that of (row, column)."""
    path = tmp_path / "calib_results.txt"
    path.write_text(ocamcalib_text(affine="1.01 0.02 -0.03"))
    camera = read_calibration(path)
    rho = 300.0
    z = -np.polynomial.polynomial.polyval(rho, PALVIO_POLY)  # out of the lens
    for phi in (0.3, 1.2, 2.9, -2.0):
        x, y = rho * np.cos(phi), rho * np.sin(phi)  # native: x along rows, y along columns
        row, column = 1.01 * x + 0.02 * y + 486.025172, -0.03 * x + y + 645.107791
        pixel, valid = camera.project([y, x, z])
        assert valid
        assert pixel == pytest.approx([column + 0.5, row + 0.5], abs=1e-6)
    write_calibration(camera, tmp_path / "again.txt", "ocamcalib")
    again = [float(v) for v in (tmp_path / "again.txt").read_text().split("affine")[1].split("\n\n")[1].split()]
    assert again == pytest.approx([1.01, 0.02, -0.03])


def test_a_fisheye_of_the_wild(tmp_path: Path) -> None:
    """A 1440x1440 action camera, calibrated with OCamCalib 3; numbers published in its owner's notes."""
    path = tmp_path / "calib_results.txt"
    path.write_text(
        "5 -2.716972e+02 0.000000e+00 -2.741744e-06 1.840940e-06 -8.024838e-10\n"
        "13 583.439624 470.805865 97.165132 120.712689 100.686168 55.067847 67.348203 15.186683 1.492255 84.459767"
        " 105.607698 48.090642 7.785426\n728.648728 729.090632\n1.001407 -0.000818 0.000221\n1440 1440\n"
    )
    found = inspect_calibration(path)
    assert isinstance(found.camera, ScaramuzzaCamera)
    assert any("ascending" in note for note in found.notes)
    assert np.rad2deg(found.camera.polar_angle(583.44 * found.camera.c)) == pytest.approx(90, abs=0.3)


def test_disagreeing_polynomials_name_the_radius(tmp_path: Path) -> None:
    """PALVIO's downward camera as printed upstream, with the sign error of its third-order coefficient."""
    down = builtin_calibration("palvio_down")
    assert isinstance(down, ScaramuzzaCamera)
    write_calibration(down, tmp_path / "good.yaml", "lfvio")
    assert read_calibration(tmp_path / "good.yaml") == down.with_mask(None)
    text = (tmp_path / "good.yaml").read_text().replace("-9.486697e-07", "9.486697e-07")
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises(
        CalibrationError, match=r"bad.yaml:\d+: .*disagree.* from r = 1[56]\d px .*inside the valid annulus"
    ):
        read_calibration(tmp_path / "bad.yaml")
    wrong = [*PALVIO_POLY[:3], -PALVIO_POLY[3], PALVIO_POLY[4]]
    (tmp_path / "calib_results.txt").write_text(ocamcalib_text(poly=wrong))
    with pytest.raises(CalibrationError, match=r"calib_results.txt:7: .*r = \d+ px"):
        read_calibration(tmp_path / "calib_results.txt")
    values = {**down.to_dict(), "poly": [-239.1784, 0.0, 1.55204e-3, 9.486697e-7, 3.552717e-9]}
    import yaml

    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(values))
    with pytest.raises(CalibrationError, match="disagree"):
        read_calibration(tmp_path / "camera.yaml")


def test_the_annulus_decides(tmp_path: Path) -> None:
    """PALVIO's inverse is only fitted from about 105 px outward: fine unless the annulus reaches further in."""
    path = tmp_path / "calib_results.txt"
    path.write_text(ocamcalib_text())
    camera = read_calibration(path, annulus=(160, 500))
    assert isinstance(camera, ScaramuzzaCamera)
    assert (camera.r_min, camera.r_max) == (160, 500)
    with pytest.raises(CalibrationError, match=r"from r = 60 px .*inside the valid annulus 60\.\.500"):
        read_calibration(path, annulus=(60, 500))
    assert any("blind centre" in note and "105 px" in note for note in inspect_calibration(path).notes)
