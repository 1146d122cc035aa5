"""The iteration study: what front-end and back-end iterations buy in accuracy (the paper's iteration table)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from panobench.bench.records.paper import load_published
from panobench.bench.records.study_record import StudyResult
from panobench.errors import UsageError
from panobench.studies.base import StudyRequest
from panobench.studies.cells import FAILED, QUICK, RunOptions, mean, median, reasons, run_cells
from panobench.studies.fov import pinhole_width
from panobench.studies.published import source_notes

#: The options that hold the two counts, by method; methods that are not named have flat ones.
OPTIONS = {"panogs": ("tracking.iterations", "mapping.iterations")}
FLAT_OPTIONS = ("tracking_iterations", "mapping_iterations")
PAPER_COUNTS = ("15/30", "30/50", "50/80", "100/100")


@dataclass(frozen=True)
class IterationOptions(RunOptions):
    """counts: front-end/back-end iterations, that is, of tracking and of mapping (``OPTIONS``).

    baseline: a pinhole method with two such options to stand beside it, None for none.
    """

    preset: str | None = "paper"
    sequences: tuple[str, ...] = ("room1",)
    every: int = 2  # larger steps between frames: iterations matter more, and cost half
    counts: tuple[str, ...] = PAPER_COUNTS
    baseline: str | None = "monogs"


def run(study: StudyRequest) -> StudyResult:
    """ATE and frames per second for each pair of counts, and for the method's default preset."""
    options = study.choose(IterationOptions(), {**QUICK, "every": 1, "max_frames": 12, "counts": PAPER_COUNTS[:2]})
    label = f"{options.method} {options.preset}" if options.preset else options.method
    runs: dict[tuple[str, str], dict[str, Any]] = {}
    for text in options.counts:
        front, back = parse_counts(text)
        if options.baseline:
            view = {"camera": "pinhole:front", "width": pinhole_width(options.width)}
            runs[options.baseline, text] = {
                **_settings(options.baseline, front, back),
                **view,
                "method": options.baseline,
                "preset": None,
                "depth": None,
            }
        runs[label, text] = _settings(options.method, front, back)
    runs[options.method, "its default preset"] = {"preset": None}
    runs = dict(sorted(runs.items(), key=lambda item: item[0][0] != options.baseline))
    cells = {
        key: [[options.cell(s, seed, **changes) for seed in options.seeds] for s in options.sequences]
        for key, changes in runs.items()
    }
    flat = [cell for groups in cells.values() for group in groups for cell in group]
    results = run_cells(study, "iterations", flat)
    table, points = [], []
    for (method, text), groups in cells.items():
        ate = mean([median(results, g, "ate_rmse_m", 100.0) for g in groups])
        fps, tracking = (
            mean([median(results, g, key, higher_is_better=True) for g in groups]) for key in ("fps", "tracking_fps")
        )
        row = {"Method": method, "Front-end/back-end": text}
        table.append({**row, "ATE [cm] ↓": ate, "Frames/s ↑": fps, "Tracking/s ↑": tracking, "source": "measured"})
        points.append((method, text if "/" in text else "default", fps, ate))
    paper = load_published()
    own = paper.tables.get("iterations_palvio", {}) if paper else {}
    for method, figures in own.items():
        if method == "columns":
            continue
        for text, ate, fps in zip(own["columns"], figures["ate_m"], figures["fps"]):
            if text in options.counts:
                row = {"Method": method, "Front-end/back-end": text, "ATE [cm] ↓": 100.0 * ate}
                table.append({**row, "Frames/s ↑": fps, "Tracking/s ↑": None, "source": "published"})
    notes = [
        f"Sequences: {', '.join(options.sequences)} of {options.dataset}, {options.width} pixels wide"
        + (f", one frame in {options.every}." if options.every > 1 else "."),
        "The default preset tracks by Gauss-Newton, which stops by itself: the counts do not apply to it.",
        *(f"{line} The paper counts on PALVIO, another data set." for line in source_notes("synpano")[:1] if own),
        *reasons(results, flat),
    ]
    captions = {
        "iterations": "Iterations against accuracy and speed. Frames per second of the whole system, and of tracking "
        "alone.",
        "iterations-speed": "Accuracy against speed. Each marker is a pair of front-end/back-end iteration counts.",
    }
    figures = {"iterations-speed": figure} if (figure := _figure(points)) else {}
    return StudyResult("iterations", {"iterations": table}, figures, notes, "Iterations, speed and accuracy", captions)


def parse_counts(text: str) -> tuple[int, int]:
    """ "15/30" -> (15, 30). Raises UsageError."""
    front, slash, back = text.partition("/")
    if not (slash and front.strip().isdigit() and back.strip().isdigit() and int(front) > 0):
        raise UsageError(f"study option counts: '{text}' is not FRONT/BACK, for example 15/30")
    return int(front), int(back)


def _figure(points: list[tuple[str, str, Any, Any]]) -> dict[str, Any] | None:
    """A line per method through its pairs of counts: points of (method, counts, frames per second, ATE)."""
    known = [p for p in points if FAILED not in p[2:] and None not in p[2:]]
    if len(known) < 2:
        return None
    data = []
    for k, method in enumerate(dict.fromkeys(p[0] for p in known)):
        mine = [p for p in known if p[0] == method]
        data.append(
            {
                "type": "scatter",
                "mode": "lines+markers+text",
                "name": method,
                "text": [p[1] for p in mine],
                "textposition": "top center",
                "cliponaxis": False,
                "meta": {"run": -2, "colour": k},
                "x": [p[2] for p in mine],
                "y": [p[3] for p in mine],
                "line": {"width": 1.5},
                "marker": {"size": 10},
            }
        )
    layout = {
        "xaxis": {"title": {"text": "Frames per second"}, "type": "log"},
        "yaxis": {"title": {"text": "ATE RMSE [cm]"}, "type": "log"},
        "showlegend": True,
    }
    return {"data": data, "layout": layout}


def _settings(method: str, front: int, back: int) -> dict[str, Any]:
    """What a run of ``method`` with these counts changes."""
    return {"settings": dict(zip(OPTIONS.get(method, FLAT_OPTIONS), (front, back)))}
