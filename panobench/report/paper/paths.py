"""Trajectories from above, one small panel per method, coloured by the error of each pose."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from panobench.report.figures import alignment_without_truth, upright
from panobench.report.model import Array, Run
from panobench.report.paper.style import ERRORS, TRUTH, Style, chart, legend_below, new_figure
from panobench.report.ranking import failure

#: Share of the true path's extent that is shown around it.
_MARGIN = 0.08
#: A panel should not be narrower, inches.
_PANEL = 1.5


def paths(runs: Sequence[Run], labels: Sequence[str], scaled: bool, style: Style) -> Any:
    """Panels with the true path in grey and the aligned one by its error; one panel without ground truth.

    scaled: the ground truth is in metres. None where no run has a path.
    """
    judged = [(run, label) for run, label in zip(runs, labels) if run.errors is not None]
    turn = _lying(runs) @ upright(runs)
    if not judged:
        return _bare(runs, labels, turn, style)
    truths = [r.groundtruth for r in runs if r.groundtruth is not None]
    truth = max(truths, key=len).positions @ turn.T
    columns = max(1, min(len(judged), int(style.width / _PANEL)))
    rows = math.ceil(len(judged) / columns)
    low, high = _frame(truth)
    ratio = float(np.clip((high - low)[1] / (high - low)[0], 0.25, 1.2))
    titles = [_wrapped(label, style.width / columns) for _, label in judged]
    head = 0.13 * (2 + max(title.count("\n") for title in titles))
    figure, axes = new_figure(style, rows * (style.width / columns * ratio + head + 0.1) + 0.55, rows, columns)
    unit, scale = _unit(judged, scaled)
    limit = max(float(np.quantile(run.errors.translation, 0.95)) for run, _ in judged if run.errors and not _lost(run))
    lines = None
    for axis, (run, _), title in zip(axes.flat, judged, titles):
        axis.plot(truth[:, 0], truth[:, 1], color=TRUTH, lw=0.7, ls=(0, (2, 1.5)), zorder=1)
        assert run.errors is not None
        lines = _coloured(axis, run.errors.positions @ turn.T, run.errors.translation * scale, limit * scale)
        rmse = f"{run.errors.rmse * scale:.3g} {unit}"
        axis.set_title(style.text(f"{title}\n{'failed' if _lost(run) else rmse}"), fontsize=7)
        axis.set_xlim(low[0], high[0])
        axis.set_ylim(low[1], high[1])
        axis.set_aspect("equal")
        axis.tick_params(labelsize=6)
    for axis in list(axes.flat)[len(judged) :]:
        axis.set_axis_off()
    bar = figure.colorbar(lines, ax=axes, location="bottom", shrink=0.8, aspect=40, pad=0.02, extend="max")
    bar.set_label(style.text(f"Position error [{unit}]"))
    bar.outline.set_linewidth(0.4)
    figure.supxlabel(style.text(f"x, y [{'m' if scaled else 'units'}]; dashed: ground truth"), fontsize=7)
    return figure


def _lying(runs: Sequence[Run]) -> Array:
    """Turns the plan of an upright world so that its longer side lies flat."""
    having = [path for r in runs if (path := r.groundtruth or r.trajectory) is not None]
    plan = max(having, key=len).positions @ upright(runs).T if having else np.zeros((1, 3))
    _, axes = np.linalg.eigh(np.cov(plan[:, :2].T) if len(plan) > 2 else np.eye(2))
    x, y = axes[:, 1] * np.sign(axes[0, 1] or 1.0)
    return np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, 1.0]])


def _lost(run: Run) -> bool:
    return failure(run) is not None


def _wrapped(label: str, width: float) -> str:
    """The label broken between its parts, to fit a panel."""
    lines: list[str] = []
    for part in label.split(" · "):
        if lines and len(f"{lines[-1]} · {part}") * 0.055 < width:
            lines[-1] += f" · {part}"
        else:
            lines.append(part)
    return "\n".join(lines)


def _unit(judged: Sequence[tuple[Run, str]], scaled: bool) -> tuple[str, float]:
    typical = min(float(np.median(run.errors.translation)) for run, _ in judged if run.errors)
    return ("units", 1.0) if not scaled else ("mm", 1e3) if typical < 0.05 else ("m", 1.0)


def _frame(path: Array) -> tuple[Array, Array]:
    low, high = path.min(axis=0)[:2], path.max(axis=0)[:2]
    margin = _MARGIN * max(float((high - low).max()), 1e-6)
    return low - margin, high + margin


def _coloured(axis: Any, points: Array, values: Array, limit: float) -> Any:
    """A line whose pieces have the colour of their error, from 0 to ``limit``."""
    from matplotlib.collections import LineCollection

    pieces = np.stack([points[:-1, :2], points[1:, :2]], axis=1)
    lines = LineCollection(list(pieces), cmap=ERRORS, linewidths=1.4, zorder=2, capstyle="round")
    lines.set_array(0.5 * (values[:-1] + values[1:]))
    lines.set_clim(0.0, limit)
    return axis.add_collection(lines)


def _bare(runs: Sequence[Run], labels: Sequence[str], turn: Array, style: Style) -> Any:
    """Paths in one panel, aligned to the most trusted one."""
    having = [i for i, run in enumerate(runs) if run.trajectory is not None]
    if not having:
        return None
    aligned = alignment_without_truth(runs)
    moves = aligned[1] if aligned else {}
    points: dict[int, Array] = {}
    for i in having:
        trajectory = runs[i].trajectory
        assert trajectory is not None
        own = trajectory.positions
        points[i] = (moves[i].apply_points(own) if i in moves else own) @ turn.T
    good = [p for i, p in points.items() if not _lost(runs[i])] or list(points.values())
    low, high = _frame(np.concatenate(good))
    ratio = float(np.clip((high - low)[1] / (high - low)[0], 0.25, 1.0))
    names = [labels[i] for i in points] if len(points) > 1 else []
    figure, axis = chart(style, names, 0.85 * ratio + 0.12)
    handles = [
        axis.plot(p[:, 0], p[:, 1], color=style.colour(k), ls=style.dash(k))[0] for k, p in enumerate(points.values())
    ]
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_aspect("equal")
    axis.set_xlabel(style.text("x [units]"))
    axis.set_ylabel(style.text("y [units]"))
    legend_below(figure, handles if names else [], names, style)
    return figure
