"""Datasets whose sequences are found by looking below a folder."""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path

from panobench.datasets.base import Dataset
from panobench.datasets.locate import choose_sequence


class FoundSequences(Dataset):
    """A subclass says by ``_found`` where its sequences are, and opens one."""

    @abstractmethod
    def _found(self) -> dict[str, Path]:
        """Name -> place of every sequence. Raises DatasetError where there is none."""

    def sequences(self) -> list[str]:
        return list(self._found())

    def _choose(self, sequence: str | None) -> tuple[str, Path]:
        """Name and place of the sequence asked for. Raises as ``choose_sequence``."""
        found = self._found()
        name = choose_sequence(self.name, sequence, found)
        return name, found[name]
