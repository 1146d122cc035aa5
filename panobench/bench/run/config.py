"""Make a method's configuration from its defaults, a preset and ``--set key=value``; check and convert every value."""

from __future__ import annotations

import dataclasses
import enum
import types
import typing
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from panobench.errors import UnknownNameError, UsageError
from panobench.options import OptionError, is_stage, nearest_options, option_names, type_words
from panobench.specs import MethodSpec, load_object
from panobench.writing import json_ready

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")
_NONE = ("none", "null", "")


def parse_settings(words: typing.Iterable[str]) -> dict[str, str]:
    """``["a=1", "b.c=x"]`` -> {"a": "1", "b.c": "x"}. Raises UsageError for a word without "="."""
    settings = {}
    for word in words:
        key, equals, value = word.partition("=")
        if not equals or not key.strip():
            raise UsageError(f"--set {word}: expected KEY=VALUE")
        settings[key.strip()] = value.strip()
    return settings


def method_config(spec: MethodSpec, preset: str | None = None, settings: Mapping[str, Any] | None = None) -> Any:
    """The method's config object, or None if it has no options.

    Raises UnknownNameError for a preset or option it does not have, UsageError for a value that is not allowed.
    """
    settings = dict(settings or {})
    if preset not in (None, "default", *spec.presets):
        raise UnknownNameError(f"preset of method '{spec.name}'", str(preset), ["default", *spec.presets])
    what = f"option of method '{spec.name}'"
    if spec.config is None:
        if settings:
            raise UnknownNameError(what, next(iter(settings)), ())
        return None
    cls = load_object(spec.config, f"config of method '{spec.name}'")
    chosen: Mapping[str, Any] = spec.presets.get(preset, {}) if preset else {}
    listed_by = f"panobench list methods {spec.name}"
    try:
        config = override(cls(), chosen, f"preset '{preset}' of method '{spec.name}'", listed_by)
        return override(config, settings, what, listed_by)
    except (TypeError, ValueError) as error:  # raised by __post_init__ of the dataclass
        raise UsageError(f"method '{spec.name}': {error}") from error


def override(config: Any, values: Mapping[str, Any], what: str, listed_by: str = "") -> Any:
    """A copy of the dataclass with ``values``; keys may be dotted, or values nested, for stages (dataclasses inside).

    ``what`` names the kind of option in messages, ``listed_by`` the command that lists the options. Raises
    UnknownNameError for a key it does not have, UsageError for a value of the wrong type, ValueError for one that the
    dataclass refuses.
    """
    return _override(config, values, _Names(what, option_names(config), listed_by), "")


@dataclasses.dataclass(frozen=True)
class _Names:
    what: str
    known: list[str]
    listed_by: str

    def unknown(self, key: str) -> UnknownNameError:
        nearest = nearest_options(key, self.known)
        return UnknownNameError(self.what, key, self.known, nearest=nearest, listed_by=self.listed_by)


def _override(config: Any, values: Mapping[str, Any], names: _Names, prefix: str) -> Any:
    own = {f.name for f in dataclasses.fields(config) if f.init}
    hints = typing.get_type_hints(type(config))
    changes: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    for key, value in values.items():
        head, _, rest = str(key).partition(".")
        inside = head in own and is_stage(getattr(config, head))
        inner = {rest: value} if rest else value
        if head not in own or (inside and not isinstance(inner, Mapping)) or (rest and not inside):
            raise names.unknown(prefix + str(key))
        if inside:
            nested.setdefault(head, {}).update(inner)
        else:
            changes[head] = coerce(value, hints.get(head, Any), prefix + head)
    for head, inner in nested.items():
        changes[head] = _override(getattr(config, head), inner, names, f"{prefix}{head}.")
    try:
        return dataclasses.replace(config, **changes)
    except OptionError as error:
        raise OptionError(prefix + error.option, error.problem) from None


def config_values(config: Any) -> dict[str, Any]:
    """The complete configuration as JSON-ready values."""
    return {} if config is None else json_ready(dataclasses.asdict(config))


def coerce(value: Any, hint: Any, key: str) -> Any:
    """``value`` (text from the command line, or a YAML value) as the type ``hint``. Raises UsageError."""
    try:
        return _coerce(value, hint)
    except (TypeError, ValueError, OverflowError):
        raise UsageError(f"option {key}: '{value}' is not {type_words(hint)}") from None


def _coerce(value: Any, hint: Any) -> Any:
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if hint is Any or hint is object:
        return value
    if origin in (typing.Union, types.UnionType):
        return _union(value, args)
    if origin is typing.Literal:
        for choice in args:
            if value == choice or str(value) == str(choice):
                return choice
        raise ValueError
    if origin in (tuple, list) or hint in (tuple, list):
        return _series(value, origin or hint, args)
    if isinstance(hint, type) and issubclass(hint, enum.Enum):
        return value if isinstance(value, hint) else hint(value)
    if hint is bool:
        return _bool(value)
    if hint is type(None):
        if value is None or str(value).lower() in _NONE:
            return None
        raise ValueError
    if hint is int:
        if isinstance(value, bool) or float(value) != int(float(value)):
            raise ValueError
        return int(value) if isinstance(value, int) else int(float(value))
    if hint is float:
        if isinstance(value, bool):
            raise ValueError
        return float(value)
    if hint in (str, Path):
        return hint(value)
    if isinstance(value, str):
        raise ValueError
    return value


def _union(value: Any, args: tuple[Any, ...]) -> Any:
    # try None first, so that "none" does not become text, and text last, which takes everything
    for option in sorted(args, key=lambda a: (a is not type(None), a in (str, Path))):
        try:
            return _coerce(value, option)
        except (TypeError, ValueError, OverflowError):
            continue
    raise ValueError


def _bool(value: Any) -> bool:
    word = str(value).lower()
    if word in _TRUE:
        return True
    if word in _FALSE:
        return False
    raise ValueError


def _series(value: Any, kind: Any, args: tuple[Any, ...]) -> Any:
    if isinstance(value, str):
        items: list[Any] = [word.strip() for word in value.strip("()[] ").split(",") if word.strip()]
    else:
        items = list(value)
    if kind is tuple and args and args[-1] is not Ellipsis:
        if len(items) != len(args):
            raise ValueError
        return tuple(_coerce(item, hint) for item, hint in zip(items, args))
    hint = args[0] if args else Any
    return kind(_coerce(item, hint) for item in items)
