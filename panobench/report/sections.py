"""The sections of a page: one per sequence (pictures, plots, first depth), and the cost of all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from markupsafe import Markup

from panobench.report import figures
from panobench.report.drawing import plan_svg
from panobench.report.mapview import MOST, map_size, map_trace
from panobench.report.model import Run
from panobench.report.panoramas import Gallery, depth_pictures, hidden_picture, novel_pictures, viewer
from panobench.report.ranking import failure
from panobench.report.variants import Variant

#: Columns of frames.csv that get a chart of their own where a method writes them: (names, title, axis).
FRAME_CHARTS = (
    (("loss", "tracking_loss", "photometric_loss"), "Photometric loss", "Loss"),
    (("error_px", "reprojection_px"), "Reprojection error", "Error [px]"),
    (("gaussians",), "Gaussians in the map", "Gaussians"),
    (("iterations",), "Tracking iterations", "Iterations"),
    (("points",), "Map points used", "Points"),
)


@dataclass(frozen=True)
class Chart:
    """A figure on the page: its id in the data, heading, and description for screen readers.

    size: "wide" beside "narrow" fills a row, and so do two of "half". spatial: drawn in 3-D, left out in print.
    drawing: SVG that stands in for it on paper.
    """

    key: str
    title: str
    about: str
    size: str = "half"
    spatial: bool = False
    drawing: Markup | None = None


def place_section(
    number: int,
    runs: list[Run],
    label_of: Mapping[int, str],
    colour_of: Mapping[int, int],
    gallery: Gallery,
    data: dict[str, Any],
    map_points: int = MOST,
) -> dict[str, Any]:
    """Make the section of one sequence: its viewer, charts and first depths. Figures and viewer data go into ``data``.

    map_points: most points of the map that is drawn behind the trajectories.
    """
    key = f"seq{number}"
    labels = _unique_labels(runs, label_of)
    colours = [colour_of[id(r)] for r in runs]
    charts: list[Chart] = []

    def add(name: str, title: str, about: str, figure: figures.Figure | None, **style: Any) -> None:
        if figure is not None and figure["data"]:
            data["figures"][f"{key}-{name}"] = figure
            charts.append(Chart(f"{key}-{name}", title, about, **style))

    aligned = figures.alignment_without_truth(runs)
    onto = aligned[1] if aligned else {}
    spatial, plan = figures.trajectory_figures(runs, labels, colours, onto)
    drawn = best_map(runs)
    trace = None
    if drawn is not None:
        ranges = [spatial["layout"]["scene"][f"{k}axis"].get("range") for k in "xyz"]
        box = (np.array([r[0] for r in ranges]), np.array([r[1] for r in ranges])) if all(ranges) else None
        trace = map_trace(runs[drawn], figures.upright(runs), onto=onto.get(drawn), box=box, most=map_points)
    if trace is not None:
        spatial["data"].append(trace)
        spatial["layout"]["scene"]["camera"]["eye"] = {"x": 0.98, "y": -1.38, "z": 1.32}
    # given poses have no error
    own = [replace(r, errors=None) if r.given_poses else r for r in runs]
    described = [f"{label}: {figures.describe_errors(r.errors)}" for r, label in zip(own, labels) if r.errors]
    about = "Position error after alignment. " + "; ".join(described)
    truth = any(r.groundtruth is not None for r in runs)
    what = "Aligned trajectories and ground truth in space" if truth else "Trajectories in space"
    add("3d", "Trajectory", what, spatial, size="wide", spatial=True)
    add("top", "From above", "The same trajectories seen from above", plan, size="narrow", drawing=plan_svg(plan))
    error = figures.error_figure(own, labels, colours, "translation")
    add("ate", "Position error over time", about, error, size="wide")
    turn = figures.error_figure(own, labels, colours, "rotation")
    add(
        "rot",
        "Rotation error over time",
        "Angle between estimated and true orientation after alignment",
        turn,
        size="narrow",
    )
    latency = figures.column_figure(runs, labels, colours, ("latency_s", "latency"), "Latency [ms]", scale=1e3)
    add("latency", "Time per frame", "Latency of each frame", latency)
    for names, title, axis in FRAME_CHARTS:
        add(names[0], title, f"{title} of each frame", figures.column_figure(runs, labels, colours, names, axis))
    panorama = viewer(runs, labels, gallery)
    if panorama:
        data["viewers"][key] = panorama
    novel = [(label, shown) for run, label in zip(runs, labels) if (shown := novel_pictures(run, gallery))]
    depths = []
    for run, label in zip(runs, labels):
        keys = depth_pictures(run, gallery)
        if keys and run.depth is not None:
            depths.append({"label": label, "about": run.depth, **keys})
    masks = [
        {"label": label, "about": run.record.mask, "moving": run.record.moving, "picture": picture}
        for run, label in zip(runs, labels)
        if (picture := hidden_picture(run, gallery))
    ]
    return {
        "key": key,
        "dataset": runs[0].dataset,
        "sequence": runs[0].sequence,
        "runs": [
            {
                "label": label,
                "colour": c,
                "reason": failure(r),
                "cautions": r.cautions,
            }
            for label, c, r in zip(labels, colours, runs)
        ],
        "charts": charts,
        "viewer": panorama,
        "depths": depths,
        "masks": masks,
        "novel": novel,
        "map": labels[drawn] if trace is not None and drawn is not None else None,
        "alignment": sorted({r.errors.alignment for r in runs if r.errors}),
        "has_truth": truth,
        "onto": labels[aligned[0]] if aligned else None,
        "not_aligned": [
            label
            for i, label in enumerate(labels)
            if aligned and runs[i].trajectory is not None and i != aligned[0] and i not in onto
        ],
    }


def best_map(runs: Sequence[Run]) -> int | None:
    """Index of the run whose map is drawn: the best render among those that did not fail, from panoramas if any."""

    def quality(i: int) -> tuple[bool, float]:
        return runs[i].variant.get("camera", "erp").startswith("erp"), runs[i].number("pano_psnr_db") or 0.0

    with_map = [i for i, run in enumerate(runs) if map_size(run) is not None and failure(run) is None]
    return max(with_map, key=quality, default=None)


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


def speed_points(grouped: Mapping[Variant, Sequence[Run]]) -> list[dict[str, Any]]:
    """Accuracy and speed of every run that did not fail and had to find its poses."""
    return [
        {
            "label": variant.label,
            "sequence": run.sequence,
            "fps": run.number("fps"),
            "ate_mm": None if (ate := run.number("ate_rmse_m")) is None else ate * 1e3,
            "colour": colour,
        }
        for colour, (variant, runs) in enumerate(grouped.items())
        for run in runs
        if not failure(run) and not run.given_poses
    ]


def cost_charts(grouped: Mapping[Variant, Sequence[Run]], data: dict[str, Any]) -> list[Chart]:
    """Accuracy against speed, and peak memory."""
    charts: list[Chart] = []
    scatter = figures.accuracy_speed_figure(speed_points(grouped))
    if scatter:
        data["figures"]["cost-speed"] = scatter
        charts.append(Chart("cost-speed", "Accuracy against speed", "Down and to the right is better", size="wide"))
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
        charts.append(Chart("cost-memory", "Peak memory", "Largest of all runs, process tree", size="narrow"))
    return charts
