"""YAML of the camodocal family (VINS-Mono, LF-VIO, LF-VISLAM): scaramuzza, PINHOLE, KANNALA_BRANDT and MEI.

Pixels count from 0 at the first pixel's centre; cx is the column, cy the row. LF-VIO adds the valid ring of its
annular lens (center_x, center_y, min_r, max_r), which becomes the mask; extrinsics and time offset are read too.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from panobench.cameras.base import Array, Camera
from panobench.cameras.calibration.annulus import annulus_mask, fit_inverse, require_agreement
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import Table, parse_yaml, read_text, write_text
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.mei import MeiCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.scaramuzza import ScaramuzzaCamera
from panobench.errors import CalibrationError, UnsupportedError
from panobench.geometry import make_pose, renormalise

NAME = "lfvio"
_POLY, _INVERSE = 5, 20  # sizes fixed by the format


def recognise(path: Path, text: str) -> bool:
    return "model_type" in text and "image_width" in text


def read(path: Path, options: ReadOptions) -> Calibration:
    """Raises CalibrationError naming the line, or the radius where the two polynomials disagree."""
    table = parse_yaml(read_text(path), path)
    model = str(table.need("model_type")).lower()
    width, height = table.number("image_width"), table.number("image_height")
    notes: list[str] = []
    try:
        if model == "scaramuzza":
            camera, notes = _scaramuzza(table, width, height, options)
        elif model in _READERS:
            camera = _READERS[model](table, width, height)
        else:
            known = ", ".join(["scaramuzza", *_READERS])
            raise table.error(f"model_type '{table['model_type']}' is not known here; known: {known}", "model_type")
    except CalibrationError as error:
        raise (error if error.path else table.error(str(error))) from None
    offset = table.number("td") if "td" in table else None
    return Calibration(camera, NAME, notes, _extrinsics(table), offset)


def _scaramuzza(table: Table, width: Any, height: Any, options: ReadOptions) -> tuple[Camera, list[str]]:
    affine = table.table("affine_parameters")
    camera = ScaramuzzaCamera(
        width,
        height,
        _coefficients(table.table("poly_parameters")),
        affine.number("cx") + 0.5,
        affine.number("cy") + 0.5,
        _coefficients(table.table("inv_poly_parameters")) if "inv_poly_parameters" in table else (),
        affine.number("ac", 1.0),
        affine.number("ad", 0.0),
        affine.number("ae", 0.0),
    )
    annulus, mask = options.annulus, None
    if "min_r" in table and "max_r" in table:
        centre = table.number("center_x", camera.cx - 0.5) + 0.5, table.number("center_y", camera.cy - 0.5) + 0.5
        low, high = table.number("min_r"), table.number("max_r")
        if not 0 <= low < high:
            raise table.error(f"0 <= min_r < max_r expected, not {low:g} and {high:g}", "min_r")
        mask = annulus_mask(camera.width, camera.height, centre, low, high)
        aside = float(np.hypot(centre[0] - camera.cx, centre[1] - camera.cy))
        annulus = annulus or (max(low - aside, 0.0), high + aside)
    line = table.lines.get("inv_poly_parameters")
    notes = require_agreement(camera, table.path, line, annulus)
    if options.annulus:
        camera = replace(camera, r_min=options.annulus[0], r_max=options.annulus[1])
    return camera.with_mask(mask), notes


def _coefficients(table: Table) -> tuple[float, ...]:
    """p0, p1, ... without the zeros that pad them."""
    known = {f"p{i}" for i in range(64)}
    for key in table:
        if key not in known:
            raise table.error(f"coefficients are named p0, p1, ..., not '{key}'", key)
    values = [table.number(f"p{i}") for i in range(len(table))]
    while len(values) > 1 and values[-1] == 0:
        values.pop()
    return tuple(values)


def _radtan(table: Table) -> tuple[float, ...]:
    if "distortion_parameters" not in table:
        return ()
    d = table.table("distortion_parameters")
    k = tuple(d.number(name) for name in ("k1", "k2", "p1", "p2"))
    return k if any(k) else ()


def _pinhole(table: Table, width: Any, height: Any) -> Camera:
    p = table.table("projection_parameters")
    numbers = (p.number("fx"), p.number("fy"), p.number("cx") + 0.5, p.number("cy") + 0.5)
    return PinholeCamera(width, height, *numbers, _radtan(table))


def _fisheye(table: Table, width: Any, height: Any) -> Camera:
    p = table.table("projection_parameters")
    k = tuple(p.number(f"k{i}") for i in (2, 3, 4, 5))
    return KannalaBrandtCamera(
        width, height, p.number("mu"), p.number("mv"), p.number("u0") + 0.5, p.number("v0") + 0.5, k
    )


def _mei(table: Table, width: Any, height: Any) -> Camera:
    p = table.table("projection_parameters")
    xi = table.table("mirror_parameters").number("xi")
    numbers = (p.number("gamma1"), p.number("gamma2"), p.number("u0") + 0.5, p.number("v0") + 0.5)
    return MeiCamera(width, height, *numbers, xi, _radtan(table))


_READERS = {"pinhole": _pinhole, "kannala_brandt": _fisheye, "mei": _mei}


def _extrinsics(table: Table) -> Array | None:
    """body_T_cam from the OpenCV matrices extrinsicRotation and extrinsicTranslation, or body_T_cam0."""
    if "body_T_cam0" in table:
        T = np.array(table.table("body_T_cam0").numbers("data", 16)).reshape(4, 4)
        R, t, key = T[:3, :3], T[:3, 3], "body_T_cam0"
    elif "extrinsicRotation" in table and "extrinsicTranslation" in table:
        R = np.array(table.table("extrinsicRotation").numbers("data", 9)).reshape(3, 3)
        t = np.array(table.table("extrinsicTranslation").numbers("data", 3))
        key = "extrinsicRotation"
    else:
        return None
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-2) or np.linalg.det(R) < 0:
        raise table.error(f"'{key}' is not a rotation", key)
    return renormalise(make_pose(R, t))


def write(camera: Camera, path: Path) -> None:
    """Raises UnsupportedError for models the format does not have."""
    head = [f"image_width: {camera.width}", f"image_height: {camera.height}"]
    if isinstance(camera, ScaramuzzaCamera):
        kind, body = "scaramuzza", _scaramuzza_lines(camera)
    elif isinstance(camera, (PinholeCamera, MeiCamera)):
        if len(camera.distortion) > 4 and any(camera.distortion[4:]):
            raise UnsupportedError("this YAML holds four distortion coefficients (k1 k2 p1 p2) only")
        k = (*camera.distortion[:4], 0.0, 0.0, 0.0, 0.0)[:4]
        body = _section("distortion_parameters", dict(zip(("k1", "k2", "p1", "p2"), k)))
        numbers = (camera.fx, camera.fy, camera.cx - 0.5, camera.cy - 0.5)
        if isinstance(camera, PinholeCamera):
            kind = "PINHOLE"
            body += _section("projection_parameters", dict(zip(("fx", "fy", "cx", "cy"), numbers)))
        else:
            kind = "MEI"
            body += _section("mirror_parameters", {"xi": camera.xi})
            body += _section("projection_parameters", dict(zip(("gamma1", "gamma2", "u0", "v0"), numbers)))
    elif isinstance(camera, KannalaBrandtCamera):
        kind = "KANNALA_BRANDT"
        values = (*camera.k, camera.fx, camera.fy, camera.cx - 0.5, camera.cy - 0.5)
        body = _section("projection_parameters", dict(zip(("k2", "k3", "k4", "k5", "mu", "mv", "u0", "v0"), values)))
    else:
        raise UnsupportedError(f"this YAML holds pal, pinhole, fisheye or omni cameras, not {camera.kind}")
    lines = ["%YAML:1.0", "---", f"model_type: {kind}", "camera_name: panobench", *head, *body]
    write_text(path, "\n".join(lines) + "\n")


def _scaramuzza_lines(camera: ScaramuzzaCamera) -> list[str]:
    inverse = fit_inverse(camera)
    if len(camera.poly) > _POLY or len(inverse) > _INVERSE:
        raise UnsupportedError(f"this YAML holds {_POLY} direct and {_INVERSE} inverse coefficients at most")
    padded = {"poly_parameters": (camera.poly, _POLY), "inv_poly_parameters": (inverse, _INVERSE)}
    lines = []
    for name, (values, size) in padded.items():
        full = (*values, *([0.0] * (size - len(values))))
        lines += _section(name, {f"p{i}": v for i, v in enumerate(full)})
    affine = {"ac": camera.c, "ad": camera.d, "ae": camera.e, "cx": camera.cx - 0.5, "cy": camera.cy - 0.5}
    lines += _section("affine_parameters", affine)
    if camera.r_max is not None:
        ring = {"center_x": affine["cx"], "center_y": affine["cy"], "min_r": camera.r_min, "max_r": camera.r_max}
        lines += [f"{k}: {v!r}" for k, v in ring.items()]
    return lines


def _section(name: str, values: dict[str, float]) -> list[str]:
    # OpenCV's reader wants a sign in exponents and a point in every real number: repr gives both.
    return [f"{name}:", *(f"   {k}: {float(v)!r}" for k, v in values.items())]
