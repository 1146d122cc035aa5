"""Argument types of compiled functions as text, in Numba's notation for signatures: ``(float32[:, ::1], int64,)``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def spell(types: Sequence[Any]) -> str | None:
    """What ``parse`` reads back as the same types; None where Numba's notation has no words for one of them."""
    words = [_spell(t) for t in types]
    return None if None in words else "(" + "".join(f"{word}, " for word in words).rstrip() + ")"


def parse(text: str) -> tuple[Any, ...]:
    """Numba types of a text made by ``spell``."""
    from numba.core.sigutils import normalize_signature

    args: tuple[Any, ...] = normalize_signature(text)[0]
    return args


def _spell(kind: Any) -> str | None:
    from numba import types

    if isinstance(kind, types.Array):
        if not (kind.mutable and kind.aligned):
            return None
        dtype = _spell(kind.dtype)
        places = [":"] * kind.ndim
        if kind.layout == "C":
            places[-1] = "::1"
        elif kind.layout == "F":
            places[0] = "::1"
        return None if dtype is None else f"{dtype}[{', '.join(places)}]"
    if isinstance(kind, types.UniTuple):
        dtype = _spell(kind.dtype)
        return None if dtype is None else f"UniTuple({dtype}, {kind.count})"
    if isinstance(kind, types.Boolean):
        return "boolean"
    if isinstance(kind, (types.Integer, types.Float)):
        return str(kind)
    if isinstance(kind, types.NoneType):
        return "none"
    if kind == types.npy_rng:
        return "npy_rng"
    if isinstance(kind, types.Omitted):
        return f"Omitted({kind.value!r})" if isinstance(kind.value, (bool, int, float)) else None
    return None
