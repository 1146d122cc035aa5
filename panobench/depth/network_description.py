"""A network's input and output as the YAML file beside its weights describes them (keys: docs/depth.md)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

from panobench.errors import InputError, UnknownNameError
from panobench.reading import parse_yaml, read_text

#: Longest side of an input, pixels.
MAX_SIDE = 8192
PROJECTIONS = ("erp", "image")
COLOURS = ("rgb", "bgr")
LAYOUTS = ("nchw", "nhwc")
#: What the output's values mean.
MEANINGS = ("distance", "inverse-distance", "log-distance", "z", "inverse-z")


@dataclass(frozen=True)
class NetworkInput:
    """What a network takes, and which of its outputs counts.

    width, height: input size in pixels. projection: "erp" (an upright panorama) or "image" (the camera's own image).
    centre_deg: longitude of the panorama's middle column, to the right of the forward axis.
    A pixel value v in 0..1 becomes (range v - mean) / std. colour: order of the channels. layout: order of the axes.
    output: name of the output, or its position from 0.
    """

    width: int
    height: int
    projection: str = "erp"
    centre_deg: float = 0.0
    colour: str = "rgb"
    range: float = 1.0
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    layout: str = "nchw"
    output: str | int = 0

    @property
    def input_shape(self) -> tuple[int, int, int, int]:
        """Shape of the input tensor, a batch of one image."""
        h, w = self.height, self.width
        return (1, 3, h, w) if self.layout == "nchw" else (1, h, w, 3)


Described = TypeVar("Described", bound=NetworkInput)
Check = Callable[[str, Any, Path], Any]


@dataclass(frozen=True)
class NetworkDescription(NetworkInput):
    """Input and output of a depth network.

    meaning: see MEANINGS. metric: the output times ``scale`` is in metres; otherwise depth is known up to scale only.
    far: larger distances, after ``scale``, are unknown.
    """

    meaning: str = "distance"
    metric: bool = False
    scale: float = 1.0
    far: float = math.inf


def description_path(network: Path) -> Path:
    """The description of ``model.onnx`` is ``model.yaml``."""
    return network.with_suffix(".yaml")


def read_description(network: Path) -> NetworkDescription:
    """Read the description beside ``network``. Raises InputError that names the file and the key."""
    return check_description(read_values(network, "docs/depth.md"), description_path(network))


def read_values(network: Path, page: str) -> Any:
    """What the YAML file beside ``network`` holds. page: where its keys are explained. Raises InputError."""
    path = description_path(network)
    if not path.is_file():
        raise InputError(
            f"the description of {network.name} is missing: write width, height, meaning, ... there ({page})", path
        )
    return parse_yaml(read_text(path, "the network's description"), path)


def check_description(values: Any, path: Path) -> NetworkDescription:
    """A description from plain values. Raises InputError for missing, unknown or impossible values."""
    d = described(NetworkDescription, values, path, _DEPTH_CHECKS)
    if d.projection == "erp" and d.meaning.endswith("z"):
        raise InputError(f"meaning '{d.meaning}' has no sense on a panorama, which has no image plane", path)
    return d


def described(kind: type[Described], values: Any, path: Path, checks: Mapping[str, Check]) -> Described:
    """A description of some kind from plain values; ``checks``: of the fields that ``NetworkInput`` has not.

    Raises InputError for missing, unknown or impossible values.
    """
    if not isinstance(values, Mapping):
        raise InputError("a network's description is a table of keys and values", path)
    known, all_checks = [f.name for f in fields(kind)], {**_INPUT_CHECKS, **checks}
    for key in values:
        if key not in known:
            raise InputError(str(UnknownNameError("key", str(key), known)), path)
    for key in ("width", "height"):
        if key not in values:
            raise InputError(f"'{key}' of the network's input is missing", path)
    d = kind(**{key: all_checks[key](key, value, path) for key, value in values.items()})
    if d.projection == "erp" and d.width != 2 * d.height:
        raise InputError(
            f"a panorama is twice as wide as high, not {d.width}x{d.height}; or set projection: image", path
        )
    return d


def _size(key: str, value: Any, path: Path) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 16 <= value <= MAX_SIDE:
        raise InputError(f"{key} must be a whole number from 16 to {MAX_SIDE}, not {value!r}", path)
    return value


def finite(key: str, value: Any, path: Path) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(_float(value)):
        raise InputError(f"{key} must be a number, not {value!r}", path)
    return float(value)


def _float(value: int | float) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf


def _positive(key: str, value: Any, path: Path) -> float:
    number = finite(key, value, path)
    if number <= 0:
        raise InputError(f"{key} must be positive, not {value!r}", path)
    return number


def _three(key: str, value: Any, path: Path) -> tuple[float, float, float]:
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{key} must be three numbers, one a channel, not {value!r}", path)
    check = _positive if key == "std" else finite
    a, b, c = (check(key, v, path) for v in value)
    return a, b, c


def _yes_no(key: str, value: Any, path: Path) -> bool:
    if not isinstance(value, bool):
        raise InputError(f"{key} must be true or false, not {value!r}", path)
    return value


def _output(key: str, value: Any, path: Path) -> str | int:
    name = isinstance(value, str) and value != ""
    if not name and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
        raise InputError(f"{key} must be the output's name, or its position counted from 0, not {value!r}", path)
    return str(value) if name else int(value)


def one_of(*choices: str) -> Check:
    def check(key: str, value: Any, path: Path) -> str:
        if not isinstance(value, str) or value not in choices:
            raise InputError(str(UnknownNameError(key, str(value), choices)), path)
        return value

    return check


_INPUT_CHECKS: dict[str, Check] = {
    "width": _size,
    "height": _size,
    "projection": one_of(*PROJECTIONS),
    "centre_deg": finite,
    "colour": one_of(*COLOURS),
    "range": _positive,
    "mean": _three,
    "std": _three,
    "layout": one_of(*LAYOUTS),
    "output": _output,
}
_DEPTH_CHECKS: dict[str, Check] = {
    "meaning": one_of(*MEANINGS),
    "metric": _yes_no,
    "scale": _positive,
    "far": _positive,
}
