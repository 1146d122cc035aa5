"""The field-of-view study: the same frames, seen through 120, 200, 280 and 360 degrees (the paper's FoV table)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from panobench.bench.records.study_record import StudyResult
from panobench.studies.base import StudyRequest
from panobench.studies.cells import FAILED, QUICK, RunOptions, mean, median, reasons, run_cells
from panobench.studies.published import columns, published_table, source_notes

FULL_TURN = 360.0
Points = list[tuple[float, list[Any]]]


@dataclass(frozen=True)
class FovOptions(RunOptions):
    """fov: horizontal, degrees, of panoramas whose other pixels are invalid. pinhole: also the paper's 120x60 view.

    baseline, baseline_preset: a pinhole method to stand beside it on that view, None for none. Without a GPU the
    published steps of MonoGS would take longer than everything else.
    """

    fov: tuple[float, ...] = (120.0, 200.0, 280.0, 360.0)
    pinhole: bool = True
    baseline: str | None = "monogs"
    baseline_preset: str | None = "fast"


def run(study: StudyRequest) -> StudyResult:
    """ATE per sequence and field of view."""
    options = study.choose(FovOptions(), QUICK)
    label = f"{options.method} {options.preset}" if options.preset else options.method
    rows: list[tuple[str, str, str, dict[str, Any]]] = []
    view = {"camera": "pinhole:front", "width": pinhole_width(options.width)}
    if options.baseline:
        own = {"method": options.baseline, "preset": options.baseline_preset, "depth": None}
        name = f"{options.baseline} {options.baseline_preset}" if options.baseline_preset else options.baseline
        rows.append((name, "pinhole", "120° x 60°", {**view, **own}))
    if options.pinhole:
        rows.append((label, "pinhole", "120° x 60°", view))
    for degrees in options.fov:
        rows.append((label, "panorama", f"{degrees:g}°", {"fov": None if degrees >= FULL_TURN else f"{degrees:g}"}))
    cells = {
        (method, camera, text, sequence): [options.cell(sequence, seed, **changes) for seed in options.seeds]
        for method, camera, text, changes in rows
        for sequence in options.sequences
    }
    flat = [cell for group in cells.values() for cell in group]
    results = run_cells(study, "fov", flat)
    table, points = [], []
    for method, camera, text, _ in rows:
        groups = [cells[method, camera, text, s] for s in options.sequences]
        errors = [median(results, group, "ate_rmse_m", 100.0) for group in groups]
        tracked = mean([median(results, group, "tracked", 100.0, higher_is_better=True) for group in groups])
        row: dict[str, Any] = {"Method": method, "Camera": camera, "FoV": text}
        row |= {f"{s} [cm] ↓": e for s, e in zip(options.sequences, errors)}
        table.append({**row, "Mean [cm] ↓": mean(errors), "Tracked [%] ↑": tracked, "source": "measured"})
        if camera == "panorama":
            points.append((float(text[:-1]), errors))
    paper = published_table(options.dataset, "fov_synpano_ate_cm")
    for name in paper:
        if name == "sequences" or not any(s in paper["sequences"] for s in options.sequences):
            continue
        method, _, angle = name.rpartition(" ")
        errors = columns(paper, name, options.sequences)
        row = {"Method": method, "Camera": "pinhole" if method == "MonoGS" else "panorama", "FoV": f"{angle}°"}
        row |= {f"{s} [cm] ↓": e for s, e in zip(options.sequences, errors)}
        table.append({**row, "Mean [cm] ↓": mean(errors), "Tracked [%] ↑": None, "source": "published"})
    figures = [(float(n.rpartition(" ")[2]), columns(paper, n, options.sequences)) for n in paper if "Pano" in n]
    notes = [
        *order_notes(points, figures),
        "A panorama of a limited field of view keeps all latitudes; pixels outside are invalid, and the others keep "
        "their rays. The pinhole view has the panorama's angular resolution in its middle. Panoramas are "
        f"{options.width} pixels wide{f', one frame in {options.every}' if options.every > 1 else ''}.",
        *(source_notes(options.dataset) if len(table) > len(rows) else []),
        *reasons(results, flat),
    ]
    return StudyResult(
        "fov",
        {"fov": table},
        {"errors": _figure(options.sequences, points, paper)} if points else {},
        notes,
        "Accuracy against field of view",
        {
            "fov": "Accuracy against field of view. ATE RMSE after alignment, median over repeats; lower is better.",
            "errors": "Error against field of view. Dotted: published figures, of other rooms.",
        },
    )


def order_notes(points: Points, published: Points) -> list[str]:
    """How often a wider view is the more accurate one, here and in the paper; points: degrees, error per sequence."""
    good, steps = _improvements(points)
    if not steps:
        return []
    text = f"A wider view is more accurate in {good} of {steps} steps from one field of view to the next"
    good, steps = _improvements(published)
    return [text + (f" (in the paper: {good} of {steps})." if steps else ".")]


def _improvements(points: Points) -> tuple[int, int]:
    """Steps to the next wider view in which the error of a sequence falls, and all steps; a lost run errs most."""
    pairs = []
    for (_, narrow), (_, wide) in itertools.pairwise(sorted(points)):
        pairs += [
            (a, b) for a, b in zip(narrow, wide) if a is not None and b is not None and (a, b) != (FAILED, FAILED)
        ]
    return sum(a == FAILED or (b != FAILED and b < a) for a, b in pairs), len(pairs)


def pinhole_width(panorama_width: int) -> int:
    """Width of a 120 degree pinhole image with the panorama's angular resolution in its middle, a multiple of 16."""
    pixels = 2 * np.tan(np.deg2rad(60)) * panorama_width / (2 * np.pi)
    return max(16, 16 * round(pixels / 16))


def _figure(sequences: tuple[str, ...], points: list[tuple[float, list[Any]]], paper: Any) -> dict[str, Any]:
    """A line per sequence; the paper's as dotted lines of the same colour."""
    data = []
    for k, sequence in enumerate(sequences):
        known = [(fov, errors[k]) for fov, errors in points if errors[k] not in (None, FAILED)]
        data.append(_line(sequence, known, k))
        if paper and sequence in paper["sequences"]:
            own = [
                (float(name.rpartition(" ")[2]), columns(paper, name, [sequence])[0])
                for name in paper
                if "Pano" in name
            ]
            data.append({**_line(f"{sequence}, published", own, k), "line": {"dash": "dot", "width": 1.2}})
    axis = {"title": {"text": "Horizontal field of view [°]"}, "tickvals": [fov for fov, _ in points]}
    return {
        "data": data,
        "layout": {"xaxis": axis, "yaxis": {"title": {"text": "ATE RMSE [cm]"}, "type": "log"}, "showlegend": True},
    }


def _line(name: str, points: list[tuple[float, Any]], colour: int) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines+markers",
        "name": name,
        "meta": {"run": -2, "colour": colour},
        "x": [x for x, _ in points],
        "y": [y for _, y in points],
        "line": {"width": 2},
        "marker": {"size": 7},
    }
