"""The ablation study: PanoGS-SLAM with one part taken out or exchanged at a time (the paper's ablation table)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from panobench.bench.records.study_record import StudyResult
from panobench.studies.base import StudyRequest
from panobench.studies.cells import FAILED, QUICK, RunOptions, geometric_mean, mean, median, reasons, run_cells
from panobench.studies.published import published_table, source_notes

#: Row -> (what it changes in panogs's options, what it changes in the run).
VARIANTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "PanoGS-SLAM": ({}, {}),
    "w/o L_pano": ({"rendering.weights": "uniform"}, {}),
    "w L_GS": ({"rendering.weights": "gaussian"}, {}),
    "w/o DGIS": ({"seeding.depth_guided": False, "fixed_lag.sweep": False}, {"depth": "constant"}),
    "ERP projection": ({"rendering.projection": "erp"}, {}),
    "Adam tracking": ({"tracking.solver": "adam"}, {}),
}
METRICS = (
    ("ATE [cm] ↓", "ate_rmse_m", 100.0, False),
    ("PSNR [dB] ↑", "psnr_db", 1.0, True),
    ("SSIM ↑", "ssim", 1.0, True),
    ("LPIPS ↓", "lpips", 1.0, False),
    ("Frames/s ↑", "fps", 1.0, True),
)
#: Beside the paper's mean, which the hardest room decides.
GEOMETRIC = "ATE geom. mean [cm] ↓"
_PAPER = {"ATE [cm] ↓": "ate_cm", "PSNR [dB] ↑": "psnr_db", "SSIM ↑": "ssim", "LPIPS ↓": "lpips"}


@dataclass(frozen=True)
class AblationOptions(RunOptions):
    """presets: the ablation is made from each of these ("default", "paper").

    every: by default one frame in two, so that sixty runs see the whole path in half the time.
    """

    every: int = 2
    presets: tuple[str, ...] = ("default", "paper")


def run(study: StudyRequest) -> StudyResult:
    """Averages over the sequences for every variant, and each sequence's ATE."""
    options = study.choose(AblationOptions(), {**QUICK, "every": 1, "presets": ("default",), "seeds": (0, 1, 2)})
    cells = {}
    for preset in options.presets:
        for variant, (settings, changes) in variants(preset).items():
            for sequence in options.sequences:
                chosen = {"preset": None if preset == "default" else preset, "settings": settings, **changes}
                cells[preset, variant, sequence] = [options.cell(sequence, s, **chosen) for s in options.seeds]
    flat = [cell for group in cells.values() for cell in group]
    results = run_cells(study, "ablation", flat)
    averages, details = [], []
    for preset in options.presets:
        for variant in variants(preset):
            groups = [cells[preset, variant, s] for s in options.sequences]
            row: dict[str, Any] = {"Method": variant, "Preset": preset}
            errors = [median(results, g, "ate_rmse_m", 100.0) for g in groups]
            row[GEOMETRIC] = geometric_mean(errors) if len(errors) > 1 else None
            for heading, key, scale, up in METRICS:
                row[heading] = mean([median(results, g, key, scale, higher_is_better=up) for g in groups])
            averages.append({**row, "source": "measured"})
            detail: dict[str, Any] = {"Method": variant, "Preset": preset}
            detail |= {f"{sequence} [cm] ↓": error for sequence, error in zip(options.sequences, errors)}
            details.append(detail)
    paper = published_table(options.dataset, "ablation_synpano")
    for name, figures in paper.items():
        row = {"Method": name, "Preset": "the paper's", GEOMETRIC: None, **{heading: None for heading, *_ in METRICS}}
        row |= {heading: figures[key] for heading, key in _PAPER.items()}
        averages.append({**row, "source": "published"})
    tables = {"ablation": averages}
    if len(options.sequences) > 1:
        tables["ablation-sequences"] = details
    notes = [
        "w/o L_pano: every pixel of the panorama weighs the same. w L_GS: weights fall off from the equator as a "
        "Gaussian of latitude. w/o DGIS: the map starts from a constant depth, and new Gaussians from the median "
        "depth. The weights count in tracking and in mapping.",
        "Sphere and ERP projection: exact on the tangent plane, and the paper's first-order one.",
        *order_notes(averages),
        *(source_notes(options.dataset) if paper else []),
        *reasons(results, flat),
    ]
    repeats = f", each the median of {len(options.seeds)} repeats" if len(options.seeds) > 1 else ", one run each"
    captions = {
        "ablation": f"Ablation. Mean over {', '.join(options.sequences)}{repeats}; {options.width} pixels wide"
        + (f", one frame in {options.every}." if options.every > 1 else "."),
        "ablation-sequences": "Ablation by sequence. ATE RMSE after alignment.",
        "errors": "ATE of every variant. A marker per sequence, on a logarithmic axis; what is not there was lost.",
    }
    return StudyResult("ablation", tables, {"errors": _figure(details, options)}, notes, "Ablation", captions)


def order_notes(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """A line per preset: the variants that the paper has too, from the smallest ATE to the largest, and the paper's."""
    published = [row for row in rows if row["source"] == "published"]
    names = {row["Method"] for row in published}
    notes = []
    for preset in dict.fromkeys(row["Preset"] for row in rows):
        mine = [row for row in rows if row["Preset"] == preset and row["Method"] in names]
        known = [row for row in mine if isinstance(row["ATE [cm] ↓"], float)]
        failed = [row["Method"] for row in mine if row["ATE [cm] ↓"] == FAILED]
        if not published or len(known) < 2:
            continue
        ordered = sorted(known, key=lambda row: row["ATE [cm] ↓"])
        words = [f"{row['Method']} {row['ATE [cm] ↓']:.3g}" for row in ordered] + [f"{name} lost" for name in failed]
        whose = "in the paper" if mine[0]["source"] == "published" else f"preset {preset}"
        notes.append(f"Order by mean ATE [cm], {whose}: {' < '.join(words)}.")
    return notes


def variants(preset: str) -> dict[str, tuple[dict[str, Any], dict[str, Any]]]:
    """The variants that differ from ``preset``; the paper's has the ERP projection and Adam already."""
    if preset != "paper":
        return VARIANTS
    other: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "Sphere projection": ({"rendering.projection": "sphere"}, {}),
        "Gauss-Newton": ({"tracking.solver": "gauss-newton"}, {}),
    }
    return {k: v for k, v in VARIANTS.items() if k not in ("ERP projection", "Adam tracking")} | other


def _figure(details: list[dict[str, Any]], options: AblationOptions) -> dict[str, Any]:
    """A marker per variant and sequence on a logarithmic ATE axis."""
    several = len(options.presets) > 1
    names = [f"{row['Method']} ({row['Preset']})" if several else row["Method"] for row in details]
    data = []
    for k, sequence in enumerate(options.sequences):
        known = [
            (name, value) for name, row in zip(names, details) if isinstance(value := row[f"{sequence} [cm] ↓"], float)
        ]
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": sequence,
                "meta": {"run": -2, "colour": k},
                "x": [value for _, value in known],
                "y": [name for name, _ in known],
                "marker": {"size": 10},
            }
        )
    layout = {
        "xaxis": {"title": {"text": "ATE RMSE [cm]"}, "type": "log"},
        "yaxis": {"autorange": "reversed", "categoryorder": "array", "categoryarray": names, "automargin": True},
        "showlegend": len(options.sequences) > 1,
    }
    return {"data": data, "layout": layout}
