"""The tables of a report, independent of the format they are written in."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from panobench.report.model import Collection, Origin, Run
from panobench.report.published import Published, published_block
from panobench.report.ranking import Summary, failure, ranks, summarise
from panobench.report.variants import Variant, variants

FAILED = "/"
NOT_AVAILABLE = "n/a"


@dataclass(frozen=True)
class Column:
    """A column: ``key`` for machines, ``label`` and ``unit`` for people, ``better`` "lower", "higher" or "none"."""

    key: str
    label: str
    unit: str = ""
    better: str = "none"
    numeric: bool = True
    about: str = ""


@dataclass(frozen=True)
class Cell:
    """What is printed (``text``), what is sorted by (``value``), and what stands beside it.

    coverage: share of frames tracked, 0..1. rank: 1 best, 2 second. spread: quartiles and interval in words.
    """

    text: str
    value: float | None = None
    coverage: float | None = None
    failed: bool = False
    rank: int | None = None
    spread: str = ""
    about: str = ""
    repeats: int = 1


@dataclass(frozen=True)
class Row:
    """cells in column order; ``facets`` are what filters look at; ``target`` an anchor to link to."""

    cells: tuple[Cell, ...]
    origin: Origin = "measured"
    facets: dict[str, str] = field(default_factory=dict)
    target: str = ""


@dataclass(frozen=True)
class Table:
    """A table with a name for files, a title, a caption, and notes printed below it."""

    name: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Quantity:
    """How one number of run.json is shown: scale to the unit printed, and digits after the point."""

    key: str
    label: str
    unit: str
    better: str
    scale: float = 1.0
    digits: int = 2
    about: str = ""

    def column(self) -> Column:
        return Column(self.key, self.label, self.unit, self.better, about=self.about)

    def text(self, value: float | None) -> str:
        return NOT_AVAILABLE if value is None else format_number(value * self.scale, self.digits)


RENDERING = (
    Quantity("psnr_db", "PSNR", "dB", "higher", about="three 120 x 60 degree pinhole views per pose"),
    Quantity("ssim", "SSIM", "", "higher", digits=3, about="same three views"),
    Quantity("lpips", "LPIPS", "", "lower", digits=3, about="same three views; needs the user's AlexNet weights"),
    Quantity("pano_psnr_db", "Pano PSNR", "dB", "higher", about="the panorama itself, frames that were mapped"),
    Quantity("ws_psnr_db", "WS-PSNR", "dB", "higher", about="weighted by the solid angle of each pixel"),
    Quantity("holdout_psnr_db", "Held-out PSNR", "dB", "higher", about="frames tracked but never mapped"),
    Quantity("novel_psnr_db", "Novel PSNR", "dB", "higher", about="views off the trajectory"),
)
COST = (
    Quantity("fps", "Frames/s", "1/s", "higher", about="whole system"),
    Quantity("tracking_fps", "Tracking", "1/s", "higher", about="tracking alone"),
    Quantity("latency_p50_s", "Latency p50", "ms", "lower", scale=1e3, digits=0),
    Quantity("latency_p95_s", "Latency p95", "ms", "lower", scale=1e3, digits=0),
    Quantity("wall_s", "Wall time", "s", "lower", digits=1),
    Quantity("peak_rss_bytes", "Peak memory", "MiB", "lower", scale=2**-20, digits=0, about="process tree"),
    Quantity("map_gaussians", "Map size", "Gaussians", "none", digits=0),
)
ACCURACY = (
    Quantity("ate_keyframes_rmse_m", "ATE keyframes", "mm", "lower", scale=1e3),
    Quantity("rpe_trans_rmse_m", "RPE", "mm", "lower", scale=1e3),
    Quantity("ate_percent", "ATE / path", "%", "lower", digits=3),
)


def format_number(value: float, digits: int) -> str:
    """Fixed digits, thousands separated by a thin space, infinities as the failure sign."""
    if not math.isfinite(value):
        return FAILED
    return f"{value:,.{digits}f}".replace(",", " ")


def length_unit(values: Sequence[float]) -> tuple[str, float]:
    """("mm", 1000) when a typical value is under 10 cm, else ("m", 1)."""
    ordered = sorted(v for v in values if math.isfinite(v))
    return ("mm", 1e3) if not ordered or ordered[len(ordered) // 2] < 0.1 else ("m", 1.0)


def length_text(value: float, unit: str) -> str:
    """A length already in ``unit``: three significant digits in mm, three decimals in m."""
    if unit == "m":
        return format_number(value, 3)
    return format_number(value, 2 if abs(value) < 10 else 1 if abs(value) < 100 else 0)


def build_tables(collection: Collection, published: Published | None = None) -> list[Table]:
    """Every table of the report: accuracy per dataset, rendering, cost, all runs, and the published figures."""
    grouped = variants(collection)
    tables: list[Table] = []
    for dataset in sorted({run.dataset for run in collection.runs}):
        tables.append(accuracy_table(dataset, grouped, published))
    tables.append(quantity_table("rendering", "Rendering quality", RENDERING, grouped))
    tables.append(quantity_table("cost", "Cost", COST, grouped))
    tables.append(runs_table(collection, grouped))
    return [drop_empty_columns(t) for t in tables if t.rows]


def accuracy_table(dataset: str, grouped: dict[Variant, list[Run]], published: Published | None = None) -> Table:
    """Methods by sequences of one dataset: ATE RMSE with coverage, sequences succeeded, and the mean."""
    here = {v: [r for r in runs if r.dataset == dataset] for v, runs in grouped.items()}
    here = {v: runs for v, runs in here.items() if runs}
    sequences = sorted({r.sequence for runs in here.values() for r in runs}, key=natural)
    values = [a for runs in here.values() for r in runs if not failure(r) and (a := r.number("ate_rmse_m")) is not None]
    unit, scale = length_unit(values)
    columns = [Column("method", "Method", numeric=False)]
    columns += [Column(s, s, unit, "lower") for s in sequences]
    if len(sequences) > 1:
        columns += [Column("succeeded", "Succeeded", "", "higher"), Column("mean", "Mean", unit, "lower")]
    scored: list[tuple[tuple[float, float], Row]] = []
    for variant, runs in here.items():
        cells = [Cell(variant.label)]
        cells += [ate_cell([r for r in runs if r.sequence == s], unit, scale) for s in sequences]
        done = [c.value for c in cells[1:] if c.value is not None]
        mean = sum(done) / len(done) if len(done) == len(sequences) else math.inf
        if len(sequences) > 1:
            cells.append(Cell(f"{len(done)}/{len(sequences)}", float(len(done))))
            cells.append(Cell(length_text(mean, unit), mean) if math.isfinite(mean) else Cell("–"))
        facets = {"method": variant.method, "status": "ok" if len(done) == len(sequences) else "failed"}
        scored.append(((-len(done), mean), Row(tuple(cells), variant.origin, facets)))
    rows = mark_ranks(columns, [row for _, row in sorted(scored, key=lambda s: s[0])])
    notes: tuple[str, ...] = ()
    if published is not None:
        extra, notes = published_block(published, dataset, sequences, unit, scale)
        rows += [_published_row(label, cells, unit, len(sequences) > 1) for label, cells in extra]
    caption = f"ATE RMSE in {unit} after alignment; below each, the share of frames tracked. Lower is better."
    if any(cell.repeats > 1 for row in rows for cell in row.cells):
        caption += (
            " Cells with repeats show the median of n runs, with the interquartile range (IQR)"
            " and the bootstrap 95% interval of the median."
        )
    return Table(
        f"ate-{dataset}",
        f"Trajectory accuracy, {dataset}",
        caption,
        tuple(columns),
        tuple(rows),
        notes,
    )


def _published_row(label: str, values: list[float | None], unit: str, with_mean: bool) -> Row:
    cells = [Cell(label)]
    for value in values:
        cells.append(
            Cell(FAILED, failed=True, about="failure in the source")
            if value is None
            else Cell(length_text(value, unit), value)
        )
    if with_mean:
        done = [v for v in values if v is not None]
        cells.append(Cell(f"{len(done)}/{len(values)}", float(len(done))))
        full = len(done) == len(values)
        cells.append(Cell(length_text(sum(done) / len(done), unit), sum(done) / len(done)) if full else Cell("–"))
    return Row(tuple(cells), "published", {"method": label, "status": "published"})


def ate_cell(runs: Sequence[Run], unit: str, scale: float) -> Cell:
    """Repeats of one variant on one sequence as one cell."""
    if not runs:
        return Cell("–", about="not run")
    reasons = [reason for r in runs if (reason := failure(r))]
    values = [None if failure(r) else r.number("ate_rmse_m") for r in runs]
    covered = [t for r in runs if (t := r.number("tracked")) is not None]
    coverage = min(covered) if covered else None
    summary = summarise([None if v is None else v * scale for v in values], len(reasons))
    if summary is None:
        return Cell(NOT_AVAILABLE, coverage=coverage, about="no ground truth to compare with")
    if not summary.ok:
        return Cell(FAILED, coverage=coverage, failed=True, about=", ".join(sorted(set(reasons))), repeats=len(runs))
    spread = spread_text(summary, lambda v: length_text(v, unit))
    about = f"{len(reasons)} of {len(runs)} repeats failed" if reasons else ""
    return Cell(length_text(summary.median, unit), summary.median, coverage, False, None, spread, about, len(runs))


def spread_text(summary: Summary, text: Callable[[float], str]) -> str:
    """Quartiles and 95% interval of repeats in words, empty for a single run."""
    if summary.count < 2:
        return ""
    words = f"n = {summary.count}; IQR {text(summary.low)}–{text(summary.high)}"
    if summary.interval is not None:
        words += f"; 95% {text(summary.interval[0])}–{text(summary.interval[1])}"
    return words


def quantity_table(name: str, title: str, quantities: Sequence[Quantity], grouped: dict[Variant, list[Run]]) -> Table:
    """Variants by quantities, one row per dataset: median over repeats, mean over sequences."""
    columns = [Column("method", "Method", numeric=False), Column("dataset", "Dataset", numeric=False)]
    columns += [Column("sequences", "Sequences")] + [q.column() for q in quantities]
    rows: list[Row] = []
    for dataset in sorted({r.dataset for runs in grouped.values() for r in runs}):
        block: list[Row] = []
        for variant, runs in grouped.items():
            good = [r for r in runs if r.dataset == dataset and not failure(r)]
            if not any(r.number(q.key) is not None for r in good for q in quantities):
                continue
            sequences = sorted({r.sequence for r in good})
            cells = [Cell(variant.label), Cell(dataset), Cell(str(len(sequences)), float(len(sequences)))]
            for quantity in quantities:
                cells.append(_mean_of_medians(good, sequences, quantity))
            block.append(Row(tuple(cells), variant.origin, {"method": variant.method, "dataset": dataset}))
        rows += mark_ranks(columns, block)
    caption = "Mean over the sequences a method succeeded on, each the median of its repeats."
    return Table(name, title, caption, tuple(columns), tuple(rows))


def _mean_of_medians(runs: Sequence[Run], sequences: Sequence[str], quantity: Quantity) -> Cell:
    medians: list[float] = []
    for sequence in sequences:
        values = [r.number(quantity.key) for r in runs if r.sequence == sequence]
        summary = summarise(values, 0)
        if summary is not None:
            medians.append(summary.median)
    if not medians:
        return Cell(NOT_AVAILABLE)
    mean = sum(medians) / len(medians)
    about = "" if len(medians) == len(sequences) else f"{len(medians)} of {len(sequences)} sequences"
    return Cell(quantity.text(mean), mean * quantity.scale, about=about)


def runs_table(collection: Collection, grouped: dict[Variant, list[Run]]) -> Table:
    """One row per run, with everything that was measured."""
    ate = Quantity("ate_rmse_m", "ATE", "mm", "lower", scale=1e3)
    quantities = (*ACCURACY, *RENDERING, *COST)
    columns = [Column("method", "Method", numeric=False), Column("dataset", "Dataset", numeric=False)]
    columns += [Column("sequence", "Sequence", numeric=False), Column("seed", "Seed")]
    columns += [Column("status", "Status", numeric=False), ate.column()]
    columns += [Column("tracked", "Tracked", "%", "higher")] + [q.column() for q in quantities]
    label = {id(r): v for v, runs in grouped.items() for r in runs}
    rows = []
    for run in collection.runs:
        variant, reason = label[id(run)], failure(run)
        tracked, error = run.number("tracked"), run.number("ate_rmse_m")
        cells = [Cell(variant.label), Cell(run.dataset), Cell(run.sequence)]
        cells += [Cell("–" if run.seed is None else str(run.seed), None if run.seed is None else float(run.seed))]
        cells += [Cell(run.status if not reason or reason == run.status else f"{run.status}, {reason}")]
        if reason:
            cells.append(Cell(FAILED, failed=True, about=reason))
        elif error is None:
            cells.append(Cell(NOT_AVAILABLE))
        else:
            cells.append(Cell(length_text(error * 1e3, "mm"), error * 1e3))
        cells += [Cell(NOT_AVAILABLE) if tracked is None else Cell(f"{100 * tracked:.0f}", 100 * tracked)]
        for quantity in quantities:
            value = run.number(quantity.key)
            cells.append(Cell(quantity.text(value), None if value is None else value * quantity.scale))
        facets = {"method": variant.method, "sequence": run.sequence, "status": "failed" if reason else "ok"}
        rows.append(Row(tuple(cells), run.origin, facets, target=run_anchor(collection, run)))
    return Table("runs", "All runs", "One row per run, as measured.", tuple(columns), tuple(rows))


def run_anchor(collection: Collection, run: Run) -> str:
    """The id of a run's own section in the HTML report."""
    return f"run-{next(i for i, r in enumerate(collection.runs) if r is run)}"


def mark_ranks(columns: Sequence[Column], rows: list[Row]) -> list[Row]:
    """The same rows with best and second best marked per column; published and failed cells do not compete."""
    for j, column in enumerate(columns):
        competing = [row.origin != "published" and not row.cells[j].failed for row in rows]
        marks = ranks(
            [row.cells[j].text if ok else None for row, ok in zip(rows, competing)],
            [row.cells[j].value if ok else None for row, ok in zip(rows, competing)],
            column.better,
        )
        rows = [
            replace(row, cells=(*row.cells[:j], replace(row.cells[j], rank=mark), *row.cells[j + 1 :]))
            for row, mark in zip(rows, marks)
        ]
    return rows


def drop_empty_columns(table: Table) -> Table:
    """Without the numeric columns in which no row has a value or a failure."""
    keep = [
        j
        for j, column in enumerate(table.columns)
        if not column.numeric or any(r.cells[j].value is not None or r.cells[j].failed for r in table.rows)
    ]
    rows = tuple(replace(r, cells=tuple(r.cells[j] for j in keep)) for r in table.rows)
    return replace(table, columns=tuple(table.columns[j] for j in keep), rows=rows)


def natural(text: str) -> list[tuple[int, int, str]]:
    """Sort key that puts room2 before room10."""
    import re

    return [(0, int(w), "") if w.isdigit() else (1, 0, w) for w in re.findall(r"\d+|\D+", text)]
