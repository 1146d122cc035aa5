"""`panobench list`: everything that is registered, with its origin and whether it can run here."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Annotated, Any

import typer

from panobench.errors import UnknownNameError
from panobench.plugins import Registered, Registry, registry

app = typer.Typer()

#: Words for a kind that people type -> the kind as specs name it.
KINDS = {
    "camera": "cameras",
    "dataset": "datasets",
    "method": "methods",
    "depth": "depth estimators",
    "metric": "metrics",
    "study": "studies",
}
_SYNONYMS = {"cameras": "camera", "datasets": "dataset", "methods": "method", "metrics": "metric", "studies": "study"}


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
        entry = describe(entries[name], full=True)
        print(json.dumps(entry, indent=2, default=str) if as_json else _long(entry))
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
    return {**values, **{k: _plain(v) for k, v in shown.items() if k not in values}}


def _unavailable(entry: Registered) -> str | None:
    try:
        return entry.spec.unavailable()
    except Exception as error:  # a stranger's probe may raise anything; the listing goes on
        return f"its probe failed: {type(error).__name__}: {error}"


def _plain(value: Any) -> Any:
    if isinstance(value, (tuple, list)):
        return [_plain(v) for v in value]
    return {str(k): _plain(v) for k, v in value.items()} if hasattr(value, "items") else value


def _long(entry: dict[str, Any]) -> str:
    return "\n".join(f"{key:20} {_text(value)}" for key, value in entry.items() if value not in ("", [], {}))


def _text(value: Any) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else json.dumps(value, default=str)


def _print(listing: dict[str, list[dict[str, Any]]], known: Registry) -> None:
    for kind, entries in listing.items():
        print(f"{KINDS[kind]}:" if entries else f"{KINDS[kind]}: none")
        width = max((len(e["name"]) for e in entries), default=0)
        for e in entries:
            origin = "" if e["origin"] == "built-in" else f"  [{e['origin']}]"
            state = f"  (cannot run here: {e['unavailable']})" if e["unavailable"] else ""
            print(f"  {e['name']:{width}}  {e['summary']}{origin}{state}")
    for plugin, reason in known.failures.items():
        print(f"skipped plugin {plugin}: {reason}")
