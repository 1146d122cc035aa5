"""Write all figures of a report into a folder."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from panobench.report.build import safe_name
from panobench.report.model import Collection, Run
from panobench.report.paper.curves import accuracy_speed, error_over_time, study_chart
from panobench.report.paper.paths import paths
from panobench.report.paper.strips import strips
from panobench.report.paper.style import Style, drawing, save
from panobench.report.ranking import failure
from panobench.report.sections import speed_points
from panobench.report.table_model import renamed
from panobench.report.variants import variants


def write_figures(
    collection: Collection, folder: Path, width: float, formats: Sequence[str], names: dict[str, str] | None = None
) -> list[Path]:
    """The figures there is something to show in; their files, in the order written.

    width: inches. formats: of ``style.FORMATS``. names: what to call methods, by what they are called.
    Raises UnavailableError where a format cannot be written here, and OutputError.
    """
    written: list[Path] = []
    with drawing():
        for name, draw in figures_of(collection, names or {}):
            written += save(draw, folder / name, width, formats)
    return written


def figures_of(collection: Collection, names: dict[str, str]) -> list[tuple[str, Callable[[Style], Any]]]:
    """(file name without suffix, function that draws it) of every figure that a report may have."""
    found: list[tuple[str, Callable[[Style], Any]]] = []
    grouped = variants(collection)
    label_of = {id(run): renamed(variant.label, names) for variant, runs in grouped.items() for run in runs}
    for dataset, sequence in collection.places():
        here = collection.at((dataset, sequence))
        chosen = [
            typical(mine) for runs in grouped.values() if (mine := [r for r in runs if any(r is h for h in here)])
        ]
        labels = [label_of[id(run)] for run in chosen]
        scaled = all(run.record.groundtruth_scaled for run in chosen if run.groundtruth is not None)
        stem = safe_name(f"{dataset}-{sequence}" if dataset != sequence else dataset)
        found.append((f"{stem}-paths", partial(paths, chosen, labels, scaled)))
        found.append((f"{stem}-error", partial(error_over_time, chosen, labels, scaled)))
        found.append((f"{stem}-pictures", partial(strips, chosen, labels)))
    points = [{**point, "label": renamed(point["label"], names)} for point in speed_points(grouped)]
    found.append(("accuracy-speed", partial(accuracy_speed, points)))
    for study in collection.studies:
        for name, chart in study.result.figures.items():
            found.append((safe_name(f"{study.result.name}-{name}"), partial(study_chart, chart)))
    return found


def typical(runs: Sequence[Run]) -> Run:
    """The repeat with the median ATE; a figure of all would hide what it shows. A failed one where most failed."""

    def standing(run: Run) -> tuple[bool, float]:
        ate = run.number("ate_rmse_m")
        return failure(run) is not None, float("inf") if ate is None else ate

    return sorted(runs, key=standing)[(len(runs) - 1) // 2]
