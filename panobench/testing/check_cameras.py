"""Conformance of camera models: round trips, derivatives, limits and calibration values."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from panobench.cameras.base import Camera
from panobench.errors import CalibrationError, PanobenchError
from panobench.specs import CameraSpec
from panobench.testing.conformance import Checks, Failed, Skipped, require, same_clean_error

ROUND_TRIP_PX = 1e-6
#: Typical built-in cameras, 128 px wide.
_TYPICAL: dict[str, dict[str, Any]] = {
    "pal": {
        "width": 128,
        "height": 96,
        "poly": [-24.45, 0.0, 0.0174861, -0.000175777, 0.00004475965],
        "cx": 64.5,
        "cy": 48.6,
        "r_min": 16.0,
        "r_max": 47.0,
    },
    "ds": {"width": 128, "height": 96, "fx": 38.0, "fy": 38.0, "cx": 64.2, "cy": 47.9, "xi": -0.2, "alpha": 0.57},
    "eucm": {"width": 128, "height": 96, "fx": 47.0, "fy": 47.0, "cx": 64.2, "cy": 47.9, "alpha": 0.6, "beta": 1.05},
    "omni": {"width": 128, "height": 96, "fx": 90.0, "fy": 90.0, "cx": 64.2, "cy": 47.9, "xi": 1.2},
    "cubemap": {"width": 192, "height": 32},
}


def example_camera(cls: Any, kind: str, width: int = 64) -> Camera | None:
    """A typical camera of a model: its own ``example(width)``, else from values every model might take; or None."""
    example = getattr(cls, "example", None)
    if example is not None:
        camera = example(width)
        if not isinstance(camera, Camera):
            raise Failed(f"example() returned a {type(camera).__name__}, not a Camera")
        return camera
    if kind in _TYPICAL:
        whole = width - width % 6 if kind == "cubemap" else width  # six square faces in a row
        return cls.from_dict({"model": kind, **_TYPICAL[kind]}).scaled(whole)  # type: ignore[no-any-return]
    for height, f in ((width // 2, 0.0), (width * 3 // 4, width * 0.7)):
        values: dict[str, Any] = {"model": kind, "width": width, "height": height}
        if f:
            values |= {"fx": f, "fy": f, "cx": width / 2, "cy": height / 2}
        try:
            built: Camera = cls.from_dict(values)
        except PanobenchError:
            continue
        return built
    return None


def camera_checks(spec: CameraSpec) -> Checks:
    """The checks of one camera model, on its ``example()``."""
    cls = spec.load()

    def camera() -> Camera:
        found = example_camera(cls, spec.name)
        if found is None:
            raise Skipped(f"give {spec.implementation} a classmethod example(width) that makes a typical camera")
        return found

    return [
        ("implementation", lambda: _implementation(cls, spec)),
        ("round trip", lambda: _round_trip(camera())),
        ("jacobian", lambda: _jacobian(camera())),
        ("points it cannot see", lambda: _limits(camera())),
        ("solid angle", lambda: _solid_angle(camera())),
        ("scaled", lambda: _scaled(camera())),
        ("mask", lambda: _mask(camera())),
        ("values", lambda: _values(camera())),
    ]


def _implementation(cls: Any, spec: CameraSpec) -> None:
    require(isinstance(cls, type) and issubclass(cls, Camera), f"{spec.implementation} is not a Camera")
    require(cls.kind == spec.name, f"its kind is '{cls.kind}', its spec is named '{spec.name}'")
    missing: frozenset[str] = getattr(cls, "__abstractmethods__", frozenset())
    require(not missing, f"it does not define {', '.join(sorted(missing))}")


def _round_trip(camera: Camera) -> str:
    pixels, valid = camera.pixel_grid(), camera.valid_mask()
    require(valid.any(), "no pixel of the example is valid")
    rays = camera.unproject(pixels)[valid]
    require(np.abs(np.linalg.norm(rays, axis=-1) - 1).max() < 1e-9, "unproject() does not return unit rays")
    back, ok = camera.project(rays * 3.7)
    require(ok.all(), f"{(~ok).sum()} valid pixels are invalid when their rays are projected")
    error = float(np.abs(back - pixels[valid]).max())
    require(error < ROUND_TRIP_PX, f"project(unproject(pixel)) is off by {error:.2g} px, allowed are {ROUND_TRIP_PX:g}")
    return f"largest error {error:.1g} px"


def _jacobian(camera: Camera) -> str:
    rng = np.random.default_rng(0)
    valid = np.argwhere(camera.valid_mask())
    rows = valid[rng.choice(len(valid), size=min(200, len(valid)), replace=False)]
    pixels = rows[:, ::-1] + 0.5
    edge = (pixels < 2).any(axis=1) | (pixels > [camera.width - 2, camera.height - 2]).any(axis=1)
    points = camera.unproject(pixels[~edge]) * rng.uniform(0.5, 5, size=(int((~edge).sum()), 1))
    analytic = np.asarray(camera.jacobian(points))
    require(analytic.shape == (len(points), 2, 3), f"jacobian has shape {analytic.shape}, must be (N, 2, 3)")
    worst = 0.0
    for axis in range(3):
        h = np.zeros(3)
        h[axis] = 1e-5
        (up, ok_up), (down, ok_down) = camera.project(points + h), camera.project(points - h)
        numeric = (up - down) / 2e-5
        error = np.abs(analytic[:, :, axis] - numeric) / (1 + np.abs(numeric))
        both = ok_up & ok_down
        worst = max(worst, float(error[both].max()) if both.any() else 0.0)
    require(worst < 1e-3, f"jacobian differs from finite differences by {worst:.2g} (relative)")
    return f"largest relative difference {worst:.1g}"


def _limits(camera: Camera) -> None:
    points = np.array([[0.0, 0, 0], [np.nan, 0, 1]])
    with np.errstate(all="ignore"):
        pixels, valid = camera.project(points)
    require(np.shape(pixels) == (2, 2) and np.shape(valid) == (2,), "project() does not keep the shape of its input")
    require(not np.any(valid), "the camera's centre and a NaN point must be invalid")


def _solid_angle(camera: Camera) -> str:
    omega = np.asarray(camera.solid_angle())
    require(omega.shape == (camera.height, camera.width), f"solid_angle() has shape {omega.shape}, not (H, W)")
    total = float(omega.sum())
    require((omega >= 0).all() and 0 < total < 4 * np.pi * 1.001, f"solid angles sum to {total:.4g} sr of 12.566")
    return f"covers {total:.3g} sr"


def _scaled(camera: Camera) -> None:
    double = camera.scaled(camera.width * 2)
    require(double.width == camera.width * 2, "scaled(2 W) is not 2 W wide")
    valid = camera.valid_mask()
    rays = camera.rays()[valid]
    pixels, ok = double.project(rays)
    factor = np.array([2.0, double.height / camera.height])
    error = np.abs(pixels - camera.pixel_grid()[valid] * factor)[ok]
    require(ok.mean() > 0.95 and error.max() < 1e-3, "scaled(2 W) sees other directions at the same places")


def _mask(camera: Camera) -> None:
    mask = np.ones((camera.height, camera.width), dtype=bool)
    mask[: camera.height // 2] = False
    valid = camera.with_mask(mask).valid_mask()
    require(not valid[: camera.height // 2].any(), "masked pixels are still valid")
    require(np.array_equal(valid, camera.with_mask(None).valid_mask() & mask), "the mask removes other pixels")


def _values(camera: Camera) -> None:
    values = camera.to_dict()
    require(values.get("model") == camera.kind, f"to_dict()['model'] is {values.get('model')!r}, not '{camera.kind}'")
    again = type(camera).from_dict(yaml.safe_load(yaml.safe_dump(values)))
    same = np.array_equal(again.rays(), camera.rays(), equal_nan=True)
    require(same, "from_dict(to_dict()) is another camera, or its values do not survive YAML")
    numbers = [k for k, v in values.items() if isinstance(v, float) or k == "width"]
    same_clean_error(
        lambda: type(camera).from_dict({k: v for k, v in values.items() if k != "width"}),
        CalibrationError,
        "from_dict without a width",
    )
    for key in numbers:
        broken = {**values, key: float("nan") if key != "width" else -5}
        same_clean_error(lambda b=broken: type(camera).from_dict(b), CalibrationError, f"from_dict with a bad {key}")  # type: ignore[misc]
    same_clean_error(
        lambda: type(camera).from_dict({**values, "no_such_value": 1}),
        CalibrationError,
        "from_dict with an unknown key",
    )
