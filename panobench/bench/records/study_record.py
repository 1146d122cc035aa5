"""The result of a study, and its record on disk: ``study.json`` in a folder, beside the runs it was made from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from panobench.errors import InputError
from panobench.reading import parse_json, read_text
from panobench.writing import json_ready, write_whole

STUDY_JSON = "study.json"
SCHEMA = 1
MAX_BYTES = 64 << 20


@dataclass
class StudyResult:
    """tables: name -> rows (dicts with the same keys). figures: name -> Plotly figure as a dict. notes: text lines.

    A column's key is its heading, for example "ATE [mm] ↓": the unit in brackets, an arrow for what is better. Cells
    are text, numbers, None (not measured) or "/" (failed); a row with ``"source": "published"`` is set apart.
    captions: a line of text for a table or figure of that name; its first sentence is the heading.
    """

    name: str
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    figures: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    title: str = ""
    captions: dict[str, str] = field(default_factory=dict)


@dataclass
class StoredStudy:
    """A result with where it came from: command, quick, options, versions, machine."""

    folder: Path
    result: StudyResult
    provenance: dict[str, Any] = field(default_factory=dict)


def write_study(folder: Path, result: StudyResult, provenance: Mapping[str, Any]) -> Path:
    """Raises OutputError."""
    document = {"schema": SCHEMA, **asdict(result), "provenance": dict(provenance)}
    path = folder / STUDY_JSON
    write_whole(path, json.dumps(json_ready(document), indent=1, ensure_ascii=False) + "\n")
    return path


def read_study(folder: Path) -> StoredStudy:
    """Raises InputError when ``folder/study.json`` is not one."""
    path = folder / STUDY_JSON
    document = parse_json(read_text(path, "the study", MAX_BYTES), path)
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise InputError(f"not a study this panobench can read (it reads schema {SCHEMA})", path)
    tables = {
        str(name): [dict(row) for row in rows if isinstance(row, dict)]
        for name, rows in _entries(document, "tables")
        if isinstance(rows, list)
    }
    figures = {
        str(name): figure
        for name, figure in _entries(document, "figures")
        if isinstance(figure, dict) and isinstance(figure.get("data"), list)
    }
    notes = document.get("notes")
    result = StudyResult(
        str(document.get("name") or folder.name),
        tables,
        figures,
        [str(line) for line in notes] if isinstance(notes, list) else [],
        str(document.get("title") or ""),
        {str(k): str(v) for k, v in _entries(document, "captions")},
    )
    return StoredStudy(folder, result, dict(_entries(document, "provenance")))


def _entries(document: Mapping[str, Any], key: str) -> list[tuple[Any, Any]]:
    value = document.get(key)
    return list(value.items()) if isinstance(value, dict) else []
