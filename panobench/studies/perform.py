"""Run a study and store its result."""

from __future__ import annotations

import shlex

from panobench.bench.records.provenance import provenance
from panobench.bench.records.study_record import StudyResult, write_study
from panobench.errors import PanobenchError
from panobench.specs import StudySpec
from panobench.studies.base import StudyRequest


def perform(spec: StudySpec, request: StudyRequest) -> StudyResult:
    """Run a study and write ``study.json`` into its folder. Raises PanobenchError."""
    result = spec.load()(request)
    if not isinstance(result, StudyResult):
        raise PanobenchError(f"study '{spec.name}' returned {type(result).__name__}, not a StudyResult")
    about = {"command": shlex.join(command(spec.name, request)), "quick": request.quick, "options": request.options}
    write_study(request.out, result, {**provenance().to_dict(), **about})
    return result


def command(name: str, request: StudyRequest) -> list[str]:
    """The command line that makes the study again."""
    words = ["panobench", "study", name, "--out", str(request.out)] + (["--quick"] if request.quick else [])
    for key, value in request.options.items():
        words += ["--set", f"{key}={value}"]
    return words
