"""Options that say what they are: a default, one line of help, a unit and the values allowed.

A method's configuration is a frozen dataclass derived from ``Options``. Its fields are made by ``option``; a field
that holds another such dataclass is a stage, whose options ``--set`` reaches by dotted names::

    @dataclass(frozen=True)
    class TrackingOptions(Options):
        \"""Tracking of a frame against the map.\"""

        iterations: int = option(15, "steps of the solver per pyramid level", above=0)
        huber: float = option(1.0, "residual from which the loss is linear", unit="px", above=0)

    @dataclass(frozen=True)
    class MyConfig(Options):
        \"""General.\"""

        tracking: TrackingOptions = field(default_factory=TrackingOptions)

`panobench list methods NAME` prints them stage by stage. The first line of each class's docstring is the heading.
"""

from __future__ import annotations

import dataclasses
import difflib
import enum
import inspect
import math
import types
import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, cast

T = TypeVar("T")


class OptionError(ValueError):
    """A value that an option does not allow. ``option`` is its name within its own dataclass."""

    def __init__(self, name: str, problem: str) -> None:
        super().__init__(f"{name} {problem}")
        self.option, self.problem = name, problem


@dataclass(frozen=True)
class OptionMetadata:
    """What ``option`` keeps with a field. Bounds hold for numbers; ``above`` and ``below`` exclude the bound."""

    help: str
    unit: str = ""
    minimum: float | None = 0.0
    maximum: float | None = None
    above: float | None = None
    below: float | None = None

    def problem(self, value: Any) -> str | None:
        """Why ``value`` is not allowed, or None. Only numbers are judged; those in tuples and lists one by one."""
        if isinstance(value, (tuple, list)):
            return next((found for item in value if (found := self.problem(item)) is not None), None)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            return None
        within = (
            math.isfinite(value)
            and (self.minimum is None or value >= self.minimum)
            and (self.maximum is None or value <= self.maximum)
            and (self.above is None or value > self.above)
            and (self.below is None or value < self.below)
        )
        return None if within else f"must be a number{self.bounds(' ')}, not {value}"

    def bounds(self, before: str = "") -> str:
        """The bounds in words, "from 0 and below 1"; "" without any."""
        words = [
            f"{word} {bound:g}"
            for word, bound in (
                ("above", self.above),
                ("from", self.minimum if self.above is None else None),
                ("below", self.below),
                ("up to", self.maximum),
            )
            if bound is not None
        ]
        return before + " and ".join(words) if words else ""


def option(
    default: T,
    help: str,
    *,
    unit: str = "",
    minimum: float | None = 0.0,
    maximum: float | None = None,
    above: float | None = None,
    below: float | None = None,
) -> T:
    """A dataclass field with a default, one line of help and a unit.

    A number must be finite and within the bounds. ``minimum`` is 0 unless something else is said; None allows
    negative numbers. ``above`` and ``below`` are bounds that are not allowed themselves.
    """
    metadata = OptionMetadata(help, unit, minimum, maximum, above, below)
    return cast(T, dataclasses.field(default=default, metadata={"option": metadata}))


class Options:
    """Base of dataclasses with options: values out of their bounds raise OptionError when an object is made."""

    def __post_init__(self) -> None:
        for f in dataclasses.fields(cast(Any, self)):
            metadata = f.metadata.get("option")
            problem = metadata.problem(getattr(self, f.name)) if metadata is not None else None
            if problem is not None:
                raise OptionError(f.name, problem)


@dataclass(frozen=True)
class OptionDescription:
    """One option as `panobench list` shows it. ``name`` is dotted; ``stage`` is the heading it stands under."""

    name: str
    default: Any
    type: str
    unit: str
    help: str
    bounds: str
    stage: str


def describe_options(config: Any) -> list[OptionDescription]:
    """The options of a configuration object, stage by stage; those of a class come before those of its bases.

    Options without documentation (plain dataclass fields) have an empty ``help``.
    """
    return list(_describe(config, ""))


def _describe(config: Any, prefix: str) -> Iterator[OptionDescription]:
    hints = typing.get_type_hints(type(config))
    fields = [f for f in dataclasses.fields(config) if f.init]
    owners = {f.name: _owner(type(config), f.name) for f in fields}
    order = type(config).__mro__
    for f in sorted(fields, key=lambda f: order.index(owners[f.name])):
        value = getattr(config, f.name)
        if is_stage(value):
            continue
        metadata = f.metadata.get("option", OptionMetadata("", minimum=None))
        yield OptionDescription(
            prefix + f.name,
            value,
            type_words(hints.get(f.name, Any)),
            metadata.unit,
            metadata.help,
            metadata.bounds(),
            _heading(owners[f.name]),
        )
    for f in fields:
        if is_stage(getattr(config, f.name)):
            yield from _describe(getattr(config, f.name), f"{prefix}{f.name}.")


def is_stage(value: Any) -> bool:
    """True for a dataclass object: the options of a stage."""
    return dataclasses.is_dataclass(value) and not isinstance(value, type)


def option_names(config: Any) -> list[str]:
    """Every name that ``--set`` takes, dotted for the options of stages."""
    names = []
    for f in dataclasses.fields(config):
        value = getattr(config, f.name)
        if is_stage(value):
            names += [f"{f.name}.{inner}" for inner in option_names(value)]
        elif f.init:
            names.append(f.name)
    return names


def nearest_options(name: str, known: Iterable[str]) -> list[str]:
    """The options that ``name`` may stand for: those of that name in a stage, else the one spelt most nearly so."""
    known = list(known)
    same = [k for k in known if k.endswith(f".{name}")]
    return same or difflib.get_close_matches(name, known, n=1, cutoff=0.5)


def _owner(cls: type, name: str) -> type:
    """The class of the hierarchy whose body has the field."""
    return next((c for c in cls.__mro__ if name in inspect.get_annotations(c)), cls)


def _heading(cls: type) -> str:
    own = vars(cls).get("__doc__")
    # dataclasses write a signature where there is no docstring
    if not own or own.startswith(cls.__name__ + "("):
        return ""
    return inspect.cleandoc(own).splitlines()[0].rstrip(".")


def type_words(hint: Any) -> str:
    """How a user would say the type of an option."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    words: Mapping[Any, str] = {
        int: "a whole number", float: "a number", bool: "true or false", str: "text", type(None): "none",
    }  # fmt: skip
    if hint in words:
        return words[hint]
    if origin in (typing.Union, types.UnionType):
        return " or ".join(type_words(a) for a in args)
    if origin is typing.Literal:
        return str(args[0]) if len(args) == 1 else "one of " + ", ".join(str(a) for a in args)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return "one of " + ", ".join(str(m.value) for m in hint)
    if origin in (tuple, list):
        return f"{len(args)} values with commas" if args and args[-1] is not Ellipsis else "values with commas"
    return getattr(hint, "__name__", str(hint))
