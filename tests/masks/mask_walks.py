"""Walks through the smallest room that the tests of masks share."""

from __future__ import annotations

from functools import lru_cache

from panobench.datasets.base import FrameSequence
from panobench.datasets.open import open_sequence

WIDTH = 192


@lru_cache(maxsize=8)
def walk(name: str) -> FrameSequence:
    return open_sequence("disturbed", name, width=WIDTH)
