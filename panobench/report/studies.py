"""Show studies in a report: their rows as tables, their figures as charts, and their provenance."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from panobench.bench.records.study_record import StoredStudy, StudyResult
from panobench.report.figures import Figure, log_axis
from panobench.report.sections import Chart
from panobench.report.table_model import (
    FAILED,
    NOT_AVAILABLE,
    Cell,
    Column,
    Row,
    Table,
    drop_empty_columns,
    format_number,
    mark_ranks,
)

_HEADING = re.compile(r"^(?P<label>.*?)(?:\s*\[(?P<unit>[^\]]*)\])?\s*(?P<arrow>[↓↑]?)$")
_BETTER = {"↓": "lower", "↑": "higher", "": "none"}
#: The column that says where a row's figures come from; it becomes the row's style.
SOURCE = "source"
#: Columns that say under what conditions a row was measured: only rows with the same ones compete.
CONDITIONS = ("Disturbance", "Preset", "Dataset", "Sequence", "Data")


def study_tables(studies: Iterable[StoredStudy]) -> list[Table]:
    """Every table of the studies; rows "source": "published" are set apart and never compete."""
    found = []
    for study in studies:
        for name, rows in study.result.tables.items():
            if rows:
                found.append(_table(study.result, name, rows))
    return found


def _table(result: StudyResult, name: str, rows: Sequence[Mapping[str, Any]]) -> Table:
    title, about = caption(result, name)
    keys = [key for key in dict.fromkeys(k for row in rows for k in row) if key != SOURCE]
    columns = tuple(_column(key, [row.get(key) for row in rows]) for key in keys)
    built = [
        Row(
            tuple(_cell(row.get(key), column) for key, column in zip(keys, columns)),
            "published" if row.get(SOURCE) == "published" else "measured",
            group="; ".join(str(row.get(key)) for key in keys if key in CONDITIONS),
            facts={key: str(row[key]) for key in keys if row.get(key) is not None and not _is_number(row[key])},
        )
        for row in rows
    ]
    built.sort(key=lambda row: row.origin == "published")
    table = Table(f"{result.name}-{name}" if name != result.name else name, title, about, columns, ())
    return drop_empty_columns(Table(table.name, title, about, columns, tuple(mark_ranks(columns, built))))


def caption(result: StudyResult, name: str) -> tuple[str, str]:
    """Heading and the text below it: a caption's first sentence and the rest."""
    heading, _, rest = result.captions.get(name, name).partition(". ")
    return heading.rstrip("."), rest


def _column(key: str, values: Sequence[Any]) -> Column:
    match = _HEADING.match(key)
    label, unit, arrow = (match["label"], match["unit"], match["arrow"]) if match else (key, None, "")
    numeric = any(_is_number(v) for v in values) or all(v in (None, FAILED) for v in values)
    return Column(key, label, unit or "", _BETTER[arrow], numeric=numeric)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _cell(value: Any, column: Column) -> Cell:
    if value == FAILED:
        return Cell(FAILED, failed=True, about="failed")
    if value is None:
        return Cell(NOT_AVAILABLE)
    if not _is_number(value):
        return Cell(str(value))
    return Cell(format_number(float(value), _digits(float(value), column.unit)), float(value))


def _digits(value: float, unit: str) -> int:
    """Digits after the point that a column of such values needs."""
    if unit == "%":
        return 0 if value == round(value) else 1
    if value == round(value) and abs(value) >= 10:
        return 0
    return 3 if abs(value) < 1 else 2 if abs(value) < 100 else 1


def study_section(number: int, study: StoredStudy, data: dict[str, Any]) -> dict[str, Any]:
    """What the page shows of one study; its figures go into ``data``."""
    result = study.result
    charts = []
    for name, figure in result.figures.items():
        usable = prepared(figure)
        if not usable["data"]:
            continue
        key = f"study{number}-{name}"
        data["figures"][key] = usable
        title, about = caption(result, name)
        spatial = "scene" in usable["layout"]
        charts.append(Chart(key, title, about or title, size="half", spatial=spatial))
    return {
        "key": f"study-{number}",
        "name": result.name,
        "title": result.title or result.name,
        "quick": bool(study.provenance.get("quick")),
        "tables": study_tables([study]),
        "charts": charts,
        "notes": result.notes,
        "command": again(str(study.provenance.get("command") or ""), study.folder.name),
    }


def again(command: str, folder: str) -> str:
    """The command of a study with a folder to write to that is right wherever the page is read."""
    try:
        words = shlex.split(command)
    except ValueError:
        return command
    if "--out" in words[:-1]:
        words[words.index("--out") + 1] = folder or "study"
    return shlex.join(words)


def prepared(figure: Mapping[str, Any]) -> Figure:
    """A study's figure as the page's scripts expect it: every trace with ``meta`` run and colour."""
    layout = figure.get("layout")
    traces = [dict(t) for t in figure["data"] if isinstance(t, Mapping)]
    for k, trace in enumerate(traces):
        meta = trace.get("meta")
        known = isinstance(meta, Mapping) and isinstance(meta.get("colour"), int)
        trace["meta"] = {"run": -2, "colour": meta["colour"] if known else k}  # type: ignore[index]
        trace.setdefault("type", "scatter")
        trace["name"] = str(trace.get("name", ""))
    shown = _plain(layout) if isinstance(layout, Mapping) else {}
    if isinstance(shown.get("scene"), dict):
        scene = {"xaxis": {}, "yaxis": {}, "zaxis": {}, "camera": {}, **shown["scene"]}
        scene["camera"] = {"eye": {"x": 1.25, "y": -1.35, "z": 0.9}, **scene["camera"]}
        shown["scene"] = scene
    for axis in ("x", "y"):
        about = shown.get(f"{axis}axis")
        values = [v for t in traces for v in _numbers(t.get(axis)) if v > 0]
        if isinstance(about, dict) and about.get("type") == "log" and values:
            shown[f"{axis}axis"] = {**log_axis(values), **about}
    return {"data": traces, "layout": shown}


def _numbers(values: Any) -> list[float]:
    return [float(v) for v in values if _is_number(v)] if isinstance(values, list) else []


def _plain(value: Any) -> Any:
    """A copy whose texts Plotly does not take for markup."""
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    return value.replace("<", "&lt;") if isinstance(value, str) else value
