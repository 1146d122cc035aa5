"""A plan of paths as SVG, for paper: a page may be printed before its scripts have drawn anything."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from panobench.report.figures import Figure

_WIDTH, _HEIGHT, _MARGIN = 320, 240, 10


def plan_svg(figure: Figure) -> Markup:
    """The lines of a plan in the page's colours, the true path dotted; equal scales on both axes."""
    traces = [t for t in figure["data"] if t.get("mode") == "lines" and len(t["x"])]
    points = [np.array([t["x"], t["y"]], dtype=np.float64).T for t in traces]
    points = [p[np.isfinite(p).all(axis=1)] for p in points]
    everything = np.concatenate([*points, np.zeros((0, 2))])
    if len(everything) == 0:
        return Markup("")
    low, high = everything.min(axis=0), everything.max(axis=0)
    room = np.array([_WIDTH, _HEIGHT]) - 2 * _MARGIN
    scale = float((room / np.maximum(high - low, 1e-9)).min())
    lines = []
    for trace, path in zip(traces, points):
        xy = (path - (low + high) / 2) * [scale, -scale] + [_WIDTH / 2, _HEIGHT / 2]
        dots = " ".join(f"{x:.1f},{y:.1f}" for x, y in xy)
        truth = trace["meta"]["colour"] < 0
        style = 'stroke-dasharray="2 3"' if truth else f'data-colour="{int(trace["meta"]["colour"])}"'
        lines.append(f'<polyline points="{dots}" fill="none" stroke="currentColor" stroke-width="1.4" {style}/>')
    size = f'viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}"'
    return Markup(f"<svg {size} aria-hidden='true'>{''.join(lines)}</svg>")
