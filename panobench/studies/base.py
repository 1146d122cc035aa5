"""What a study gets and gives back. A study regenerates one table or figure of the paper."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass
class StudyRequest:
    """quick: under two minutes on two cores. out: folder for runs and results; a second call resumes there."""

    out: Path
    quick: bool = False
    options: dict[str, Any] = field(default_factory=dict)


@dataclass
class StudyResult:
    """tables: name -> rows (dicts with the same keys). figures: name -> Plotly figure as a dict. notes: text lines."""

    name: str
    tables: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    figures: dict[str, dict[str, Any]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
