"""The paper's rows for its tables, which are shown below what was measured here."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from panobench.bench.records.paper import Published, load_published

#: Datasets whose sequences carry the names of the paper's rooms. The built-in ones are other rooms.
CAVEAT = {
    "synpano": "",
    "rooms": "The built-in rooms are modelled after SynPano's, with other geometry, images and paths: published rows "
    "give the order of magnitude only.",
}


def published_table(dataset: str, name: str) -> Mapping[str, Any]:
    """The paper's table ``name`` where it says something about ``dataset``, else nothing."""
    known = load_published() if dataset in CAVEAT else None
    return known.tables.get(name, {}) if known else {}


def columns(table: Mapping[str, Any], row: str, sequences: Sequence[str]) -> list[float | str | None]:
    """A row's figures for ``sequences``: None where the paper has no such sequence, "/" where it prints a failure."""
    names, figures = list(table["sequences"]), table[row]
    out: list[float | str | None] = []
    for sequence in sequences:
        value = figures[names.index(sequence)] if sequence in names else None
        out.append("/" if sequence in names and value is None else value)
    return out


def source_notes(dataset: str) -> list[str]:
    """Where the published rows come from and how far they can be compared."""
    known: Published | None = load_published()
    if known is None or dataset not in CAVEAT:
        return []
    return [f"Published rows: {known.source} ({known.platform})."] + ([CAVEAT[dataset]] if CAVEAT[dataset] else [])
