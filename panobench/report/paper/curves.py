"""Curves: error over time, accuracy against speed, and the charts of studies, which are stored as Plotly's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from panobench.report.figures import LOG_FROM, LOG_FROM_PEAK, thin
from panobench.report.model import Run
from panobench.report.paper.style import Style, chart, legend_below


def error_over_time(runs: Sequence[Run], labels: Sequence[str], scaled: bool, style: Style) -> Any:
    """Position error over time, a line per run; None when no run has ground truth and an estimate of its own."""
    judged = [(r, label) for r, label in zip(runs, labels) if r.errors is not None and not r.given_poses]
    if not judged:
        return None
    everything = [run.errors.translation for run, _ in judged if run.errors is not None]
    typical = [float(np.median(e)) for e in everything]
    unit, scale = ("units", 1.0) if not scaled else ("mm", 1e3) if min(typical) < 0.05 else ("m", 1.0)
    figure, axis = chart(style, [label for _, label in judged])
    handles = []
    for k, (run, _) in enumerate(judged):
        assert run.errors is not None
        keep = thin(len(run.errors.times))
        times = run.errors.times[keep] - run.errors.times[0]
        handles += axis.plot(times, run.errors.translation[keep] * scale, color=style.colour(k), ls=style.dash(k))
    peak = max(float(e.max()) for e in everything)
    if min(typical) > 0 and (max(typical) > LOG_FROM * min(typical) or peak > LOG_FROM_PEAK * min(typical)):
        log_ticks(axis, "y")
    else:
        axis.set_ylim(bottom=0)
    axis.set_xlabel(style.text("Time [s]"))
    axis.set_ylabel(style.text(f"Position error [{unit}]"))
    axis.margins(x=0.01)
    legend_below(figure, handles, [label for _, label in judged], style)
    return figure


def accuracy_speed(points: Sequence[Mapping[str, Any]], style: Style) -> Any:
    """ATE against frames per second, a colour and a marker per method; None with fewer than two points.

    points: as for ``figures.accuracy_speed_figure``.
    """
    usable = [p for p in points if (p["fps"] or 0) > 0 and (p["ate_mm"] or 0) > 0]
    if len(usable) < 2:
        return None
    names = list(dict.fromkeys(p["label"] for p in usable))
    figure, axis = chart(style, names)
    handles = []
    for k, name in enumerate(names):
        mine = [p for p in usable if p["label"] == name]
        x, y = [p["fps"] for p in mine], [p["ate_mm"] for p in mine]
        handles.append(axis.scatter(x, y, s=20, color=style.colour(k), marker=style.marker(k), lw=0.4, ec="white"))
    log_ticks(axis, "x")
    log_ticks(axis, "y")
    axis.set_xlabel(style.text("Frames per second"))
    axis.set_ylabel(style.text("ATE RMSE [mm]"))
    legend_below(figure, handles, names, style)
    return figure


def log_ticks(axis: Any, which: str) -> None:
    """A logarithmic axis labelled with plain numbers, at 1, 2 and 5 where it spans little."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    getattr(axis, f"set_{which}scale")("log")
    axis.margins(**{which: 0.08})
    low, high = getattr(axis, f"get_{which}lim")()
    steps = (1.0, 2.0, 5.0) if high < 200 * low else (1.0,)
    about = getattr(axis, f"{which}axis")
    about.set_major_locator(LogLocator(subs=steps, numticks=12))
    about.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    about.set_minor_formatter(NullFormatter())


def study_chart(stored: Mapping[str, Any], style: Style) -> Any:
    """A chart of lines, markers, bars or contours; None for others, as surfaces in space are no figure for a page."""
    traces = [t for t in stored.get("data", ()) if isinstance(t, Mapping)]
    kinds = {str(t.get("type", "scatter")) for t in traces}
    if not traces or not kinds <= {"scatter", "contour", "heatmap", "bar"}:
        return None
    layout = stored.get("layout") or {}
    flat = bool(kinds & {"contour", "heatmap"})
    named = [t for t in traces if t.get("name") and t.get("type") not in ("contour", "heatmap")]
    named = named if len(named) > 1 else []
    figure, axis = chart(style, [str(t["name"]) for t in named], 0.8 if flat else 0.55)
    handles = []
    for k, trace in enumerate(traces):
        handle = _trace(figure, axis, trace, k, style)
        if trace in named:
            handles.append(handle)
    for which in "xy":
        _axis(axis, which, layout.get(f"{which}axis") or {}, style)
    if (layout.get("yaxis") or {}).get("scaleanchor") == "x":
        axis.set_aspect("equal")
    legend_below(figure, handles, [str(t["name"]) for t in named], style)
    return figure


def _trace(figure: Any, axis: Any, trace: Mapping[str, Any], k: int, style: Style) -> Any:
    x, y = list(trace.get("x") or ()), list(trace.get("y") or ())
    kind = trace.get("type", "scatter")
    if kind in ("contour", "heatmap"):
        z = np.array(trace["z"], dtype=np.float64)
        x, y = x or list(range(z.shape[1])), y or list(range(z.shape[0]))
        axis.grid(False)
        drawn = axis.contourf(x, y, z, levels=12, cmap="viridis")
        axis.contour(x, y, z, levels=12, colors="black", linewidths=0.3, alpha=0.5)
        bar = figure.colorbar(drawn, ax=axis, aspect=25)
        title = ((trace.get("colorbar") or {}).get("title") or {}).get("text", "")
        bar.set_label(style.text(str(title)))
        return None
    meta = trace.get("meta")
    colour = meta["colour"] if isinstance(meta, Mapping) and isinstance(meta.get("colour"), int) else k
    if kind == "bar":
        level = trace.get("orientation") == "h"
        values, names = (x, y) if level else (y, x)
        words = [style.text(str(name)) for name in names]
        return (axis.barh if level else axis.bar)(words, values, color=style.colour(colour))
    x = [style.text(v) if isinstance(v, str) else v for v in x]
    mode, marker = str(trace.get("mode", "lines")), trace.get("marker") or {}
    if "lines" not in mode:
        cross = str(marker.get("symbol", "circle")).startswith("x")
        look = {"marker": "X" if cross else "o", "color": marker.get("color") or style.colour(colour)}
        return axis.scatter(x, y, s=18, ec="#10202c", lw=0.5, zorder=3, **look)
    wanted = str((trace.get("line") or {}).get("dash"))
    dash = {"dot": (0, (1, 1)), "dash": (0, (4, 1.5))}.get(wanted, style.dash(colour))
    mark = style.marker(colour) if "markers" in mode else None
    return axis.plot(x, y, color=style.colour(colour), ls=dash, marker=mark, ms=3.5)[0]


def _axis(axis: Any, which: str, about: Mapping[str, Any], style: Style) -> None:
    title = about.get("title")
    words = title.get("text", "") if isinstance(title, Mapping) else str(title or "")
    getattr(axis, f"set_{which}label")(style.text(words))
    ticks = about.get("tickvals")
    if about.get("type") == "log":
        log_ticks(axis, which)
    elif ticks and all(isinstance(t, (int, float)) for t in ticks):
        words = about.get("ticktext") or [f"{tick:g}" for tick in ticks]
        getattr(axis, f"set_{which}ticks")(ticks, [style.text(str(word)) for word in words])
    if about.get("range") and about.get("type") != "log":
        getattr(axis, f"set_{which}lim")(*about["range"])
    if about.get("autorange") == "reversed":
        getattr(axis, f"invert_{which}axis")()
