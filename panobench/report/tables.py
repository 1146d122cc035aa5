"""The tables of a report, independent of the format they are written in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from panobench.bench.records.paper import Published
from panobench.bench.records.statistics import summarise
from panobench.bench.run.request import run_options
from panobench.report.accuracy import accuracy_tables, competes, conditions, facts, flags
from panobench.report.model import Collection, Run
from panobench.report.ranking import failure
from panobench.report.studies import study_tables
from panobench.report.table_model import (
    FAILED,
    NOT_AVAILABLE,
    NOT_RUN,
    Cell,
    Column,
    Row,
    Table,
    drop_empty_columns,
    format_number,
    length_text,
    mark_ranks,
)
from panobench.report.variants import Variant, variants


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
    Quantity(
        "psnr_db", "PSNR", "dB", "higher", about="three 120 x 60 degree views per pose, cut from render and frame alike"
    ),
    Quantity("ssim", "SSIM", "", "higher", digits=3, about="same three views"),
    Quantity("lpips", "LPIPS", "", "lower", digits=3, about="same three views; needs the user's AlexNet weights"),
    Quantity("pano_psnr_db", "Pano PSNR", "dB", "higher", about="the panorama itself, frames that were mapped"),
    Quantity("ws_psnr_db", "WS-PSNR", "dB", "higher", about="weighted by the solid angle of each pixel"),
    Quantity("holdout_psnr_db", "Held-out PSNR", "dB", "higher", about="frames tracked but never mapped"),
    Quantity("novel_psnr_db", "Novel PSNR", "dB", "higher", about="views off the trajectory"),
)
COST = (
    Quantity("fps", "Whole system", "frames/s", "higher"),
    Quantity("tracking_fps", "Tracking alone", "frames/s", "higher"),
    Quantity("latency_p50_s", "Latency p50", "ms", "lower", scale=1e3, digits=0),
    Quantity("latency_p95_s", "Latency p95", "ms", "lower", scale=1e3, digits=0),
    Quantity("wall_s", "Wall time", "s", "lower", digits=1),
    Quantity("peak_rss_bytes", "Peak memory", "MiB", "lower", scale=2**-20, digits=0, about="process tree"),
    Quantity("map_gaussians", "Map size", "Gaussians", "none", digits=0),
)
METRIC = (
    Quantity("ate_se3_rmse_m", "ATE SE(3)", "mm", "lower", scale=1e3, about="without scale alignment; metric methods"),
    Quantity("scale_error_percent", "Scale error", "%", "lower", digits=3, about="metric methods"),
    Quantity("gravity_error_deg", "Gravity error", "deg", "lower", digits=3, about="gravity-aligned methods"),
    Quantity("challenge_score", "Challenge score", "", "higher", about="of 100, hilti-360 only"),
)
ACCURACY = (
    *METRIC,
    Quantity("ate_keyframes_rmse_m", "ATE keyframes", "mm", "lower", scale=1e3),
    Quantity("rpe_trans_rmse_m", "RPE", "mm", "lower", scale=1e3),
    Quantity("ate_percent", "ATE / path", "%", "lower", digits=3),
)


def build_tables(collection: Collection, published: Published | None = None) -> list[Table]:
    """Every table of the report: those of the studies, then accuracy per dataset, rendering, cost, and all runs."""
    return study_tables(collection.studies) + run_tables(collection, published)


def run_tables(collection: Collection, published: Published | None = None) -> list[Table]:
    """The tables of the runs alone."""
    grouped = variants(collection)
    tables: list[Table] = []
    works = {run.dataset for run in collection.runs if not failure(run)}
    for dataset in sorted({run.dataset for run in collection.runs}, key=lambda name: (name not in works, name)):
        tables += accuracy_tables(dataset, grouped, published)
    tables.append(metric_table(grouped))
    tables.append(quantity_table("rendering", "Rendering quality", RENDERING, grouped))
    tables.append(quantity_table("cost", "Cost", COST, grouped))
    tables.append(runs_table(collection, grouped))
    filled = [drop_empty_columns(t) for t in tables]
    return [t for t in filled if t.rows and any(c.numeric for c in t.columns)]


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
            facets = {"method": variant.method, "dataset": dataset}
            # means over other sequences, or of pictures of another size, are no better or worse
            inputs = [option.name for option in run_options() if option.changes_input and option.label is not None]
            group = f"{', '.join(sequences)}; {conditions(good, inputs)}"
            block.append(
                Row(
                    tuple(cells),
                    variant.origin,
                    facets,
                    flags=flags(good),
                    competes=competes(good),
                    group=group,
                    facts={**facts(good), "dataset": dataset},
                )
            )
        rows += mark_ranks(columns, block)
    caption = "Mean over the sequences a method succeeded on, each the median of its repeats."
    return Table(name, title, caption, tuple(columns), tuple(rows))


def metric_table(grouped: dict[Variant, list[Run]]) -> Table:
    """Both errors of the methods that know their scale, after Sim(3) and after SE(3) alignment, and what tells them
    apart.
    """
    known = {v: [r for r in runs if r.record.metric and not r.given_poses] for v, runs in grouped.items()}
    ate = Quantity("ate_rmse_m", "ATE Sim(3)", "mm", "lower", scale=1e3, about="after alignment with scale")
    return quantity_table("metric", "Methods that know their scale", (ate, *METRIC), known)


def _mean_of_medians(runs: Sequence[Run], sequences: Sequence[str], quantity: Quantity) -> Cell:
    medians: list[float] = []
    for sequence in sequences:
        values = [v for r in runs if r.sequence == sequence and (v := r.number(quantity.key)) is not None]
        summary = summarise(values)
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
        cells += [Cell(NOT_RUN if run.seed is None else str(run.seed), None if run.seed is None else float(run.seed))]
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
        anchor = run_anchor(collection, run)
        rows.append(Row(tuple(cells), run.origin, facets, target=anchor, flags=flags([run]), facts=facts([run])))
    return Table("runs", "All runs", "One row per run, as measured.", tuple(columns), tuple(rows))


def run_anchor(collection: Collection, run: Run) -> str:
    """The id of a run's own section in the HTML report."""
    return f"run-{next(i for i, r in enumerate(collection.runs) if r is run)}"
