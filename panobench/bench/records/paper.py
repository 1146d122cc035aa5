"""Figures printed in papers, which come with the package (``bench/records/published/``)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Published:
    """The content of a file of published figures."""

    source: str
    platform: str
    tables: Mapping[str, Any]


def load_published(path: Path | None = None) -> Published | None:
    """The package's published figures (or those of ``path``); None when the file is not there."""
    import yaml

    if path is None:
        path = Path(__file__).parent / "published" / "panogs_slam.yaml"
    if not path.is_file():
        return None
    content = yaml.safe_load(path.read_text(encoding="utf-8"))
    return Published(str(content.get("source", "")), str(content.get("platform", "")), content)
