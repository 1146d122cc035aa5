"""What a verdict is made of."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

#: Confidence from which a run is trusted, and below which it has failed.
TRUSTED, FAILED = 0.5, 0.05


class Word(str, enum.Enum):
    """A verdict in one word."""

    TRUSTED = "trusted"
    DOUBTFUL = "doubtful"
    FAILED = "failed"


@dataclass(frozen=True)
class Evidence:
    """One look at a run.

    name: short, for tables. trust: how well a right run would look like this, 0..1. text: what was seen, in one
    sentence without a full stop. advice: what the user can do if the trust is low.
    """

    name: str
    trust: float
    text: str
    advice: str = ""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.trust) and 0.0 <= self.trust <= 1.0):
            raise ValueError(f"trust must be a number from 0 to 1, not {self.trust}")


@dataclass(frozen=True)
class Verdict:
    """word; confidence 0..1; reasons: the evidence that lowered it, the worst first; advice: what to do, the same.

    evidence: all of it, for run.json.
    """

    word: Word
    confidence: float
    reasons: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    evidence: tuple[Evidence, ...] = ()


def decide(evidence: Sequence[Evidence]) -> Verdict:
    """The verdict on all evidence: the product of its trusts, so that several weak doubts add up to a strong one."""
    confidence = math.prod(e.trust for e in evidence)
    word = Word.TRUSTED if confidence >= TRUSTED else Word.DOUBTFUL if confidence >= FAILED else Word.FAILED
    doubts = sorted((e for e in evidence if e.trust < 1.0), key=lambda e: e.trust)
    advice = dict.fromkeys(e.advice for e in doubts if e.advice)
    return Verdict(word, confidence, tuple(e.text for e in doubts), tuple(advice), tuple(evidence))


def falling(value: float, good: float, bad: float, least: float = 0.02) -> float:
    """Trust that falls from 1 at ``good`` to 0.1 at ``bad`` on a logarithmic scale, and no further than to ``least``.

    good may be below bad (a number that should be small) or above it (one that should be large); both are positive.
    """
    if not math.isfinite(value):
        return least
    share = math.log(max(value, 1e-12) / good) / math.log(bad / good)
    return float(min(1.0, max(least, 0.1**share)))
