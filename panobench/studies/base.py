"""The request for a study, which regenerates a table or figure of the paper and returns a ``StudyResult``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from panobench.bench.run.config import override

Options = TypeVar("Options")


def _silent(line: str) -> None:
    pass


@dataclass
class StudyRequest:
    """out: folder for runs and results, where a second call continues. quick: finish in two minutes on two cores.

    options: values of `--set`, as text. jobs: runs at a time. retry: statuses of stored runs to run again.
    say: is called with each line of progress.
    """

    out: Path
    quick: bool = False
    options: dict[str, Any] = field(default_factory=dict)
    jobs: int = 1
    retry: frozenset[str] = frozenset()
    say: Callable[[str], None] = _silent

    def choose(self, full: Options, quick: dict[str, Any]) -> Options:
        """The study's options: the defaults ``full`` (a dataclass), then ``quick`` if asked for, then what was set.

        Raises UnknownNameError for an unknown option and UsageError for a wrong value.
        """
        chosen = override(full, quick, "quick option") if self.quick else full
        known: Options = override(chosen, self.options, "study option")
        return known
