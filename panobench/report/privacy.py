"""Leave out where files are on the machine that made a report, for pages that are published."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from panobench.bench.records.record import RunRecord
from panobench.bench.records.study_record import StoredStudy
from panobench.report.model import Collection, Problem, Run

#: An absolute path of at least two parts, not inside a word, an address or a ratio.
_PATH = re.compile(r"(?<![\w.:/~-])(?:~|(?=/))(?:/[^\s/:;,'\"()<>\[\]]+)+/([^\s/:;,'\"()<>\[\]]+)/?")


def hide_paths(collection: Collection) -> Collection:
    """A copy in which every absolute path in a text is cut to its last part."""
    return Collection(
        tuple(_run(run) for run in collection.runs),
        tuple(Problem(Path(problem.folder.name), shortened(problem.message)) for problem in collection.problems),
        tuple(_study(study) for study in collection.studies),
    )


def shortened(text: str) -> str:
    """The text with paths cut: "cannot read /home/me/data/a.png" becomes "cannot read …/a.png"."""
    return _PATH.sub(r"…/\1", text)


def _command(text: str) -> str:
    """A command whose files are named as if they lay in the folder it is given in: what is copied can be run there."""
    return _PATH.sub(r"\1", text)


def _run(run: Run) -> Run:
    record = RunRecord.from_dict(_everywhere(run.record.to_dict()))
    record.provenance.command = _command(run.record.provenance.command)
    return replace(
        run,
        record=record,
        log_tail=shortened(run.log_tail),
        warnings=tuple(shortened(w) for w in run.warnings),
    )


def _study(study: StoredStudy) -> StoredStudy:
    result = replace(study.result, notes=[shortened(note) for note in study.result.notes])
    about = _everywhere(study.provenance)
    if "command" in study.provenance:
        about["command"] = _command(str(study.provenance["command"]))
    return StoredStudy(study.folder, result, about)


def _everywhere(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _everywhere(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_everywhere(entry) for entry in value]
    return shortened(value) if isinstance(value, str) else value
