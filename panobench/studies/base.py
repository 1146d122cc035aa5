"""What a study is asked for. It regenerates a table or figure of the paper and returns a ``StudyResult``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from panobench.bench.config import override

Options = TypeVar("Options")


def _silent(line: str) -> None:
    pass


@dataclass
class StudyRequest:
    """out: folder for runs and results; a second call resumes there. quick: under two minutes on two cores.

    options: what `--set` gave, as text. jobs: runs at a time. retry: statuses of stored runs to run again.
    say: is told the progress, a line at a time.
    """

    out: Path
    quick: bool = False
    options: dict[str, Any] = field(default_factory=dict)
    jobs: int = 1
    retry: frozenset[str] = frozenset()
    say: Callable[[str], None] = _silent

    def choose(self, full: Options, quick: dict[str, Any]) -> Options:
        """The study's options: the defaults ``full`` (a dataclass), then ``quick`` if asked for, then what was set.

        Raises UnknownNameError or UsageError for options that are none.
        """
        chosen = override(full, quick, "quick option") if self.quick else full
        known: Options = override(chosen, self.options, "study option")
        return known
