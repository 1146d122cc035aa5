"""The HTML report: one file, no network, everything from data escaped."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import lru_cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup

from panobench import __version__
from panobench.errors import UnavailableError
from panobench.report import figures
from panobench.report.model import Collection, Run
from panobench.report.panoramas import Gallery, depth_pictures, make_gallery, novel_pictures, viewer
from panobench.report.published import Published
from panobench.report.ranking import RANKING_RULE, failure
from panobench.report.tables import ACCURACY, COST, RENDERING, Quantity, Table, build_tables, length_text, natural
from panobench.report.variants import Variant, variants

_TEMPLATES = Path(__file__).parent / "templates"
_SCRIPTS = ("core.js", "tables.js", "plots.js", "pano.js", "main.js")


@dataclass(frozen=True)
class Tile:
    """A key figure on top of the page."""

    name: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Chart:
    """A figure on the page: its id in the data, heading, description for screen readers, and width."""

    key: str
    title: str
    about: str
    wide: bool = False
    spatial: bool = False


def build_html(
    collection: Collection,
    *,
    title: str | None = None,
    published: Published | None = None,
    assets: Path | None = None,
    now: datetime | None = None,
) -> str:
    """The whole page as text. ``assets``: folder that receives full-size pictures, linked relatively."""
    grouped = variants(collection)
    label_of = {id(run): variant.label for variant, runs in grouped.items() for run in runs}
    colour_of = {id(run): i for i, runs in enumerate(grouped.values()) for run in runs}
    gallery = make_gallery(collection, assets)
    data: dict[str, Any] = {"figures": {}, "viewers": {}}
    places = [
        _place(i, collection.at(place), label_of, colour_of, gallery, data)
        for i, place in enumerate(sorted(collection.places(), key=lambda p: (p[0], natural(p[1]))))
    ]
    data["images"], data["links"] = gallery.store, gallery.links
    tables = build_tables(collection, published)
    context = {
        "title": title or default_title(collection, grouped),
        "facts": _facts(collection, now or datetime.now(timezone.utc)),
        "tiles": tiles(collection, grouped),
        "tables": tables if len(collection.runs) > 1 else [],
        "measurements": measurements(collection.runs[0]) if len(collection.runs) == 1 else [],
        "places": places,
        "cost_charts": _cost_charts(grouped, data),
        "failures": [(run, failure(run), label_of[id(run)]) for run in collection.runs if failure(run)],
        "problems": collection.problems,
        "runs": [_run_details(i, run, label_of[id(run)]) for i, run in enumerate(collection.runs)],
        "rule": RANKING_RULE,
        "version": __version__,
        "data": data,
        "scripts": [Markup((_TEMPLATES / name).read_text(encoding="utf-8")) for name in _SCRIPTS],
        "style": Markup((_TEMPLATES / "style.css").read_text(encoding="utf-8")),
        "plotly": Markup(_plotly_packed()) if data["figures"] else "",
    }
    return _environment().get_template("report.html").render(context)


def safe_json(value: Any) -> Markup:
    """JSON that cannot end the script element it stands in, nor start a comment there."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for character, escape in (("<", "\\u003c"), (">", "\\u003e"), ("&", "\\u0026")):
        text = text.replace(character, escape)
    return Markup(text.replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def default_title(collection: Collection, grouped: Mapping[Variant, Sequence[Run]]) -> str:
    """ "panogs on room1" for one run, else counts."""
    places = collection.places()
    if len(grouped) == 1 and len(places) == 1:
        return f"{next(iter(grouped)).label} on {places[0][1]}"
    methods = f"{len(grouped)} methods" if len(grouped) > 1 else next(iter(grouped)).label
    return f"{methods} on {places[0][1] if len(places) == 1 else f'{len(places)} sequences'}"


def tiles(collection: Collection, grouped: Mapping[Variant, Sequence[Run]]) -> list[Tile]:
    """Key figures: of the run when there is one, of the comparison otherwise."""
    if len(collection.runs) == 1:
        return _run_tiles(collection.runs[0])
    failed = sum(failure(r) is not None for r in collection.runs)
    out = [Tile("Runs", str(len(collection.runs)), note=f"{failed} failed" if failed else "all succeeded")]
    good = [(r, v.label) for v, runs in grouped.items() for r in runs if not failure(r)]
    for name, key, best, text, unit in (
        ("Lowest ATE", "ate_rmse_m", min, lambda v: length_text(v * 1e3, "mm"), "mm"),
        ("Highest panorama PSNR", "pano_psnr_db", max, lambda v: f"{v:.2f}", "dB"),
        ("Fastest", "fps", max, lambda v: f"{v:.2f}", "frames/s"),
    ):
        scored = [(value, r, label) for r, label in good if (value := r.number(key)) is not None]
        if scored:
            value, run, label = best(scored, key=lambda s: s[0])
            out.append(Tile(name, text(value), unit, f"{label}, {run.sequence}"))
    return out


def _run_tiles(run: Run) -> list[Tile]:
    out: list[Tile] = []
    reason, ate, tracked = failure(run), run.number("ate_rmse_m"), run.number("tracked")
    if reason:
        out.append(Tile("Result", "failed", note=reason))
    if ate is not None:
        kind = run.errors.alignment if run.errors else "RMSE"
        share = run.number("ate_percent")
        note = f"{kind}, {share:.2f}% of the path" if share is not None else kind
        out.append(Tile("ATE RMSE", length_text(ate * 1e3, "mm"), "mm", note))
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
    """Everything measured of one run as (heading, (name, value with unit) pairs); says why where it is n/a."""
    notes = run.document.get("notes")
    notes = notes if isinstance(notes, Mapping) else {}
    ate = Quantity("ate_rmse_m", "ATE", "mm", "lower", scale=1e3)
    out = []
    for heading, quantities in (("Accuracy", (ate, *ACCURACY)), ("Rendering", RENDERING), ("Cost", COST)):
        pairs = []
        for quantity in quantities:
            value = run.number(quantity.key)
            note = notes.get(quantity.key)
            if value is not None:
                pairs.append((quantity.label, f"{quantity.text(value)} {quantity.unit}".strip()))
            elif note:
                pairs.append((quantity.label, f"n/a: {str(note).removeprefix('n/a: ')}"))
        if pairs:
            out.append((heading, pairs))
    return out


def _facts(collection: Collection, now: datetime) -> list[tuple[str, str]]:
    protocols = {str(v) for r in collection.runs if (v := _find(r.document, "protocol", "protocol_version"))}
    facts = [("Made", now.strftime("%Y-%m-%d %H:%M UTC")), ("panobench", __version__)]
    if protocols:
        facts.append(("Protocol", ", ".join(sorted(protocols))))
    machines = {str(v) for r in collection.runs if (v := _find(r.document, "cpu"))}
    if machines:
        facts.append(("Machine", ", ".join(sorted(machines)[:2]) + (" and others" if len(machines) > 2 else "")))
    return facts


def _find(document: Mapping[str, Any], *keys: str) -> Any:
    origin = document.get("provenance")
    machine = origin.get("machine") if isinstance(origin, Mapping) else None
    for source in (document, origin, machine):
        if isinstance(source, Mapping):
            for key in keys:
                if source.get(key):
                    return source[key]
    return None


def _place(
    number: int,
    runs: list[Run],
    label_of: Mapping[int, str],
    colour_of: Mapping[int, int],
    gallery: Gallery,
    data: dict[str, Any],
) -> dict[str, Any]:
    """One sequence: its viewer, charts, and initial depths. Figures and viewer data go into ``data``."""
    key = f"seq{number}"
    labels = _unique_labels(runs, label_of)
    colours = [colour_of[id(r)] for r in runs]
    charts: list[Chart] = []

    def add(name: str, title: str, about: str, figure: figures.Figure | None, **style: bool) -> None:
        if figure is not None and figure["data"]:
            data["figures"][f"{key}-{name}"] = figure
            charts.append(Chart(f"{key}-{name}", title, about, **style))

    spatial, plan = figures.trajectory_figures(runs, labels, colours)
    described = [f"{label}: {figures.describe_errors(r.errors)}" for r, label in zip(runs, labels) if r.errors]
    about = "Position error after alignment. " + "; ".join(described)
    add("3d", "Trajectory", "Aligned trajectories and ground truth in space", spatial, wide=True, spatial=True)
    add("top", "From above", "The same trajectories seen from above", plan)
    error = figures.error_figure(runs, labels, colours, "translation")
    add("ate", "Position error over time", about, error, wide=True)
    turn = figures.error_figure(runs, labels, colours, "rotation")
    add("rot", "Rotation error over time", "Angle between estimated and true orientation after alignment", turn)
    latency = figures.column_figure(runs, labels, colours, ("latency_s", "latency"), "Latency [ms]", scale=1e3)
    add("latency", "Time per frame", "Latency of each frame", latency, wide=True)
    loss = figures.column_figure(runs, labels, colours, ("loss", "tracking_loss", "photometric_loss"), "Loss")
    add("loss", "Loss", "Photometric loss of each frame", loss)
    panorama = viewer(runs, labels, gallery)
    if panorama:
        data["viewers"][key] = panorama
    novel = [(label, shown) for run, label in zip(runs, labels) if (shown := novel_pictures(run, gallery))]
    depths = []
    for run, label in zip(runs, labels):
        keys = depth_pictures(run, gallery)
        if keys and run.depth is not None:
            depths.append({"label": label, "about": run.depth, **keys})
    return {
        "key": key,
        "dataset": runs[0].dataset,
        "sequence": runs[0].sequence,
        "runs": [
            {"label": label, "colour": c, "anchor": None, "reason": failure(r), "drawn": bool(r.errors)}
            for label, c, r in zip(labels, colours, runs)
        ],
        "charts": charts,
        "viewer": panorama,
        "depths": depths,
        "novel": novel,
        "alignment": sorted({r.errors.alignment for r in runs if r.errors}),
        "has_truth": any(r.groundtruth is not None for r in runs),
        "frame_note": next((n for r in runs if (n := _find(r.document, "evaluated_frame"))), ""),
    }


def _unique_labels(runs: Sequence[Run], label_of: Mapping[int, str]) -> list[str]:
    """Variant labels, with the seed (or a count) added where repeats share one."""
    base = [label_of[id(r)] for r in runs]
    out: list[str] = []
    for run, label in zip(runs, base):
        if base.count(label) > 1:
            label += f" · seed {run.seed}" if run.seed is not None else ""
        while label in out:
            label += " ′"
        out.append(label)
    return out


def _cost_charts(grouped: Mapping[Variant, Sequence[Run]], data: dict[str, Any]) -> list[Chart]:
    points = [
        {
            "label": variant.label,
            "sequence": run.sequence,
            "fps": run.number("fps"),
            "ate_mm": None if (ate := run.number("ate_rmse_m")) is None else ate * 1e3,
            "colour": colour,
        }
        for colour, (variant, runs) in enumerate(grouped.items())
        for run in runs
        if not failure(run)
    ]
    charts: list[Chart] = []
    scatter = figures.accuracy_speed_figure(points)
    if scatter:
        data["figures"]["cost-speed"] = scatter
        charts.append(Chart("cost-speed", "Accuracy against speed", "Down and to the right is better", wide=True))
    memory = []
    for colour, (variant, runs) in enumerate(grouped.items()):
        peaks = [p for r in runs if (p := r.number("peak_rss_bytes"))]
        if peaks:
            memory.append((variant.label, max(peaks) / 2**20, colour))
    bars = figures.bar_figure(
        [m[0] for m in memory], [m[1] for m in memory], [m[2] for m in memory], "Peak memory [MiB]"
    )
    if bars:
        data["figures"]["cost-memory"] = bars
        charts.append(Chart("cost-memory", "Peak memory", "Largest of all runs, process tree"))
    return charts


def _run_details(number: int, run: Run, label: str) -> dict[str, Any]:
    provenance = run.document.get("provenance")
    return {
        "anchor": f"run-{number}",
        "label": label,
        "run": run,
        "reason": failure(run),
        "configuration": flatten(run.document.get("spec") or {}),
        "provenance": flatten(provenance if isinstance(provenance, Mapping) else {}),
        "extra": flatten({k: run.document[k] for k in ("extra", "depth", "notes", "map") if run.document.get(k)}),
    }


def flatten(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Nested mappings as ("a.b", text) pairs, in the order given; long lists are cut."""
    if isinstance(value, Mapping):
        pairs: list[tuple[str, str]] = []
        for key, entry in value.items():
            pairs += flatten(entry, f"{prefix}.{key}" if prefix else str(key))
        return pairs
    if isinstance(value, (list, tuple)):
        words = ", ".join(str(v) for v in value[:40])
        return [(prefix, f"{words}, … ({len(value)} in all)" if len(value) > 40 else words)]
    return [(prefix, "–" if value is None else str(value))]


@lru_cache(maxsize=1)
def _plotly_packed() -> str:
    """Plotly.js, gzipped and in base64 (2 MB instead of 4.8), for the page to unpack on first use."""
    spec = importlib.util.find_spec("plotly")
    if spec is None or not spec.submodule_search_locations:
        raise UnavailableError("the HTML report needs the Python package 'plotly'")
    path = Path(next(iter(spec.submodule_search_locations))) / "package_data" / "plotly.min.js"
    return base64.b64encode(gzip.compress(path.read_bytes(), 9, mtime=0)).decode("ascii")


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["safe_json"] = safe_json
    environment.globals["facet_values"] = facet_values
    return environment


def facet_values(table: Table) -> dict[str, list[str]]:
    """Per facet the values rows have, for facets that tell rows apart."""
    names = dict.fromkeys(name for row in table.rows for name in row.facets)
    values = {name: sorted({row.facets.get(name, "") for row in table.rows} - {""}) for name in names}
    return {name: found for name, found in values.items() if len(found) > 1}
