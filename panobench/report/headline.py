"""The top of a report: its title, key figures and facts, and the measurements of a single run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from panobench import __version__
from panobench.bench.records.provenance import ProvenanceRecord
from panobench.report.accuracy import competes, conditions
from panobench.report.model import Collection, Run
from panobench.report.ranking import failure
from panobench.report.table_model import length_text
from panobench.report.tables import ACCURACY, COST, RENDERING, Quantity
from panobench.report.variants import Variant

#: The run options that decide what pictures a method gets.
_PICTURES = ("camera", "fov", "width")


@dataclass(frozen=True)
class Tile:
    """A key figure on top of the page."""

    name: str
    value: str
    unit: str = ""
    note: str = ""


def default_title(collection: Collection, grouped: Mapping[Variant, Sequence[Run]]) -> str:
    """The studies' titles, or "panogs on room1" for one run, else counts."""
    if collection.studies:
        titles = [s.result.title or s.result.name for s in collection.studies]
        return titles[0] if len(titles) == 1 else f"{len(titles)} studies"
    places = collection.places()
    if len(grouped) == 1 and len(places) == 1:
        return f"{next(iter(grouped)).label} on {places[0][1]}"
    methods = f"{len(grouped)} methods" if len(grouped) > 1 else next(iter(grouped)).label
    return f"{methods} on {places[0][1] if len(places) == 1 else f'{len(places)} sequences'}"


def tiles(collection: Collection, grouped: Mapping[Variant, Sequence[Run]]) -> list[Tile]:
    """Key figures of the run if there is one, else of the comparison; none for studies."""
    if collection.studies:
        return []
    if len(collection.runs) == 1:
        return run_tiles(collection.runs[0])
    failed = sum(failure(r) is not None for r in collection.runs)
    out = [Tile("Runs", str(len(collection.runs)), note=f"{failed} failed" if failed else "all succeeded")]
    good = [(r, v.label) for v, runs in grouped.items() for r in runs if not failure(r) and competes([r])]
    # a method that finds no path is not the fastest
    good = [(r, label) for r, label in good if r.number("ate_rmse_m") is not None] or good
    for name, key, best, text, unit in (
        ("Lowest ATE", "ate_rmse_m", min, lambda v: length_text(v * 1e3, "mm"), "mm"),
        ("Highest panorama PSNR", "pano_psnr_db", max, lambda v: f"{v:.2f}", "dB"),
        ("Fastest", "fps", max, lambda v: f"{v:.2f}", "frames/s"),
    ):
        scored = [(value, r, label) for r, label in good if (value := r.number(key)) is not None]
        # the best render of several cameras or sizes is the best of nothing
        if scored and (key != "pano_psnr_db" or len({conditions([r], _PICTURES) for _, r, _ in scored}) == 1):
            value, run, label = best(scored, key=lambda s: s[0])
            out.append(Tile(name, text(value), unit, f"{label}, {run.sequence}"))
    return out


def run_tiles(run: Run) -> list[Tile]:
    out: list[Tile] = []
    reason, ate, tracked = failure(run), run.number("ate_rmse_m"), run.number("tracked")
    share = run.number("ate_percent")
    if reason:
        out.append(Tile("Result", "failed", note=reason))
    if ate is not None and not run.given_poses:
        kind = run.errors.alignment if run.errors else "RMSE"
        note = f"{kind}, {share:.2f}% of the path" if share is not None else kind
        out.append(Tile("ATE RMSE", length_text(ate * 1e3, "mm"), "mm", note))
    elif share is not None and not run.given_poses:
        out.append(Tile("ATE RMSE", f"{share:.2f}", "% of the path", "the ground truth has no scale"))
    truth, planned = run.record.truth, run.record.frames.planned
    if truth is not None and planned and truth.frames < planned:
        out.append(Tile("Ground truth", str(truth.frames), "frames", f"of {planned}: the others do not count"))
    if tracked is not None:
        frames = len(run.frames.get("index", run.frames.get("frame", ())))
        out.append(Tile("Tracked", f"{100 * tracked:.0f}", "%", f"of {frames} frames" if frames else "of the frames"))
    psnr, held = run.number("pano_psnr_db"), run.number("holdout_psnr_db")
    if psnr is not None:
        note = f"held-out frames {held:.2f} dB" if held is not None else "frames that were mapped"
        out.append(Tile("Panorama PSNR", f"{psnr:.2f}", "dB", note))
    fps, tracking = run.number("fps"), run.number("tracking_fps")
    if fps is not None:
        note = f"tracking alone {tracking:.1f}" if tracking is not None else "whole system"
        out.append(Tile("Speed", f"{fps:.2f}", "frames/s", note))
    return out


def measurements(run: Run) -> list[tuple[str, list[tuple[str, str]]]]:
    """Everything measured in one run as (heading, (name, value with unit) pairs), with the reason where it is n/a."""
    ate = Quantity("ate_rmse_m", "ATE", "mm", "lower", scale=1e3)
    out = []
    for heading, quantities in (("Accuracy", (ate, *ACCURACY)), ("Rendering", RENDERING), ("Cost", COST)):
        pairs = []
        if heading == "Accuracy" and run.record.truth is not None:
            pairs.append(("Ground truth", _truth_text(run)))
        for quantity in quantities:
            value = run.number(quantity.key)
            note = run.record.notes.get(quantity.key)
            if value is not None:
                words = f"{quantity.text(value)} {quantity.unit}".strip()
                pairs.append((quantity.label, f"{words} ({note})" if note else words))
            elif note:
                pairs.append((quantity.label, f"n/a: {note.removeprefix('n/a: ')}"))
        if pairs:
            out.append((heading, pairs))
    return out


def _truth_text(run: Run) -> str:
    """For how many frames there was truth; where it was in time, if not for all."""
    truth, planned = run.record.truth, run.record.frames.planned
    assert truth is not None
    words = f"{truth.frames} of {planned if planned is not None else 'the'} frames"
    if truth.frames != planned and truth.span_s and truth.frames_span_s:
        (a, b), (c, d) = truth.span_s, truth.frames_span_s
        words += f"; it spans {a:.3f} to {b:.3f} s, the frames {c:.3f} to {d:.3f} s"
    if truth.time_offset_s is not None:
        words += f"; its times were moved by {truth.time_offset_s:+.4f} s"
    return words


def facts(collection: Collection, now: datetime) -> list[tuple[str, str]]:
    """When and with what the report and its runs were made, as (name, text) pairs."""
    protocols = {run.protocol for run in collection.runs} - {""}
    origins = [run.record.provenance for run in collection.runs]
    origins += [ProvenanceRecord.from_dict(study.provenance) for study in collection.studies]
    machines = {origin.machine.cpu for origin in origins} - {""}
    facts = [("Made", now.strftime("%Y-%m-%d %H:%M UTC")), ("panobench", __version__)]
    if protocols:
        facts.append(("Protocol", ", ".join(sorted(protocols))))
    if machines:
        facts.append(("Machine", ", ".join(sorted(machines)[:2]) + (" and others" if len(machines) > 2 else "")))
    return facts
