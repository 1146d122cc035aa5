"""How far verdicts can be trusted: right and wrong runs with ground truth, and what the verdict said of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from panobench.bench.records.study_record import StudyResult
from panobench.bench.run.checking import CHECKER
from panobench.bench.suite.cells import Cell
from panobench.bench.suite.store import Stored
from panobench.studies.base import StudyRequest
from panobench.studies.cells import QUICK, RunOptions, reasons, run_cells
from panobench.verdict.assess import BACKWARDS
from panobench.verdict.base import FAILED, TRUSTED

#: What happens to the stream (names of dataset ``disturbed``), "" for nothing.
DISTURBANCES = (
    "",
    "+operator-5",
    "+operator-15",
    "+operator-30",
    "+car-25",
    "+walkers-3",
    "+operator-15+walkers-3",
    "+rolling-15ms+turn-200",
    "+blur-10ms+turn-200",
    "+stitch-41mm+lenses-0.3",
    "+gait+levelled+operator-15",
    "+operator-15+gait+h264-0.1",
    ":noise=0.06",
    ":occluder=0.25",
    ":black=6",
    ":yaw=12",
)
#: Share of the path within which a run is right, and beyond which it is wrong.
RIGHT, WRONG = 0.005, 0.02
#: What the verdict should reach: wrong runs that are not trusted, at least; right runs that are not, at most.
CAUGHT_MIN, DOUBTED_MAX = 0.95, 0.05


@dataclass(frozen=True)
class VerdictOptions(RunOptions):
    """methods: each on every disturbed sequence, "METHOD" or "METHOD:PRESET"; ``sparse`` checks the others, and is
    checked backwards.
    """

    methods: tuple[str, ...] = ("panogs:fast", "sparse", "direct")
    sequences: tuple[str, ...] = ("room1", "room2", "room3", "room5", "tiny")
    disturbances: tuple[str, ...] = DISTURBANCES
    max_frames: int | None = 45


@dataclass(frozen=True)
class Judged:
    """A run: its error as a share of the path (None: lost), and what the verdict was."""

    label: str
    method: str
    disturbance: str
    error: float | None
    word: str
    confidence: float
    reason: str

    @property
    def right(self) -> bool:
        return self.error is not None and self.error <= RIGHT

    @property
    def wrong(self) -> bool:
        return self.error is None or self.error > WRONG


def run(study: StudyRequest) -> StudyResult:
    """A row per kind of run with how many were trusted, the curve over thresholds, and every misjudged run."""
    options = study.choose(VerdictOptions(), {**QUICK, "disturbances": DISTURBANCES[:3]})
    cells = {
        (method, text, sequence, seed): _cell(options, method, sequence + text, seed)
        for method in options.methods
        for text in options.disturbances
        for sequence in options.sequences
        for seed in options.seeds
    }
    results = run_cells(study, "verdict", cells.values())
    judged = [
        found
        for (method, text, _, _), cell in cells.items()
        if (found := _judged(results.get(cell.identity), cell, method, text)) is not None
    ]
    rows = [_row("all", judged), *(_row(m, [j for j in judged if j.method == m]) for m in options.methods)]
    by_disturbance = [_row(t or "none", [j for j in judged if j.disturbance == t]) for t in options.disturbances]
    misjudged = [
        {
            "Run": j.label,
            "Error [% of the path]": None if j.error is None else 100 * j.error,
            "Verdict": j.word,
            "Confidence": j.confidence,
            "Reason": j.reason,
        }
        for j in judged
        if (j.wrong and j.word == "trusted") or (j.right and j.word != "trusted")
    ]
    tables = {"verdict": rows, "verdict-disturbances": by_disturbance, "misjudged": misjudged}
    captions = {
        "verdict": f"Verdicts against truth. A run is right within {100 * RIGHT:g}% of the path (ATE after Sim(3) "
        f"alignment over its length) and wrong beyond {100 * WRONG:g}% or when lost; the target is at least "
        f"{100 * CAUGHT_MIN:g}% of the wrong ones not trusted, and at most {100 * DOUBTED_MAX:g}% of the right ones.",
        "verdict-disturbances": "Verdicts by disturbance. The same, over all methods.",
        "misjudged": "Misjudged runs. Wrong ones that were trusted, and right ones that were not.",
        "curve": "Wrong runs caught against right runs doubted. A point for each threshold on the confidence.",
    }
    notes = [
        f"{len(judged)} runs, {options.width} pixels wide, at most {options.max_frames} frames; '{CHECKER}' checks the "
        f"others, and itself backwards. Trusted from a confidence of {TRUSTED:g}, failed below {FAILED:g}.",
        *reasons(results, [c for c in cells.values() if results.get(c.identity) is None]),
    ]
    return StudyResult("verdict", tables, {"curve": _curve(judged)}, notes, "Verdicts", captions)


def _cell(options: VerdictOptions, method: str, sequence: str, seed: int) -> Cell:
    name, _, preset = method.partition(":")
    check = BACKWARDS if name == CHECKER else CHECKER
    return options.cell(
        f"{options.dataset}/{sequence}", seed, dataset="disturbed", method=name, preset=preset or None, check=check
    )


def _judged(stored: Stored | None, cell: Cell, method: str, disturbance: str) -> Judged | None:
    if stored is None or stored.record.verdict is None:
        return None
    record, verdict = stored.record, stored.record.verdict
    ate, path = record.number("ate_rmse_m"), record.number("path_length_m")
    lost = not record.ok or ate is None or not path
    error = None if lost or ate is None or not path else ate / path
    reason = verdict.reasons[0] if verdict.reasons else ""
    return Judged(cell.label, method, disturbance, error, verdict.word, verdict.confidence, reason)


def _row(name: str, judged: Sequence[Judged]) -> dict[str, Any]:
    right, wrong = [j for j in judged if j.right], [j for j in judged if j.wrong]
    caught = sum(j.word != "trusted" for j in wrong)
    doubted = sum(j.word != "trusted" for j in right)
    return {
        "Runs of": name,
        "Runs": len(judged),
        "Right": len(right),
        "Right, not trusted [%] ↓": 100 * doubted / len(right) if right else None,
        "Wrong": len(wrong),
        "Wrong, not trusted [%] ↑": 100 * caught / len(wrong) if wrong else None,
    }


def curve(judged: Sequence[Judged]) -> list[tuple[float, float, float]]:
    """(threshold, share of the right runs below it, share of the wrong ones below it), by rising threshold."""
    right = np.array([j.confidence for j in judged if j.right])
    wrong = np.array([j.confidence for j in judged if j.wrong])
    thresholds = np.unique(np.concatenate([[0.0], right, wrong, [1.0 + 1e-9]]))
    return [
        (float(t), float((right < t).mean()) if len(right) else 0.0, float((wrong < t).mean()) if len(wrong) else 0.0)
        for t in thresholds
    ]


def _curve(judged: Sequence[Judged]) -> dict[str, Any]:
    points = curve(judged)
    return {
        "data": [
            {
                "type": "scatter",
                "mode": "lines+markers",
                "name": "thresholds",
                "x": [100 * doubted for _, doubted, _ in points],
                "y": [100 * caught for _, _, caught in points],
                "text": [f"threshold {t:.2f}" for t, _, _ in points],
            },
            {
                "type": "scatter",
                "mode": "markers",
                "name": "target",
                "x": [100 * DOUBTED_MAX],
                "y": [100 * CAUGHT_MIN],
                "marker": {"symbol": "x", "size": 10},
            },
        ],
        "layout": {
            "xaxis": {"title": {"text": "right runs that are not trusted [%]"}, "range": [-2, 102]},
            "yaxis": {"title": {"text": "wrong runs that are not trusted [%]"}, "range": [-2, 102]},
        },
    }
