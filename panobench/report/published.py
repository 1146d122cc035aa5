"""Rows of published figures, for reference; they are never ranked against runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from panobench.bench.paper import Published

#: Which published ATE table belongs to which dataset name, and what to say when the data are not the same.
_TABLES = {
    "synpano": ("synpano_ate_rmse_m", ""),
    "palvio": ("palvio_ate_rmse_m", ""),
    "rooms": (
        "synpano_ate_rmse_m",
        "The published rows are for SynPano's rooms: the built-in rooms are modelled after them, "
        "with other geometry, images and paths. They give the order of magnitude only.",
    ),
}


def published_block(
    published: Published, dataset: str, sequences: Sequence[str], unit: str, scale: float
) -> tuple[list[tuple[str, list[float | None]]], tuple[str, ...]]:
    """(label, ATE per sequence in ``unit``) rows for a dataset, and the notes that must stand below them.

    Empty when nothing is published for it, or for none of these sequences. None is a printed failure, NaN a sequence
    nothing is published for.
    """
    name, caveat = _TABLES.get(dataset, ("", ""))
    table = published.tables.get(name)
    if not table or not set(sequences) & set(table["sequences"]):
        return [], ()
    names = list(table["sequences"])
    rows = []
    for method, entry in table.items():
        if method == "sequences":
            continue
        values = entry["values"] if isinstance(entry, Mapping) else entry
        label = f"{method} + IMU" if isinstance(entry, Mapping) and entry.get("imu") else method
        figures = [values[names.index(s)] if s in names else math.nan for s in sequences]
        rows.append((label, [None if v is None else float(v) * scale for v in figures]))
    source = f"Rows marked “published” are figures printed in {published.source} ({published.platform}), not measured."
    return rows, tuple(note for note in (source, caveat) if note)
