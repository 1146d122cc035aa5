"""What the built-in models share: immutability, masks, comparison, scaling, and strict reading of plain values."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Array, Camera
from panobench.errors import CalibrationError, UsageError

C = TypeVar("C", bound="ParametricCamera")

#: Larger than any sensor: a bigger number in a file is a mistake.
MAX_SIDE = 65536
MAX_PIXELS = 200_000_000


@dataclass(frozen=True, eq=False)
class ParametricCamera(Camera):
    """A camera made of plain numbers (dataclass fields) and an optional mask.

    Subclasses are frozen dataclasses; ``to_dict`` and ``from_dict`` follow from their fields. Two cameras are equal
    when their class, numbers and masks are.
    """

    width: int
    height: int
    mask: NDArray[np.bool_] | None = dataclasses.field(default=None, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if not _is_whole(value) or not 0 < value <= MAX_SIDE:
                raise CalibrationError(
                    f"{self.kind} camera: {name} must be a whole number from 1 to {MAX_SIDE}, not {value!r}"
                )
            object.__setattr__(self, name, int(value))
        if self.width * self.height > MAX_PIXELS:
            raise CalibrationError(
                f"{self.kind} camera: {self.width}x{self.height} is over {MAX_PIXELS // 1_000_000} million pixels"
            )
        if self.mask is not None:
            mask = np.array(self.mask, dtype=bool)
            if mask.shape != (self.height, self.width):
                raise CalibrationError(
                    f"the mask is {'x'.join(map(str, mask.shape[::-1]))}, the camera {self.width}x{self.height}"
                )
            mask.flags.writeable = False
            object.__setattr__(self, "mask", mask)
        lists = {f.name for f in dataclasses.fields(self) if "tuple" in str(f.type)}
        for name, value in self._numbers().items():
            if name in ("width", "height") or value is None:
                continue
            several = isinstance(value, (tuple, list, np.ndarray))
            if several != (name in lists):
                what = "a list of numbers" if name in lists else "a number"
                raise CalibrationError(f"{self.kind} camera: {name} must be {what}, not {value!r}")
            try:
                number = tuple(float(v) for v in value) if several else float(value)
            except (TypeError, ValueError):
                raise CalibrationError(f"{self.kind} camera: {name} must be a number, not {value!r}") from None
            if not np.isfinite(number).all():
                raise CalibrationError(f"{self.kind} camera: {name} must be finite, not {value!r}")
            object.__setattr__(self, name, number)

    def _numbers(self) -> dict[str, Any]:
        """The model's fields except the mask, in order."""
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self) if f.name != "mask"}

    def with_mask(self: C, mask: NDArray[np.bool_] | None) -> C:
        return dataclasses.replace(self, mask=mask)

    def scaled(self: C, width: int) -> C:
        height = max(1, round(self.height * width / self.width))
        if width == self.width:
            return self
        if width < 1:
            raise UsageError(f"a camera cannot be {width} pixels wide")
        mask = None if self.mask is None else resize_mask(self.mask, width, height)
        changes = self._scaled_numbers(width / self.width, height / self.height)
        return dataclasses.replace(self, width=width, height=height, mask=mask, **changes)

    def _scaled_numbers(self, sx: float, sy: float) -> dict[str, Any]:
        """The fields that change when the image's width and height are multiplied by ``sx`` and ``sy``."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        values = {k: _plain(v) for k, v in self._numbers().items() if v is not None}
        return {"model": self.kind, **values}

    @classmethod
    def from_dict(cls: type[C], values: dict[str, Any]) -> C:
        known = {f.name: f for f in dataclasses.fields(cls) if f.name != "mask"}
        given = {k: v for k, v in values.items() if k != "model"}
        if values.get("model", cls.kind) != cls.kind:
            raise CalibrationError(f"expected a {cls.kind} camera, found model {values['model']!r}")
        unknown = sorted(map(str, set(given) - set(known)))  # YAML has keys of any kind
        if unknown:
            raise CalibrationError(f"{cls.kind} camera: unknown value '{unknown[0]}'; known: {', '.join(known)}")
        missing = [
            n
            for n, f in known.items()
            if n not in given and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
        ]
        if missing:
            raise CalibrationError(f"{cls.kind} camera: '{missing[0]}' is missing")
        try:
            return cls(**{k: _typed(k, v) for k, v in given.items()})
        except (TypeError, ValueError, OverflowError) as error:
            raise CalibrationError(f"{cls.kind} camera: {error}") from error

    def __eq__(self, other: object) -> bool:
        if type(other) is not type(self) or self._numbers() != other._numbers():  # type: ignore[attr-defined]
            return False
        a, b = self.mask, other.mask  # type: ignore[attr-defined]
        return a is b or (a is not None and b is not None and np.array_equal(a, b))

    def __hash__(self) -> int:
        return hash((type(self), *self._numbers().values(), None if self.mask is None else self.mask.tobytes()))

    def _inside(self, u: Array, v: Array) -> NDArray[np.bool_]:
        """Whether pixels are inside the image: 0 <= u < W and 0 <= v < H; False for NaN."""
        return np.asarray((u >= 0) & (u < self.width) & (v >= 0) & (v < self.height))


def resize_mask(mask: NDArray[np.bool_], width: int, height: int) -> NDArray[np.bool_]:
    """A mask (H, W) at another size, by an area filter; a pixel is valid if at least 99% of it was."""
    import cv2

    method = cv2.INTER_AREA if width < mask.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(mask.astype(np.float32), (width, height), interpolation=method) > 0.99)


def as_points(points: ArrayLike) -> tuple[Array, Array, Array]:
    """x, y and z of points (..., 3) as float64 arrays (...,)."""
    p = np.asarray(points, dtype=np.float64)
    return p[..., 0], p[..., 1], p[..., 2]


def as_pixels(pixels: ArrayLike) -> tuple[Array, Array]:
    """u and v of pixels (..., 2) as float64 arrays (...,)."""
    p = np.asarray(pixels, dtype=np.float64)
    return p[..., 0], p[..., 1]


def stack_jacobian(du: tuple[Any, Any, Any], dv: tuple[Any, Any, Any]) -> Array:
    """The matrix (..., 2, 3) of six partial derivatives (...,)."""
    rows = [np.stack(np.broadcast_arrays(*d), axis=-1) for d in (du, dv)]
    return np.asarray(np.stack(rows, axis=-2), dtype=np.float64)


def quotient_jacobian(fx: float, fy: float, x: Array, y: Array, n: Array, dn: tuple[Array, Array, Array]) -> Array:
    """Jacobian of (fx x / n, fy y / n) for n(x, y, z) with gradient ``dn``."""
    i, i2 = 1 / n, 1 / (n * n)
    du = (fx * (i - x * dn[0] * i2), -fx * x * dn[1] * i2, -fx * x * dn[2] * i2)
    dv = (-fy * y * dn[0] * i2, fy * (i - y * dn[1] * i2), -fy * y * dn[2] * i2)
    return stack_jacobian(du, dv)


def normalised(rays: Array, valid: NDArray[np.bool_] | None = None) -> Array:
    """Unit rays (..., 3); NaN where not ``valid``."""
    with np.errstate(invalid="ignore", divide="ignore"):
        out = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    return out if valid is None else np.where(valid[..., None], out, np.nan)


def _is_whole(value: Any) -> bool:
    try:
        return not isinstance(value, bool) and int(value) == value
    except (TypeError, ValueError, OverflowError):
        return False


def _plain(value: Any) -> Any:
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    return value.item() if isinstance(value, np.generic) else value


def _typed(name: str, value: Any) -> Any:
    """A value from a file: a number, a string, or a list of numbers, which becomes a tuple."""
    if isinstance(value, (list, tuple)):
        return tuple(float(_typed(name, v)) for v in value)
    if isinstance(value, bool) or not isinstance(value, (int, float, str)):
        raise CalibrationError(f"'{name}' must be a number, not {value!r}")
    return value
