"""What may stand in a suite file, as pydantic models: they check a file, and describe it to editors as JSON Schema."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError, WithJsonSchema
from pydantic_core import PydanticCustomError

from panobench.bench.run.request import RunOption, run_options
from panobench.bench.suite.cells import Limits
from panobench.errors import InputError, PanobenchError, UnknownNameError

T = TypeVar("T")
LIMITS = tuple(f.name for f in fields(Limits))


def _wrong(message: str) -> PydanticCustomError:
    """An error whose message is shown as it is; braces mean nothing in it."""
    return PydanticCustomError("suite", "{says}", {"says": message})


def _kind(value: Any) -> str:
    return "nothing" if value is None else type(value).__name__


def _text(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise _wrong(f"expected a name, not {_kind(value)}")
    return str(value)


def _whole(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise _wrong(f"expected a whole number, not {value!r:.40}")
    return value


def _several(value: Any) -> Any:
    """A list; the file may give its only entry alone."""
    return [value] if isinstance(value, (str, Mapping)) else value


def _named(value: Any) -> Any:
    """A method or a dataset; the file may give its name alone."""
    return {"name": value} if isinstance(value, str) else value


def _settings(value: Any) -> Any:
    for key, item in value.items() if isinstance(value, Mapping) else ():
        items = item if isinstance(item, list) else [item]
        if not all(i is None or isinstance(i, (bool, int, float, str)) for i in items):
            raise _wrong(f"{key} must be a plain value or a list of such")
    return value


def own_options() -> dict[str, RunOption]:
    """The run options that may stand under ``options``: those that have no key of their own."""
    return {option.name: option for option in run_options() if not option.suite_key}


def _options(value: Any) -> Any:
    """Options by name, numbers as text where text is wanted; ``RunRequest`` and ``Limits`` judge the values."""
    if not isinstance(value, Mapping):
        return value
    known, found = own_options(), dict(value)
    for key, item in value.items():
        if key not in (*known, *LIMITS):
            raise UnknownNameError("option", str(key), (*known, *LIMITS))
        if key in known and str in (known[key].type, *get_args(known[key].type)) and item is not None:
            try:
                found[key] = _text(item)
            except PydanticCustomError as error:
                raise _wrong(f"{key}: {error.message()}") from None
    return found


_PLAIN = {"type": ["string", "number", "boolean", "null"]}
_NAME = {"type": ["string", "number"]}
Name = Annotated[str, BeforeValidator(_text), WithJsonSchema(_NAME)]
Whole = Annotated[int, BeforeValidator(_whole), WithJsonSchema({"type": "integer", "minimum": 0})]
Names = Annotated[
    list[Name],
    BeforeValidator(_several),
    Field(min_length=1),
    WithJsonSchema({"anyOf": [_NAME, {"type": "array", "items": _NAME, "minItems": 1}]}),
]
Settings = Annotated[
    dict[str, Any],
    BeforeValidator(_settings),
    WithJsonSchema({"type": "object", "additionalProperties": {"anyOf": [_PLAIN, {"type": "array", "items": _PLAIN}]}}),
]
RunOptions = Annotated[dict[str, Any], BeforeValidator(_options), WithJsonSchema({"type": "object"})]


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True)


class MethodEntry(_Entry):
    """A method with what it is run with. set: its options. cameras: instead of the suite's."""

    name: Name
    preset: Name | None = None
    set: Settings | None = None
    cameras: Names | None = None
    options: RunOptions | None = None


class DatasetEntry(_Entry):
    """A data set. sequences: their names, or "all"; the first where nothing is said."""

    name: Name
    root: Name | None = None
    sequences: Literal["all"] | Names | None = None
    options: RunOptions | None = None


class SuiteFile(_Entry):
    """A matrix of methods, cameras, data sets and seeds."""

    name: Name | None = None
    methods: Annotated[list[Annotated[MethodEntry, BeforeValidator(_named)]], BeforeValidator(_several)] = Field(
        min_length=1
    )
    datasets: Annotated[list[Annotated[DatasetEntry, BeforeValidator(_named)]], BeforeValidator(_several)] = Field(
        min_length=1
    )
    cameras: Names | None = None
    seeds: Annotated[list[Whole], BeforeValidator(lambda v: v)] | None = Field(None, min_length=1)
    repeats: Whole = 1
    options: RunOptions | None = None


def parse_suite(document: Any, path: Path) -> SuiteFile:
    """The document as a suite. Raises InputError or UnknownNameError for the first mistake in it."""
    if not isinstance(document, Mapping):
        raise InputError(f"a suite must be a mapping, not {_kind(document)}", path)
    _plain_keys(document, path, 0)
    # what says nothing is as if it were not there
    document = {key: value for key, value in document.items() if value is not None}
    try:
        return SuiteFile.model_validate(document)
    except ValidationError as error:
        raise _first(error, path) from None


def _plain_keys(value: Any, path: Path, depth: int) -> None:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if not isinstance(key, str):
                raise InputError(f"the key {key!r:.40} is no text", path)
            _plain_keys(inner, path, depth + 1)
    elif isinstance(value, list) and depth < 8:
        for inner in value:
            _plain_keys(inner, path, depth + 1)


def _first(error: ValidationError, path: Path) -> PanobenchError:
    """The first mistake in the words of this program."""
    # an unknown key is often why a known one is missing
    found = min(error.errors(include_url=False), key=lambda e: e["type"] != "extra_forbidden")
    place, kind = [part for part in found["loc"] if part not in _BRANCHES], found["type"]
    where = ".".join(str(part) for part in place if isinstance(part, str))
    entry = place[0] if len(place) > 1 else ""
    if kind == "extra_forbidden":
        models: dict[str, type[BaseModel]] = {"methods": MethodEntry, "datasets": DatasetEntry}
        model = models.get(str(entry), SuiteFile)
        what = f"key of {entry}" if entry else "suite key"
        return UnknownNameError(what, str(place[-1]), list(model.model_fields))
    if kind == "missing" and entry:
        return InputError(f"an entry of {entry} has no {place[-1]}", path)
    if kind in ("missing", "too_short", "list_type"):
        return InputError(f"{where} must be a list with at least one entry", path)
    if kind in ("model_type", "dict_type"):
        what = f"an entry of {entry}" if kind == "model_type" else where
        return InputError(f"{what} must be a mapping, not {_kind(found['input'])}", path)
    return InputError(f"{where}: {found['msg']}", path)


#: Parts of a place that name a branch of a union, not a key.
_BRANCHES = ("literal['all']", "function-before[_several(), list[function-before[_text(), str]]]")


def suite_schema() -> dict[str, Any]:
    """JSON Schema (2020-12) of a suite file, with the names, presets and options there are here."""
    from panobench.plugins import registry
    from panobench.specs import DatasetSpec

    schema = SuiteFile.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "A suite of panobench"
    defs = schema["$defs"]
    defs["Options"] = {"type": "object", "properties": dict(_option_schemas()), "additionalProperties": False}
    for model in (schema, defs["MethodEntry"], defs["DatasetEntry"]):
        model["properties"]["options"] = {"anyOf": [{"$ref": "#/$defs/Options"}, {"type": "null"}]}
    methods = dict(_method_schemas())
    defs["MethodEntry"]["properties"]["name"] = {"enum": list(methods)}
    defs["MethodEntry"]["allOf"] = [
        {"if": {"properties": {"name": {"const": name}}}, "then": {"properties": properties}}
        for name, properties in methods.items()
    ]
    defs["DatasetEntry"]["properties"]["name"] = {"enum": list(registry().specs(DatasetSpec))}
    for plural, entry in (("methods", "MethodEntry"), ("datasets", "DatasetEntry")):
        one = {"anyOf": [{"$ref": f"#/$defs/{entry}"}, defs[entry]["properties"]["name"]]}
        schema["properties"][plural] = {"anyOf": [one, {"type": "array", "items": one, "minItems": 1}]}
    return schema


def _option_schemas() -> Iterator[tuple[str, dict[str, Any]]]:
    for name, option in own_options().items():
        about = TypeAdapter(option.type, config=ConfigDict(arbitrary_types_allowed=True)).json_schema()
        yield name, {**about, "description": option.help}
    for limit in fields(Limits):
        yield limit.name, {"type": "number", "exclusiveMinimum": 0}


def _method_schemas() -> Iterator[tuple[str, dict[str, Any]]]:
    """For each method what its entry may hold besides: presets, and options with their defaults."""
    from panobench.options import describe_options
    from panobench.plugins import registry
    from panobench.specs import MethodSpec, load_object

    for name, spec in registry().specs(MethodSpec).items():
        properties: dict[str, Any] = {"preset": {"enum": ["default", *spec.presets, None]}}
        try:
            config = None if spec.config is None else load_object(spec.config, f"config of method '{name}'")()
        except PanobenchError:  # its package is not here: its options are not known
            yield name, properties
            continue
        described = [] if config is None else describe_options(config)
        options = {
            o.name: {"description": f"{o.help} ({o.type}{', ' + o.unit if o.unit else ''})", **_default(o.default)}
            for o in described
        }
        properties["set"] = {"type": ["object", "null"], "properties": options, "additionalProperties": False}
        yield name, properties


def _default(value: Any) -> dict[str, Any]:
    value = getattr(value, "value", value)
    plain = value is None or isinstance(value, (bool, int, str)) or (isinstance(value, float) and math.isfinite(value))
    return {"default": value} if plain else {}
