"""OCamCalib's `calib_results.txt`, in every order and sign found in the wild.

Five data lines: `N a0 a1 ...` (z = f(rho), ascending), `M b0 b1 ...` (rho(theta), ascending or descending), `row col`
(image centre from 0), `c d e`, `height width`. Native axes: x along the rows, y along the columns, a0 < 0, looking
along -z: turned here into x right, y down, z out of the lens. py-OCamCalib writes a0 > 0.
Scaramuzza, OCamCalib toolbox documentation (export_data).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from panobench.cameras.base import Camera
from panobench.cameras.calibration.annulus import (
    check_annulus,
    fit_inverse,
    require_agreement,
    worst_disagreement,
)
from panobench.cameras.calibration.result import Calibration, ReadOptions
from panobench.cameras.calibration.text import as_number, data_lines, read_text, write_text
from panobench.cameras.scaramuzza import ScaramuzzaCamera
from panobench.errors import CalibrationError, UnsupportedError

NAME = "ocamcalib"
_BLOCKS = ("direct polynomial", "inverse polynomial", "image centre", "affine parameters", "image size")


@dataclass(frozen=True)
class _Block:
    line: int
    values: list[float]


def recognise(path: Path, text: str) -> bool:
    """It starts with a line of numbers, the first of which counts the others; ``read`` says what is wrong with them."""
    words = next(iter(data_lines(text)), (0, [""]))[1]
    counts = words[0].isascii() and words[0].isdigit() and len(words[0]) < 3
    return counts and len(words) > 1 and all(w.lstrip("+-.").replace(".", "", 1)[:1].isdigit() for w in words)


def read(path: Path, options: ReadOptions) -> Calibration:
    """Raises CalibrationError naming the line, or the radius where the two polynomials disagree."""
    blocks = _read_blocks(path)
    poly = _polynomial(path, blocks[0], _BLOCKS[0])
    inverse = _polynomial(path, blocks[1], _BLOCKS[1])
    height, width = (int(v) if v == int(v) else 0 for v in blocks[4].values)
    if min(height, width) < 1:
        raise CalibrationError("the image size must be two whole numbers", path, line=blocks[4].line)
    notes = []
    if poly[0] > 0:
        poly = tuple(-p for p in poly)
        notes.append("direct polynomial with a positive constant term (py-OCamCalib): sign turned")
    row, column, swapped = _centre(blocks[2].values, height, width)
    if swapped:
        notes.append("image centre written as column, row")
    c, d, e = blocks[3].values
    try:
        native = ScaramuzzaCamera(height, width, poly, row + 0.5, column + 0.5, c=c, d=d, e=e)
        camera = swap_axes(native)
    except CalibrationError as error:
        raise CalibrationError(str(error), path) from None
    camera, how = _orient_inverse(camera, _swapped_inverse(inverse, c), options.annulus)
    notes += how + require_agreement(camera, path, blocks[1].line, options.annulus)
    if options.annulus:
        camera = replace(camera, r_min=options.annulus[0], r_max=options.annulus[1])
    return Calibration(camera, NAME, notes)


def write(camera: Camera, path: Path) -> None:
    """Native axes and signs, inverse polynomial ascending (fitted if the camera has none)."""
    if not isinstance(camera, ScaramuzzaCamera):
        raise UnsupportedError(f"an OCamCalib file holds a pal camera, not {camera.kind}")
    native = swap_axes(replace(camera, inv_poly=fit_inverse(camera), mask=None))
    rows: list[tuple[str, list[float]]] = [
        ("direct polynomial z = f(rho), ascending", [len(native.poly), *native.poly]),
        ("inverse polynomial rho(theta), ascending", [len(native.inv_poly), *native.inv_poly]),
        ("centre: row and column, from 0", [native.cx - 0.5, native.cy - 0.5]),
        ("affine parameters c, d, e", [native.c, native.d, native.e]),
        ("image size: height and width", [camera.height, camera.width]),
    ]
    text = "\n\n".join(f"#{title}\n\n" + " ".join(_format(v) for v in values) for title, values in rows)
    write_text(path, text + "\n")


def swap_axes(camera: ScaramuzzaCamera) -> ScaramuzzaCamera:
    """The same lens with image rows and columns exchanged: native to ours and back.

    [c d; e 1] becomes [1 e; d c] = c [1/c e/c; d/c 1], and radii c times as long keep the affine form.
    """
    k = camera.c
    return ScaramuzzaCamera(
        camera.height,
        camera.width,
        tuple(p * k ** (1 - i) for i, p in enumerate(camera.poly)),
        camera.cy,
        camera.cx,
        _swapped_inverse(camera.inv_poly, k),
        1 / k,
        camera.e / k,
        camera.d / k,
        camera.r_min * k,
        None if camera.r_max is None else camera.r_max * k,
    )


def _swapped_inverse(inverse: tuple[float, ...], c: float) -> tuple[float, ...]:
    return tuple(q * c for q in inverse)


def _read_blocks(path: Path) -> list[_Block]:
    rows = list(data_lines(read_text(path)))
    if len(rows) != len(_BLOCKS):
        line = rows[len(_BLOCKS)][0] if len(rows) > len(_BLOCKS) else None
        raise CalibrationError(
            f"five lines of numbers are expected ({', '.join(_BLOCKS)}), found {len(rows)}", path, line=line
        )
    blocks = []
    for (line, words), title, count in zip(rows, _BLOCKS, (None, None, 2, 3, 2)):
        values = [_number(w, title, path, line) for w in words]
        if count is not None and len(values) != count:
            raise CalibrationError(f"{title}: {count} numbers expected, found {len(values)}", path, line=line)
        blocks.append(_Block(line, values))
    return blocks


def _number(word: str, title: str, path: Path, line: int) -> float:
    return as_number(word, lambda message: CalibrationError(f"{title}: {message}", path, line=line))


def _polynomial(path: Path, block: _Block, title: str) -> tuple[float, ...]:
    count, *values = block.values
    if count != len(values):
        raise CalibrationError(
            f"{title}: announces {count:g} coefficients and has {len(values)}", path, line=block.line
        )
    if title == _BLOCKS[0] and (not values or values[0] == 0):
        raise CalibrationError(f"{title}: the constant term must not be zero", path, line=block.line)
    return tuple(values)


def _centre(values: list[float], height: int, width: int) -> tuple[float, float, bool]:
    """Row, column and whether they were swapped: only when that is clearly nearer the middle of the image."""
    a, b = values
    as_written = np.hypot(a / height - 0.5, b / width - 0.5)
    exchanged = np.hypot(b / height - 0.5, a / width - 0.5)
    swapped = bool(as_written > 0.1 and exchanged < 0.5 * as_written)
    return (b, a, True) if swapped else (a, b, False)


def _orient_inverse(
    camera: ScaramuzzaCamera, inverse: tuple[float, ...], annulus: tuple[float, float] | None
) -> tuple[ScaramuzzaCamera, list[str]]:
    """The camera with the inverse polynomial in the order and sign of theta that agree best with the direct one."""
    if not inverse:
        return camera, []
    low, high = check_annulus(camera, annulus)
    candidates = []
    for descending, flipped in itertools.product((False, True), repeat=2):
        q = inverse[::-1] if descending else inverse
        q = tuple(v * (-1) ** i for i, v in enumerate(q)) if flipped else q
        with_inverse = replace(camera, inv_poly=q)
        candidates.append((worst_disagreement(with_inverse, low, high)[0], descending, flipped, with_inverse))
    _, descending, flipped, best = min(candidates, key=lambda candidate: candidate[0])
    notes = [f"inverse polynomial in {'descending' if descending else 'ascending'} order"]
    if flipped:
        notes.append("inverse polynomial of the opposite elevation: sign of theta turned")
    return best, notes


def _format(value: float) -> str:
    return str(value) if isinstance(value, int) else repr(float(value))
