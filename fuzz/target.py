"""A parser under test. It parses bytes; only a PanobenchError may come out of it."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mutate import Material

from panobench.errors import PanobenchError

Parse = Callable[[Path], object]


@dataclass(frozen=True)
class Target:
    """file: name that the input gets. material: made when first wanted. parse: reads the file; set up per folder."""

    name: str
    file: str
    material: Callable[[], Material]
    parse: Callable[[Path], Parse]

    def runner(self, folder: Path) -> Callable[[bytes], str]:
        """Parse inputs in ``folder``: returns "" if one is read, else the refusal; raises what a crash raises."""
        path = folder / self.file
        path.parent.mkdir(parents=True, exist_ok=True)
        parse = self.parse(folder)

        def run(data: bytes) -> str:
            path.write_bytes(data)
            with warnings.catch_warnings(), np.errstate(all="ignore"):
                warnings.simplefilter("ignore")
                try:
                    parse(path)
                except PanobenchError as error:
                    return str(error) or "refused without a word"
            return ""

        return run


def plain(parse: Parse) -> Callable[[Path], Parse]:
    """A parser that needs no files beside its input."""
    return lambda folder: parse


def text(*documents: str, words: str = "") -> Callable[[], Material]:
    """Valid documents, and words of the format that mutations may insert."""
    return lambda: Material(tuple(d.encode() for d in documents), tuple(w.encode() for w in words.split()))
