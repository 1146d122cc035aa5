"""Layouts by the names that `--layout` takes."""

from __future__ import annotations

from collections.abc import Callable

from panobench.errors import UnknownNameError, UsageError
from panobench.layouts.cells import CUBE_1X6, CUBE_3X2, CUBE_6X1, CUBE_CROSS, CUBE_STRIP, EAC, Panorama, TwoFisheyes
from panobench.layouts.layout import Layout

AUTO = "auto"
#: The left eye's picture, of the sphere in front alone.
HALF = Panorama((0.25, 0.0, 0.75, 1.0))
_LEFT, _TOP = (0.0, 0.0, 0.5, 1.0), (0.0, 0.0, 1.0, 0.5)

LAYOUTS: dict[str, tuple[str, Callable[[], Layout]]] = {
    "erp": ("one full panorama, stretched to 2:1 if it has other proportions", lambda: Layout("erp")),
    "top-bottom": ("two panoramas, one per eye; the upper one is used", lambda: Layout("top-bottom", part=_TOP)),
    "left-right": ("two panoramas, one per eye; the left one is used", lambda: Layout("left-right", part=_LEFT)),
    "vr180": ("half panoramas of two eyes side by side; the left one", lambda: Layout("vr180", HALF, _LEFT)),
    "half": ("one half panorama: 180 degrees", lambda: Layout("half", HALF)),
    "eac": ("equi-angular cubemap, 3x2 (YouTube, GoPro)", lambda: Layout("eac", EAC)),
    "cube-3x2": ("cubemap: right left up, down front back", lambda: Layout("cube-3x2", CUBE_3X2)),
    "cube-6x1": ("cubemap in a row: right left up down front back", lambda: Layout("cube-6x1", CUBE_6X1)),
    "cube-1x6": ("the same in a column", lambda: Layout("cube-1x6", CUBE_1X6)),
    "cube-strip": ("cubemap in a row: front right back left up down", lambda: Layout("cube-strip", CUBE_STRIP)),
    "cube-cross": ("cubemap as a lying cross", lambda: Layout("cube-cross", CUBE_CROSS)),
    "fisheyes": ("two ideal fisheye circles; fisheyes:DEGREES from rim to rim", lambda: two_fisheyes(190.0)),
}


def two_fisheyes(rim_deg: float) -> Layout:
    """Two circles side by side, as ideal lenses."""
    return Layout(
        "fisheyes",
        TwoFisheyes(rim_deg),
        remark=f"two fisheye circles are taken for ideal lenses of {rim_deg:g} degrees; "
        "a calibration (data set insta360-dual-fisheye) is more exact",
    )


def layout_named(option: str) -> Layout:
    """The layout of `--layout NAME[:DEGREES]`. Raises UnknownNameError or UsageError."""
    name, colon, argument = option.partition(":")
    if name not in LAYOUTS:
        raise UnknownNameError("layout", name, [AUTO, *LAYOUTS])
    if not colon:
        return LAYOUTS[name][1]()
    try:
        degrees = float(argument)
    except ValueError:
        degrees = 0.0
    if name != "fisheyes" or not 120 <= degrees <= 280:
        raise UsageError(f"--layout {option}: only fisheyes takes a number, 120 to 280 degrees")
    return two_fisheyes(degrees)
