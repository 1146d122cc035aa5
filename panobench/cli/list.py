"""`panobench list` shows what is registered, its origin, whether it can run here, and a method's options."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
from itertools import groupby
from typing import Annotated, Any

import typer

from panobench.errors import UnavailableError, UnknownNameError
from panobench.options import OptionDescription, OptionMetadata, describe_options
from panobench.plugins import Registered, Registry, registry
from panobench.specs import load_object
from panobench.writing import json_ready

app = typer.Typer()

#: The kinds as specs name them, and their plural.
KINDS = {
    "camera": "cameras",
    "dataset": "datasets",
    "method": "methods",
    "depth": "depth estimators",
    "mask": "mask estimators",
    "metric": "metrics",
    "study": "studies",
}
_SYNONYMS = {
    "cameras": "camera",
    "datasets": "dataset",
    "masks": "mask",
    "methods": "method",
    "metrics": "metric",
    "studies": "study",
}


@app.command(name="list")
def list_command(
    kind: Annotated[str | None, typer.Argument(help=f"One of {', '.join(KINDS)}.")] = None,
    name: Annotated[str | None, typer.Argument(help="One entry, in full.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show what is registered: its origin and whether it can run here."""
    known = registry()
    if kind is not None:
        kind = _SYNONYMS.get(kind, kind)
        if kind not in KINDS:
            raise UnknownNameError("kind", kind, KINDS)
    if kind is not None and name is not None:
        entries = known.entries.get(kind, {})
        if name not in entries:
            raise UnknownNameError(kind, name, entries)
        entry, options = describe(entries[name], full=True), method_options(entries[name])
        if as_json:
            listed = {"options": json_ready([asdict(o) for o in options])} if kind == "method" else {}
            print(json.dumps({**entry, **listed}, indent=2))
        else:
            width = shutil.get_terminal_size().columns
            presets = entry.pop("presets", {})
            print("\n".join([_long(entry), *_option_lines(options, width), *_preset_lines(presets, width)]))
        return
    listing = {k: [describe(r) for r in known.entries.get(k, {}).values()] for k in KINDS if kind in (None, k)}
    if as_json:
        print(json.dumps({**listing, "failed_plugins": known.failures}, indent=2, default=str))
        return
    _print(listing, known)


def describe(entry: Registered, full: bool = False) -> dict[str, Any]:
    """A spec as plain values; ``unavailable`` is None when it can run here, else one line why not."""
    spec = entry.spec
    values: dict[str, Any] = {
        "name": spec.name,
        "summary": spec.summary,
        "origin": entry.origin,
        "unavailable": _unavailable(entry),
    }
    shown = {f.name: getattr(spec, f.name) for f in fields(spec)} if full else {}
    for extra in ("cameras", "needs", "presets", "publisher", "needs_dataset_depth", "keys"):
        if hasattr(spec, extra):
            shown[extra] = getattr(spec, extra)
    return {**values, **{k: json_ready(v) for k, v in shown.items() if k not in values}}


def method_options(entry: Registered) -> list[OptionDescription]:
    """Every option of a method; [] for other plugins, and for methods without any or whose packages are missing."""
    path = getattr(entry.spec, "config", None)
    if path is None:
        return []
    try:
        return describe_options(load_object(path, f"config of method '{entry.spec.name}'")())
    except UnavailableError:
        return []


def _option_lines(options: list[OptionDescription], width: int) -> Iterator[str]:
    """A heading per stage, then a line per option: its name, default with unit, and what it is."""
    name_width = max((len(o.name) for o in options), default=0)
    rows = [(o, f"{_shown(o.default)} {o.unit}".strip()) for o in options]
    default_width = max((len(default) for _, default in rows), default=0)
    indent = " " * (name_width + default_width + 6)
    for stage, members in groupby(rows, key=lambda row: row[0].stage):
        yield ""
        yield f"Options: {stage}" if stage else "Options"
        for o, default in members:
            about = [o.help, "" if o.type in _PLAIN_TYPES else o.type, "" if o.bounds == _USUAL_BOUNDS else o.bounds]
            text = f"  {o.name:{name_width}}  {default:{default_width}}  {'; '.join(a for a in about if a)}".rstrip()
            if width - len(indent) < 30:  # the terminal is too narrow for columns, and wraps
                yield text
            else:
                yield from textwrap.wrap(
                    text, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
                ) or [text]


def _preset_lines(presets: dict[str, dict[str, Any]], width: int) -> Iterator[str]:
    for name, values in presets.items():
        yield ""
        yield f"Preset {name}"
        words = " ".join(f"{key}={_shown(value)}" for key, value in _flat(values))
        yield from textwrap.wrap(words, width, initial_indent="  ", subsequent_indent="  ", break_on_hyphens=False)


def _flat(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Nested values under dotted names."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield prefix + key, value


#: A default shows these types already.
_PLAIN_TYPES = ("a whole number", "a number", "true or false", "text")
_USUAL_BOUNDS = OptionMetadata("").bounds()


def _shown(value: Any) -> str:
    """A default as `--set` takes it."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    if isinstance(value, (tuple, list)):
        return ",".join(map(_shown, value)) or '""'
    value = getattr(value, "value", value)  # the value of an enum
    return str(value).removesuffix(".0") if isinstance(value, float) else str(value) or '""'


def _unavailable(entry: Registered) -> str | None:
    try:
        return entry.spec.unavailable()
    except Exception as error:  # a plugin's probe may raise anything; the listing goes on
        return f"its probe failed: {type(error).__name__}: {error}"


def _long(entry: dict[str, Any]) -> str:
    return "\n".join(f"{key:20} {_text(value)}" for key, value in entry.items() if value not in ("", [], {}))


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _entry_lines(heading: str, text: str) -> list[str]:
    """A name and its text, wrapped between words below where the text began; one line for grep and other programs."""
    width = shutil.get_terminal_size().columns
    # Python has no standard output at all where it was closed before the start.
    for_people = (sys.stdout is not None and sys.stdout.isatty()) or "COLUMNS" in os.environ
    if not for_people or width - len(heading) < 30:  # as for options
        return [heading + text]
    indent = " " * len(heading)
    return textwrap.wrap(
        text, width, initial_indent=heading, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )


def _print(listing: dict[str, list[dict[str, Any]]], known: Registry) -> None:
    for kind, entries in listing.items():
        print(f"{KINDS[kind]}:" if entries else f"{KINDS[kind]}: none")
        width = max((len(e["name"]) for e in entries), default=0)
        for e in entries:
            origin = "" if e["origin"] == "built-in" else f"  [{e['origin']}]"
            state = f"  (cannot run here: {e['unavailable']})" if e["unavailable"] else ""
            print("\n".join(_entry_lines(f"  {e['name']:{width}}  ", f"{e['summary']}{origin}{state}")))
    for plugin, reason in known.failures.items():
        print(f"skipped plugin {plugin}: {reason}")
