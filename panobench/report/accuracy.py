"""The accuracy table: methods by sequences, with ATE RMSE and coverage in every cell."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from panobench.bench.records.cautions import CAUTIONS
from panobench.bench.records.paper import Published
from panobench.bench.records.statistics import Ranked, rank, sequence_mean, summarise
from panobench.bench.run.request import run_options
from panobench.report.model import Run
from panobench.report.published import Block, published_block
from panobench.report.ranking import failure
from panobench.report.table_model import (
    FAILED,
    NOT_AVAILABLE,
    NOT_RUN,
    Cell,
    Column,
    Row,
    Table,
    format_number,
    length_text,
    length_unit,
    mark_ranks,
    natural,
    spread_text,
)
from panobench.report.variants import Variant


def accuracy_tables(
    dataset: str, grouped: Mapping[Variant, list[Run]], published: Published | None = None
) -> list[Table]:
    """Methods by sequences of one dataset: ATE RMSE with coverage, sequences succeeded, and the mean.

    Sequences whose ground truth has no scale make a table of their own, in percent of the path; there may be none.
    """
    here = {v: [r for r in runs if r.dataset == dataset] for v, runs in grouped.items()}
    shares = {r.sequence for runs in here.values() for r in runs if not r.record.groundtruth_scaled}
    parts = [{v: [r for r in runs if (r.sequence in shares) == share] for v, runs in here.items()} for share in (0, 1)]
    lengths, percents = ({v: runs for v, runs in part.items() if runs} for part in parts)
    tables = [_accuracy_table(dataset, lengths, published, "ate_rmse_m")] if lengths else []
    return [*tables, *([_accuracy_table(dataset, percents, None, "ate_percent")] if percents else [])]


def _accuracy_table(dataset: str, here: Mapping[Variant, list[Run]], published: Published | None, error: str) -> Table:
    """``error``: the metric shown, "ate_rmse_m" or "ate_percent"."""
    sequences = sorted({r.sequence for runs in here.values() for r in runs}, key=natural)
    unit, scale = "%", 1.0
    if error == "ate_rmse_m":
        unit, scale = length_unit(
            [
                ate
                for runs in here.values()
                for r in runs
                if not failure(r) and not r.given_poses and (ate := r.number(error)) is not None
            ]
        )
    cells = {
        v: [ate_cell([r for r in runs if r.sequence == s], unit, scale, error) for s in sequences]
        for v, runs in here.items()
    }
    judged = [v for v in cells if not given(here[v])]
    everywhere = [v for v in judged if all(c.text != NOT_RUN for c in cells[v])] or judged
    common = common_sequences([cells[v] for v in everywhere])
    columns = [Column("method", "Method", numeric=False)] + [
        Column(s, s, unit, "lower", sequence=True) for s in sequences
    ]
    if len(sequences) > 1:
        columns.append(Column("succeeded", "Succeeded", "", "higher"))
        columns.append(Column("mean", "Geom. mean", unit, "lower", about="geometric mean, see the ranking rule"))
    order = rank({str(i): [c.value for c in cells[v]] for i, v in enumerate(everywhere)})
    rows = [_row(everywhere[int(p.name)], p, cells, here, unit) for p in order]
    rows += [_row(v, None, cells, here, unit) for v in judged if v not in everywhere]
    rows += [_row(v, None, cells, here, unit) for v in cells if v not in judged]
    rows = mark_ranks(columns, rows)
    everyone = [r for runs in here.values() for r in runs]
    block = published_block(published, dataset, sequences, everyone, scale) if published else Block()
    rows += [_published_row(label, values, unit, common, block.flags) for label, values in block.rows]
    notes = block.notes
    caption = f"ATE RMSE in {unit} after alignment. Lower is better."
    if error == "ate_percent":
        caption = "ATE RMSE after alignment in % of the path: the ground truth has no scale. Lower is better."
    below = "Below each, the share of frames tracked."
    if any(cell.repeats > 1 for row in rows for cell in row.cells):
        caption += " Cells with repeats show the median of their runs."
        below += (
            " Below medians stand the number of runs (n), the interquartile range (IQR)"
            " and the bootstrap 95% interval of the median."
        )
    if judged and len(common) < len(sequences):
        where = "where all methods succeed that were run everywhere and succeed somewhere"
        names = ", ".join(sequences[j] for j in common)
        notes = (*notes, f"The mean is over {names}: {where}." if common else f"No mean: there is no sequence {where}.")
    if len(judged) < len(cells):
        notes = (*notes, "Methods that were given the poses show them again: they are not ranked.")
    notes = (*notes, *_truth_notes([r for runs in here.values() for r in runs]))
    if any(p.differs for p in order):
        notes = (*notes, "† differs significantly from the first method (see the ranking rule).")
    name, title = f"ate-{dataset}", f"Trajectory accuracy, {dataset}"
    if error == "ate_percent":
        name, title = f"ate-percent-{dataset}", f"{title}, in percent of the path"
    return Table(name, title, caption, tuple(columns), tuple(rows), notes, below)


def _truth_notes(runs: Sequence[Run]) -> list[str]:
    """What the errors leave out: frames without ground truth; and clocks that were aligned."""
    found: dict[str, None] = {}
    for run in sorted(runs, key=lambda r: natural(r.sequence)):
        truth, planned = run.record.truth, run.record.frames.planned
        if truth is not None and planned and truth.frames < planned:
            found[f"{run.sequence}: ground truth for {truth.frames} of {planned} frames."] = None
        if truth is not None and truth.time_offset_s is not None:
            found[f"{run.sequence}: ground truth moved by {truth.time_offset_s:+.4f} s to fit the motion."] = None
    return list(found)


def ate_cell(runs: Sequence[Run], unit: str, scale: float, error: str = "ate_rmse_m") -> Cell:
    """Repeats of one variant on one sequence as one cell; ``scale`` takes the metric ``error`` to ``unit``."""
    if not runs:
        return Cell(NOT_RUN, about="not run")
    reasons = [reason for r in runs if (reason := failure(r))]
    covered = [t for r in runs if (t := r.number("tracked")) is not None]
    coverage = min(covered) if covered else None
    values: list[float | None] = [None] * len(reasons)
    values += [a * scale for r in runs if not failure(r) and (a := r.number(error)) is not None]
    summary = summarise(values)
    if summary is None:
        reasons = [note for r in runs if (note := r.record.notes.get(error))]
        return Cell(NOT_AVAILABLE, coverage=coverage, about=next(iter(reasons), "no ground truth to compare with"))
    if not math.isfinite(summary.median):
        return Cell(FAILED, coverage=coverage, failed=True, about=", ".join(sorted(set(reasons))), repeats=len(runs))
    part = conditions(runs, ("every", "max_frames"))  # other frames are other data
    spread = spread_text(summary, lambda v: error_text(v, unit))
    about = f"{len(reasons)} of {len(runs)} repeats failed" if reasons else ""
    text = error_text(summary.median, unit)
    return Cell(text, summary.median, coverage, spread=spread, about=about, repeats=len(runs), group=part)


def error_text(value: float, unit: str) -> str:
    """An error already in ``unit``: a length, or a share of the path."""
    return format_number(value, 3) if unit == "%" else length_text(value, unit)


def common_sequences(rows: Sequence[Sequence[Cell]]) -> list[int]:
    """Indices of the sequences on which every method has a value that has one anywhere."""
    alive = [row for row in rows if any(c.value is not None for c in row)]
    return [j for j in range(len(rows[0]) if rows else 0) if all(row[j].value is not None for row in alive)]


def flags(runs: Sequence[Run]) -> tuple[str, ...]:
    """Warnings that a reader must see before comparing a row: those of ``CAUTIONS`` that hold for any of its runs."""
    told = {word for run in runs for word in run.cautions}
    return tuple(word for word in CAUTIONS if word in told)


def competes(runs: Sequence[Run]) -> bool:
    """Whether they may be the best of a column: not with given poses, nor where the verdict on a run is not trusted."""
    return not given(runs) and not any(run.doubtful for run in runs)


def given(runs: Sequence[Run]) -> bool:
    """Whether the runs were given their poses: they are not ranked then."""
    return any(run.given_poses for run in runs)


def _row(
    variant: Variant,
    place: Ranked | None,
    cells: Mapping[Variant, list[Cell]],
    runs: Mapping[Variant, list[Run]],
    unit: str,
) -> Row:
    """A method's row; ``place`` is its rank, None when it was not run on every sequence.

    A dagger marks a significant difference from the best.
    """
    mine = cells[variant]
    # a run without ground truth to compare with has no error, and did not fail for that
    done, tried = sum(c.text not in (FAILED, NOT_RUN) for c in mine), sum(c.text != NOT_RUN for c in mine)
    row = [Cell(f"{variant.label} †" if place and place.differs else variant.label), *mine]
    if len(mine) > 1:
        mean = place.mean if place else None
        row.append(Cell(f"{done}/{tried}", float(done)))
        row.append(Cell(NOT_RUN) if mean is None else Cell(error_text(mean, unit), mean))
    facets = {"method": variant.method, "status": "ok" if done == tried else "failed"}
    mine_runs = runs[variant]
    return Row(
        tuple(row),
        variant.origin,
        facets,
        flags=flags(mine_runs),
        competes=competes(mine_runs),
        facts={**facts(mine_runs), "dataset": mine_runs[0].dataset},
    )


def conditions(runs: Sequence[Run], names: Sequence[str]) -> str:
    """The values of run options that decide which runs can be the best of the same column."""
    return "; ".join(f"{name} {','.join(sorted({run.option(name) for run in runs}))}" for name in names)


def facts(runs: Sequence[Run]) -> dict[str, str]:
    """What is the same for all runs of a row: method, and every run option that labels may name."""
    shared = {"method": {run.method for run in runs}}
    for option in run_options():
        if option.label is not None and option.name != "settings":
            shared[option.name] = {run.option(option.name) for run in runs}
    return {name: values.pop() if len(values) == 1 else "" for name, values in shared.items()}


def _published_row(
    label: str, values: Sequence[float | None], unit: str, common: Sequence[int], told: tuple[str, ...]
) -> Row:
    cells = [Cell(label)]
    for value in values:
        if value is None:
            cells.append(Cell(FAILED, failed=True, about="failure in the source"))
        else:
            absent = Cell(NOT_RUN, about="nothing is published")
            cells.append(absent if math.isnan(value) else Cell(error_text(value, unit), value))
    if len(values) > 1:
        tried = sum(v is None or not math.isnan(v) for v in values)
        done = sum(v is not None and not math.isnan(v) for v in values)
        cells.append(Cell(f"{done}/{tried}", float(done)))
        shared = [v for j in common if (v := values[j]) is not None and not math.isnan(v)]
        mean = sequence_mean(shared) if len(shared) == len(common) else None
        cells.append(Cell(NOT_RUN) if mean is None else Cell(error_text(mean, unit), mean))
    return Row(tuple(cells), "published", {"method": label, "status": "published"}, flags=told, facts={"method": label})
