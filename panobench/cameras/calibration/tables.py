"""Tables of values from any notation that calibrations are written in: YAML, JSON and OpenCV's XML."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from panobench.cameras.base import Array
from panobench.cameras.calibration.text import Table, parse_yaml, read_text
from panobench.errors import CalibrationError
from panobench.geometry import renormalise
from panobench.reading import number_array, parse_json

#: Elements within elements of an XML file; OpenCV writes four levels.
_MAX_DEPTH = 32


def read_table(path: Path) -> Table:
    """The top-level table of a YAML, JSON or OpenCV XML file. Raises CalibrationError."""
    text = read_text(path)
    start = text.lstrip()[:1]
    if start == "<":
        return parse_xml(text, path)
    if start == "{" and path.suffix.lower() == ".json":
        return as_table(parse_json(text, path, CalibrationError), path)
    return parse_yaml(text, path)


def as_table(values: Any, path: Path) -> Table:
    """Plain nested dicts as tables, which know their file but no lines."""
    if not isinstance(values, dict):
        raise CalibrationError("a table of values is expected", path)
    table = Table()
    table.path, table.lines = path, {}
    for key, value in values.items():
        table[str(key)] = as_table(value, path) if isinstance(value, dict) else value
    return table


def parse_xml(text: str, path: Path) -> Table:
    """OpenCV's ``<opencv_storage>``. Document types and entities, which could expand without bound, are refused."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise CalibrationError("XML with a document type or entities is not read", path)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise CalibrationError("not valid XML", path, line=error.position[0]) from None
    except (LookupError, ValueError):  # an encoding that does not exist
        raise CalibrationError("not valid XML", path) from None
    if root.tag != "opencv_storage":
        raise CalibrationError(f"XML with <opencv_storage> (OpenCV's FileStorage) is expected, not <{root.tag}>", path)
    value = _element(root, path, 0)
    if not isinstance(value, Table):
        raise CalibrationError("a table of values is expected", path)
    return value


def _element(element: ElementTree.Element, path: Path, depth: int) -> Any:
    """A table, a list (children named ``_``, or several words) or one word."""
    if depth > _MAX_DEPTH:
        raise CalibrationError("not a calibration: nested too deeply", path)
    children = list(element)
    if children and all(child.tag == "_" for child in children):
        return [_element(child, path, depth + 1) for child in children]
    if children:
        table = Table()
        table.path, table.lines = path, {}
        for child in children:
            if child.tag in table:
                raise CalibrationError(f"'{child.tag}' is given twice", path)
            value = _element(child, path, depth + 1)
            table[child.tag] = [value] if child.tag == "data" and not isinstance(value, list) else value
        return table
    words = [word.strip('"') for word in (element.text or "").split()]
    return words if len(words) > 1 else "".join(words)


def matrix(table: Table, key: str, rows: int | None = None, columns: int | None = None) -> Any:
    """The numbers under ``key``, an array of shape (rows, columns), or flat where a size is None.

    It may be an OpenCV matrix, a list of lists or a flat list. Raises CalibrationError.
    """
    value = table.need(key)
    if isinstance(value, Table):
        value = value.numbers("data")
    array = number_array(value) if isinstance(value, list) else number_array([])
    flat = array.reshape(-1)
    if not len(flat) and value != []:
        raise table.error(f"'{key}' must be a matrix of numbers", key)
    if rows is None or columns is None:
        return flat
    if len(flat) != rows * columns:
        raise table.error(f"'{key}' must have {rows}x{columns} numbers, not {len(flat)}", key)
    return flat.reshape(rows, columns)


def rigid(table: Table, key: str) -> Array:
    """The pose (4, 4) under ``key``, a 4x4 or 3x4 matrix. Raises CalibrationError unless it is a rigid motion."""
    flat = matrix(table, key)
    T = np.eye(4)
    if len(flat) in (12, 16):
        T[: len(flat) // 4] = flat.reshape(-1, 4)
    R = T[:3, :3]
    if len(flat) not in (12, 16) or not np.allclose(R @ R.T, np.eye(3), atol=1e-2) or np.linalg.det(R) < 0:
        raise table.error(f"'{key}' is not a rigid 4x4 matrix", key)
    return renormalise(T)
