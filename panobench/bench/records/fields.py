"""Dataclasses read from and written to JSON files that anybody may have written.

Reading never raises for a value of the wrong type: the field's default stands instead. What a class does not know is
kept in ``other`` and written back, so that a newer version's file survives being read and written by an older one.
"""

from __future__ import annotations

import math
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache
from typing import Any, TypeVar, cast

R = TypeVar("R", bound="JsonRecord")
#: Sums and squares of larger numbers overflow; nothing that is measured comes near.
LARGEST = 1e100
#: What ``fit`` answers when a value does not fit.
UNFIT = object()


def optional() -> Any:
    """A field that is None by default and then left out of the file."""
    return field(default=None, metadata={"optional": True})


@dataclass
class JsonRecord:
    """Base of the records. A subclass is a dataclass whose fields all have defaults."""

    other: dict[str, Any] = field(default_factory=dict, kw_only=True)

    @classmethod
    def from_dict(cls: type[R], values: Any) -> R:
        """The record that ``values``, from a file, describe; defaults where they do not fit."""
        known = _hints(cast(Any, cls))
        given = values if isinstance(values, Mapping) else {}
        taken = {name: fit(given[name], hint) for name, hint in known.items() if name in given}
        other = {str(k): v for k, v in given.items() if k not in known}
        return cls(**{k: v for k, v in taken.items() if v is not UNFIT}, other=other)

    def to_dict(self) -> dict[str, Any]:
        """For JSON: the fields in their order, then what was not known."""
        values: dict[str, Any] = {}
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name == "other" or (value is None and f.metadata.get("optional")):
                continue
            values[f.name] = value.to_dict() if isinstance(value, JsonRecord) else value
        return {**values, **self.other}


@lru_cache(maxsize=64)
def _hints(cls: Any) -> dict[str, Any]:
    hints = typing.get_type_hints(cls)
    return {f.name: hints[f.name] for f in fields(cls) if f.name != "other"}


def number(value: Any) -> float | None:
    """``value`` if it is a finite number below ``LARGEST``, else None."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return float(value) if abs(value) <= LARGEST and math.isfinite(value) else None


def fit(value: Any, hint: Any) -> Any:
    """``value`` as ``hint``, or UNFIT."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any:
        return value
    if origin in (typing.Union, types.UnionType):
        if value is None:
            return None
        found = fit(value, next(a for a in args if a is not type(None)))
        return None if found is UNFIT else found
    if isinstance(origin, type) and issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            return UNFIT
        return {str(k): v for k, inner in value.items() if (v := fit(inner, args[1])) is not UNFIT}
    if origin is list:
        if not isinstance(value, list):
            return UNFIT
        return [v for inner in value if (v := fit(inner, args[0])) is not UNFIT]
    if is_dataclass(hint):
        return cast("type[JsonRecord]", hint).from_dict(value) if isinstance(value, Mapping) else UNFIT
    if hint is float:
        return UNFIT if (found := number(value)) is None else found
    if hint is int:
        found = number(value)
        return UNFIT if found is None or found != int(found) else int(found)
    return value if isinstance(value, hint) else UNFIT
