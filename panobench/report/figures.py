"""Figures as Plotly specifications (plain dicts). The page chooses colours, as it knows whether it is light or dark.

A trace carries ``meta.run`` (index of its run, for toggles) and ``meta.colour`` (index into the palette, -1 for
ground truth). Numbers are rounded to five significant digits to keep the page small.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from panobench.geometry import Sim3, umeyama
from panobench.metrics.alignment import match, moves
from panobench.report.model import Array, Errors, Run
from panobench.report.ranking import failure

#: Where the 3-D plot is looked at from, and what at, in Plotly's units.
EYE, LOOKED_AT = (1.1, -1.65, 1.5), (0.0, 0.0, -0.12)
#: Most points a trace may have; longer ones are thinned evenly.
MAX_POINTS = 800
#: An axis is logarithmic when its traces' medians differ by more than this factor.
LOG_FROM = 15.0
#: A plot in space shows the paths and this share of their extent on every side.
MARGIN = 0.8
#: It is logarithmic too when a value lies this factor above its trace's median, as only the peak would be seen.
LOG_FROM_PEAK = 40.0
Figure = dict[str, Any]


def numbers(values: Array, digits: int = 5) -> list[float | None]:
    """Floats rounded to significant digits, None for NaN and infinities."""
    return [float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in np.asarray(values, dtype=np.float64)]


def thin(count: int, most: int = MAX_POINTS) -> np.ndarray:
    """Indices that keep at most ``most`` of ``count`` evenly spread samples, both ends included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def upright(runs: Sequence[Run]) -> Array:
    """Rotation (3, 3) that turns the world so that the cameras' mean up direction is +z.

    Datasets choose their world axes freely; a viewer wants the floor level.
    """
    source = next((r.groundtruth for r in runs if r.groundtruth is not None), None)
    source = source or next((r.trajectory for r in runs if r.trajectory is not None), None)
    if source is None:
        return np.eye(3)
    up = -source.T_wc[:, :3, 1].mean(axis=0)
    if np.linalg.norm(up) < 1e-6:
        return np.eye(3)
    z = up / np.linalg.norm(up)
    axis = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = axis - z * (axis @ z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def log_axis(values: Sequence[float]) -> dict[str, Any]:
    """Axis settings for positive values: logarithmic, labelled at 1, 2 and 5 times powers of ten, two at least."""
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    steps = (1, 2, 5) if high - low <= 3 else (1,)
    ticks = [step * 10.0**k for k in range(low, high + 1) for step in steps]
    axis: dict[str, Any] = {"type": "log", "tickvals": ticks, "ticktext": [f"{tick:g}" for tick in ticks]}
    if sum(min(values) <= tick <= max(values) for tick in ticks) < 2:
        below = max(tick for tick in ticks if tick <= min(values) * (1 + 1e-9))
        above = min(tick for tick in ticks if tick > max(values))
        axis["range"] = [math.log10(below) - 0.03, math.log10(above) + 0.03]
    return axis


def value_axis(values: Sequence[float | None]) -> dict[str, Any]:
    """Axis settings: from zero, or logarithmic when typical values of the traces differ by more than ``LOG_FROM``."""
    positive = [v for v in values if v is not None and v > 0]
    if positive and max(positive) > LOG_FROM * min(positive):
        return log_axis(positive)
    return {"type": "linear", "rangemode": "tozero"}


def trajectory_figures(
    runs: Sequence[Run], labels: Sequence[str], colours: Sequence[int], onto: Mapping[int, Sim3] | None = None
) -> tuple[Figure, Figure]:
    """(3-D, top-down) views of every aligned trajectory and the ground truth.

    onto: without ground truth, by the index of a run, what moves its path onto the one that all are aligned to.
    """
    turn = upright(runs)
    paths: list[tuple[str, Array, dict[str, Any]]] = []
    truth = max(
        (r.groundtruth for r in runs if r.groundtruth is not None), key=lambda trajectory: len(trajectory), default=None
    )
    if truth is not None:
        paths.append(("Ground truth", truth.positions, {"run": -1, "colour": -1}))
    for i, run in enumerate(runs):
        points = run.errors.positions if run.errors else None
        if points is None and truth is None and run.trajectory is not None:
            points = run.trajectory.positions
            points = onto[i].apply_points(points) if onto and i in onto else points
        if points is not None:
            paths.append((labels[i], points, {"run": i, "colour": colours[i]}))
    paths = [(name, points @ turn.T, meta) for name, points, meta in paths]
    spatial, plan = [], []
    for name, points, meta in paths:
        points = points[thin(len(points))]
        x, y, z = (numbers(points[:, k]) for k in range(3))
        base = {"name": name, "meta": meta, "mode": "lines"}
        spatial.append({**base, "type": "scatter3d", "x": x, "y": y, "z": z, "line": {"width": 5}})
        plan.append({**base, "type": "scatter", "x": x, "y": y, "line": {"width": 2}})
        if meta["run"] < 0 and len(points):
            start = {"name": "Start", "meta": meta, "mode": "markers", "hoverinfo": "name"}
            plan.append({**start, "type": "scatter", "x": x[:1], "y": y[:1], "marker": {"size": 9}})
            spatial.append({**start, "type": "scatter3d", "x": x[:1], "y": y[:1], "z": z[:1], "marker": {"size": 5}})
    unit = "m" if truth is not None and _scaled(runs) else "units"
    axes: list[dict[str, Any]] = [{"title": {"text": f"{name} [{unit}]"}} for name in ("x", "y", "up")]
    reference = [points for name, points, meta in paths if meta["run"] < 0]
    good = [points for _, points, meta in paths if meta["run"] >= 0 and failure(runs[meta["run"]]) is None]
    box = frame_of(reference + good or [points for _, points, _ in paths])
    if box is not None:
        for axis, low, high in zip(axes, *box):
            axis["range"] = numbers(np.array([low, high]))
    layout3 = {
        "scene": {
            "aspectmode": "data",
            **{f"{k}axis": axis for k, axis in zip("xyz", axes)},
            "camera": {"eye": dict(zip("xyz", EYE)), "center": dict(zip("xyz", LOOKED_AT))},
        }
    }
    layout2 = {
        "xaxis": {"title": axes[0]["title"]},
        "yaxis": {"title": axes[1]["title"], "scaleanchor": "x", "scaleratio": 1},
    }
    return {"data": spatial, "layout": layout3}, {"data": plan, "layout": layout2}


def frame_of(paths: Sequence[Array]) -> tuple[Array, Array] | None:
    """Lower and upper corner (3,) of the box that a plot in space shows: the paths, and ``MARGIN`` of it around them.

    Points of a map far outside, or a method that got lost, must not shrink the paths to a dot.
    """
    finite = [p[np.isfinite(p).all(axis=1)] for p in paths]
    points = np.concatenate(finite) if finite else np.zeros((0, 3))
    if len(points) == 0:
        return None
    low, high = points.min(axis=0), points.max(axis=0)
    size = float((high - low).max())
    margin = MARGIN * (size if size > 0 else 1.0)
    return low - margin, high + margin


def alignment_without_truth(runs: Sequence[Run]) -> tuple[int, dict[int, Sim3]] | None:
    """The run that the others' paths are aligned to, and by its index what moves each other one onto it.

    The reference is the most trusted run that did not fail, the longest of these. None where there is ground truth or
    only one path. A path that shares no three frames with the reference, or does not move, stays as it is.
    """
    if any(r.groundtruth is not None for r in runs):
        return None
    having = [i for i, r in enumerate(runs) if r.trajectory is not None]
    if len(having) < 2:
        return None

    def standing(i: int) -> tuple[bool, float, int]:
        verdict, trajectory = runs[i].verdict, runs[i].trajectory
        return failure(runs[i]) is None, verdict.confidence if verdict else 0.0, len(trajectory) if trajectory else 0

    chosen = max(having, key=standing)
    reference = runs[chosen].trajectory
    found: dict[int, Sim3] = {}
    for i in having:
        trajectory = runs[i].trajectory
        matched = match(trajectory, reference) if trajectory is not None and i != chosen else None
        if matched is None or len(matched) < 3:
            continue
        if moves(matched.estimate.positions) and moves(matched.truth.positions):
            found[i] = umeyama(matched.estimate.positions, matched.truth.positions)
    return chosen, found


def _scaled(runs: Sequence[Run]) -> bool:
    """Whether all of the ground truth is in metres."""
    return all(run.record.groundtruth_scaled for run in runs if run.groundtruth is not None)


def error_figure(runs: Sequence[Run], labels: Sequence[str], colours: Sequence[int], kind: str) -> Figure | None:
    """Position (mm or m) or rotation (degrees) error over time; None when no run has ground truth."""
    with_errors = [(i, run.errors) for i, run in enumerate(runs) if run.errors is not None]
    if not with_errors:
        return None
    unit, scale = "°", 1.0
    if kind == "translation":
        typical = float(np.median(np.concatenate([e.translation for _, e in with_errors])))
        unit, scale = ("mm", 1e3) if typical < 0.1 else ("m", 1.0)
        if not _scaled(runs):
            unit, scale = "units", 1.0
    data = []
    for i, errors in with_errors:
        keep = thin(len(errors.times))
        values = (errors.translation if kind == "translation" else errors.rotation) * scale
        data.append(_line(errors.times[keep] - errors.times[0], values[keep], labels[i], i, colours[i]))
    title = "Position error" if kind == "translation" else "Rotation error"
    return _time_figure(data, f"{title} [{unit}]", "Time [s]")


def column_figure(
    runs: Sequence[Run],
    labels: Sequence[str],
    colours: Sequence[int],
    names: Sequence[str],
    title: str,
    *,
    scale: float = 1.0,
) -> Figure | None:
    """One column of frames.csv over the frame index; the first of ``names`` a run has. None when nobody has it."""
    data = []
    for i, run in enumerate(runs):
        values = next((run.frames[n] for n in names if n in run.frames and np.isfinite(run.frames[n]).any()), None)
        if values is None:
            continue
        index = next((run.frames[n] for n in ("index", "frame") if n in run.frames), np.arange(len(values)))
        keep = thin(len(values))
        data.append(_line(index[keep], values[keep] * scale, labels[i], i, colours[i]))
    if not data:
        return None
    return _time_figure(data, title, "Frame")


def accuracy_speed_figure(points: Sequence[Mapping[str, Any]]) -> Figure | None:
    """ATE against frames per second, one marker per variant and sequence, both axes logarithmic.

    ``points``: mappings with label, sequence, fps, ate_mm, colour.
    """
    usable = [p for p in points if p["fps"] and p["ate_mm"] and p["fps"] > 0 and p["ate_mm"] > 0]
    if len(usable) < 2:
        return None
    data = []
    for label in dict.fromkeys(p["label"] for p in usable):
        mine = [p for p in usable if p["label"] == label]
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": label,
                "meta": {"run": -2, "colour": mine[0]["colour"]},
                "x": numbers(np.array([p["fps"] for p in mine])),
                "y": numbers(np.array([p["ate_mm"] for p in mine])),
                "text": [p["sequence"] for p in mine],
                "hovertemplate": "%{text}<br>%{x} frames/s<br>%{y} mm",
                "marker": {"size": 11},
            }
        )
    layout = {
        "xaxis": {"title": {"text": "Frames per second"}, **log_axis([p["fps"] for p in usable])},
        "yaxis": {"title": {"text": "ATE RMSE [mm]"}, **log_axis([p["ate_mm"] for p in usable])},
        "showlegend": True,
    }
    return {"data": data, "layout": layout}


def bar_figure(names: Sequence[str], values: Sequence[float], colours: Sequence[int], title: str) -> Figure | None:
    """Horizontal bars, one per variant; None when there is nothing to compare."""
    if len(values) < 2:
        return None
    data = [
        {
            "type": "bar",
            "orientation": "h",
            "name": name,
            "meta": {"run": -2, "colour": colour},
            "x": numbers(np.array([value])),
            "y": [name],
        }
        for name, value, colour in zip(names, values, colours)
    ]
    layout = {"xaxis": {"title": {"text": title}, "rangemode": "tozero"}, "yaxis": {"autorange": "reversed"}}
    return {"data": data, "layout": layout}


def describe_errors(errors: Errors) -> str:
    """A sentence for readers who cannot see the plot."""
    e = errors.translation * 1e3
    return (
        f"median {np.median(e):.3g} mm, largest {e.max():.3g} mm at {errors.times[e.argmax()] - errors.times[0]:.1f} s"
    )


def _line(x: Array, y: Array, name: str, run: int, colour: int) -> dict[str, Any]:
    return {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "meta": {"run": run, "colour": colour},
        "x": numbers(x),
        "y": numbers(y),
        "line": {"width": 1.8},
    }


def _time_figure(data: list[dict[str, Any]], title: str, x: str) -> Figure:
    medians = [float(np.median(known)) for trace in data if (known := [v for v in trace["y"] if v is not None])]
    peaks = [max(known) for trace in data if (known := [v for v in trace["y"] if v is not None])]
    peaked = any(low > 0 and high > LOG_FROM_PEAK * low for low, high in zip(medians, peaks))
    yaxis = {"title": {"text": title}, **({"type": "log"} if peaked else value_axis(medians))}
    if yaxis["type"] == "log":
        everything = [v for trace in data for v in trace["y"] if v is not None and v > 0]
        yaxis |= log_axis(everything)
    return {"data": data, "layout": {"xaxis": {"title": {"text": x}}, "yaxis": yaxis, "hovermode": "x"}}
