"""Rows of published figures, for reference; they are never ranked against runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from panobench.bench.records.paper import Published
from panobench.report.model import Run

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


#: Its sequences are minutes long: a recording of less than this (s) is none of them.
_LASTS = {"palvio": 10.0}


@dataclass(frozen=True)
class Block:
    """Published rows: label and ATE per sequence, their flags, and the notes that must stand below the table.

    None is a printed failure, NaN a sequence that nothing is published for, or nothing that compares.
    """

    rows: tuple[tuple[str, list[float | None]], ...] = ()
    notes: tuple[str, ...] = ()
    flags: tuple[str, ...] = ()


def published_block(
    published: Published, dataset: str, sequences: Sequence[str], runs: Sequence[Run], scale: float
) -> Block:
    """What is published for a dataset, for the sequences that the runs had whole; ``scale`` takes metres to the unit.

    A figure of a whole sequence does not compare with a run on its first frames, so it is left out, which a note says.
    """
    name, caveat = _TABLES.get(dataset, ("", ""))
    table = published.tables.get(name)
    if not table or not set(sequences) & set(table["sequences"]):
        return Block()
    names = list(table["sequences"])
    partial = {
        s: why for s in sequences if s in names and (why := _part(dataset, [r for r in runs if r.sequence == s]))
    }
    alike = {why: [s for s in partial if partial[s] == why] for why in partial.values()}
    left_out = tuple(
        f"Published figures for {', '.join(of)} are of the whole sequence, and left out: {why}."
        for why, of in alike.items()
    )
    if set(partial) >= set(sequences) & set(names):
        return Block(notes=left_out)
    rows = []
    for method, entry in table.items():
        if method == "sequences":
            continue
        values = entry["values"] if isinstance(entry, Mapping) else entry
        label = f"{method} + IMU" if isinstance(entry, Mapping) and entry.get("imu") else method
        figures = [values[names.index(s)] if s in names and s not in partial else math.nan for s in sequences]
        rows.append((label, [None if v is None else float(v) * scale for v in figures]))
    source = (
        f"Rows marked “published” are figures printed in {published.source} ({published.platform}), not measured. "
        "They are of the whole sequences as published; whether the data here are the same was not checked."
    )
    notes = (source, caveat) if caveat else (source,)
    return Block(tuple(rows), (*notes, *left_out), ("other data",) if caveat else ())


def _part(dataset: str, runs: Sequence[Run]) -> str:
    """Why the runs are not on the whole published sequence, "" if nothing is known to speak against it."""
    most = [run.truncated for run in runs]
    if any(count is not None for count in most):
        return f"runs here stop after {min(count for count in most if count is not None)} frames (max_frames)"
    last = max((run.trajectory.times[-1] - run.trajectory.times[0] for run in runs if run.trajectory), default=None)
    if last is not None and last < _LASTS.get(dataset, 0.0):
        return f"the recording here lasts {last:.1f} s"
    return ""
