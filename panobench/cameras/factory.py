"""Cameras from plain values and from the options `--camera` and `--to`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from panobench.cameras.base import Array, Camera
from panobench.cameras.views import PAPER_FOV_DEG, upright_rotation, view_rotation
from panobench.errors import CalibrationError, UnknownNameError, UnsupportedError, UsageError


class CameraChoice(NamedTuple):
    """A target camera, its rotation from the source's axes, and a name for files and reports."""

    camera: Camera
    R_target_source: Array
    label: str


def camera_from_dict(values: dict[str, Any]) -> Camera:
    """The camera of which ``to_dict`` gave the values; "model" is any registered camera. Raises CalibrationError."""
    from panobench.plugins import registry
    from panobench.specs import CameraSpec

    if not isinstance(values, dict):
        raise CalibrationError(f"a camera is a table of values, not {type(values).__name__}")
    model = values.get("model")
    if not isinstance(model, str):
        raise CalibrationError("a camera needs a 'model', for example erp or pinhole")
    specs = registry().specs(CameraSpec)
    if model not in specs:
        raise CalibrationError(str(UnknownNameError("camera model", model, specs)))
    camera: Camera = specs[model].load().from_dict(values)
    return camera


def parse_fov(text: str | float | tuple[float, float] | None) -> tuple[float, float | None] | None:
    """Horizontal and vertical field of view, degrees, of "120" or "120x60"; None for what is not given."""
    if text is None:
        return None
    parts = text.lower().split("x") if isinstance(text, str) else np.atleast_1d(text).tolist()
    try:
        values = [float(p) for p in parts]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(0 < v <= 360 for v in values):
        raise UsageError(f"a field of view is written 120 or 120x60 (degrees, at most 360), not '{text}'")
    return values[0], values[1] if len(values) == 2 else None


def parse_camera_option(
    option: str,
    source: Camera,
    width: int | None = None,
    fov: str | float | tuple[float, float] | None = None,
) -> CameraChoice:
    """What `--camera` means for a source: MODEL, MODEL:VIEW or a calibration file (FILE#CAMERA for one of several).

    VIEW is front, left, right, back, up, down or LON,LAT in degrees, relative to the upright source; ``width`` in
    pixels defaults to what keeps the source's angular resolution in the middle; ``fov`` is "120" or "120x60" degrees.
    The source's own model without a view, width or field of view is the source itself.
    Raises UnknownNameError, UsageError, UnsupportedError; CalibrationError for a file that cannot be used.
    """
    from panobench.cameras.calibration import calibration_file

    angles = parse_fov(fov)
    file = calibration_file(option)
    if file is not None:
        return _from_file(file, source, width, angles)
    model, _, view = option.partition(":")
    maker = _MAKERS.get(model)
    if maker is None:
        return _registered(model, source, width)
    if model == source.kind and not view and angles is None:
        return CameraChoice(source if width is None else source.scaled(width), np.eye(3), model)
    R_view = view_rotation(view or ("up" if model == "pal" else "front"))
    camera = maker(source, width, angles)
    return CameraChoice(camera, R_view @ upright_rotation(source), f"{model}-{view}" if view else model)


def pixels_per_radian(camera: Camera) -> float:
    """Angular resolution of a typical pixel: 1 / sqrt(median solid angle)."""
    step = camera.width_step
    small = camera if camera.width <= 256 else camera.scaled(max(1, 256 // step) * step)
    area = small.solid_angle()
    return float(camera.width / small.width / np.sqrt(np.median(area[area > 0])))


def _erp(source: Camera, width: int | None, fov: tuple[float, float | None] | None) -> Camera:
    from panobench.cameras.erp import ErpCamera

    if width is None:
        # The largest power of two that does not exceed the source's resolution.
        width = 1 << max(6, int(np.log2(2 * np.pi * pixels_per_radian(source) * 1.05)))
    if width % 2:
        raise UsageError(f"a panorama's width must be even, not {width}")
    horizontal, vertical = fov or (360.0, None)
    half = 90.0 if vertical is None else vertical / 2
    if half > 90:
        raise UsageError(f"a panorama's vertical field of view is at most 180 degrees, not {2 * half:g}")
    return ErpCamera(width, width // 2, horizontal, -half, half)


def _pinhole(source: Camera, width: int | None, fov: tuple[float, float | None] | None) -> Camera:
    from panobench.cameras.pinhole import PinholeCamera

    horizontal, vertical = fov or PAPER_FOV_DEG
    if horizontal >= 180 or (vertical or 0) >= 180:
        raise UnsupportedError(f"a pinhole view covers less than 180 degrees, not {fov}; use erp or fisheye")
    if vertical is None:  # the paper's aspect
        vertical = horizontal * PAPER_FOV_DEG[1] / PAPER_FOV_DEG[0]
    if width is None:
        width = _multiple(2 * np.tan(np.deg2rad(horizontal) / 2) * pixels_per_radian(source), 16)
    return PinholeCamera.from_fov(width, horizontal, vertical)


def _fisheye(source: Camera, width: int | None, fov: tuple[float, float | None] | None) -> Camera:
    """An equidistant fisheye, by default of 190 degrees across the image circle."""
    from panobench.cameras.kannala_brandt import KannalaBrandtCamera

    cone = 190.0 if fov is None else fov[0]
    if fov is not None and fov[1] not in (None, cone):
        raise UsageError("a fisheye's field of view is a cone: give one angle")
    if width is None:
        width = _multiple(np.deg2rad(cone) * pixels_per_radian(source), 16)
    return KannalaBrandtCamera.equidistant(width, cone)


def _cubemap(source: Camera, width: int | None, fov: tuple[float, float | None] | None) -> Camera:
    from panobench.cameras.cubemap import CubemapCamera

    if fov is not None:
        raise UsageError("a cubemap covers the full sphere; it takes no field of view")
    if width is None:
        width = 6 * _multiple(2 * pixels_per_radian(source), 16)
    if width % 6:
        raise UsageError(f"a cubemap's width is six faces, so a multiple of 6, not {width}")
    return CubemapCamera(width, width // 6)


def _pal(source: Camera, width: int | None, fov: tuple[float, float | None] | None) -> Camera:
    """PALVIO's upward camera with its mask, as the paper makes annular images of panoramas."""
    from panobench.cameras.calibration import builtin_calibration

    if fov is not None:
        raise UsageError("an annular lens has the field of view of its calibration; give a calibration file instead")
    camera = builtin_calibration("palvio_up")
    return camera if width is None else camera.scaled(width)


def _multiple(value: float, step: int) -> int:
    return max(1, round(value / step)) * step


def _registered(model: str, source: Camera, width: int | None) -> CameraChoice:
    """The source's own model; any other that needs a calibration is refused."""
    from panobench.plugins import registry
    from panobench.specs import CameraSpec

    registry().get(CameraSpec, model)
    if model != source.kind:
        raise UnsupportedError(
            f"'{model}' has no standard parameters: name a calibration file instead, or one of {', '.join(_MAKERS)}"
        )
    return CameraChoice(source if width is None else source.scaled(width), np.eye(3), model)


def _from_file(file: str, source: Camera, width: int | None, fov: tuple[float, float | None] | None) -> CameraChoice:
    from panobench.cameras.calibration import read_calibration, split_choice

    if fov is not None:
        raise UsageError("a field of view cannot be given together with a calibration file")
    camera = read_calibration(file)
    path, chosen = split_choice(file)
    R = upright_rotation(camera).T @ upright_rotation(source)
    return CameraChoice(
        camera if width is None else camera.scaled(width), R, f"{path.stem}-{chosen}" if chosen else path.stem
    )


_MAKERS: dict[str, Callable[[Camera, int | None, tuple[float, float | None] | None], Camera]] = {
    "erp": _erp,
    "pal": _pal,
    "pinhole": _pinhole,
    "fisheye": _fisheye,
    "cubemap": _cubemap,
}
