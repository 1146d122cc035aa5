"""A small card of one run for notebooks: a picture, the path from above, and the most important figures."""

from __future__ import annotations

import numpy as np
from markupsafe import escape

from panobench.report.figures import thin, upright
from panobench.report.headline import run_tiles
from panobench.report.images import encode_file
from panobench.report.model import Run
from panobench.report.ranking import failure

_WIDTH, _HEIGHT = 320, 160


def card(run: Run) -> str:
    """HTML without scripts or outside references; everything from data is escaped."""
    place = f"{run.dataset} / {run.sequence}" + (f", seed {run.seed}" if run.seed is not None else "")
    words = [word for word in (failure(run), *run.cautions) if word]
    badges = "".join(f' <b style="color:#a33209">{escape(word)}</b>' for word in words)
    tiles = "".join(
        f"<td style='text-align:left;padding:2px 14px 2px 0'><small>{escape(t.name)}</small><br>"
        f"<b>{escape(t.value)}</b> {escape(t.unit)}</td>"
        for t in run_tiles(run)
    )
    parts = "".join(part for part in (_picture(run), path_svg(run)) if part)
    return (
        "<div style='font-family:system-ui,sans-serif;border:1px solid #8884;border-radius:8px;padding:10px 14px;"
        f"max-width:700px;margin:4px 0'><b>{escape(run.method)}</b> on {escape(place)}{badges}"
        f"<div style='display:flex;gap:10px;flex-wrap:wrap;margin:8px 0'>{parts}</div>"
        f"<table style='border:0'><tr>{tiles}</tr></table></div>"
    )


def _picture(run: Run) -> str:
    shown = [pair for pair in run.pairs if not pair.novel]
    picture = encode_file(shown[len(shown) // 2].render, _WIDTH) if shown else None
    if picture is None:
        return ""
    about = f"render of frame {shown[len(shown) // 2].frame}"
    return f"<img src='{picture.uri}' width='{picture.width}' height='{picture.height}' alt='{about}'>"


def path_svg(run: Run) -> str:
    """The path from above (and the true one, dotted) as SVG, "" without poses; the longer side fills the picture."""
    estimate = run.errors.positions if run.errors is not None else None
    if estimate is None and run.trajectory is not None:
        estimate = run.trajectory.positions
    if estimate is None or len(estimate) == 0:
        return ""
    turn = upright([run])
    paths = [(estimate, "#0b5c9e", "")]
    if run.errors is not None and run.groundtruth is not None:
        paths.insert(0, (run.groundtruth.positions, "#888", "4 3"))
    flat = [(points @ turn.T)[thin(len(points), 300)][:, :2] for points, _, _ in paths]
    low, high = np.min([p.min(axis=0) for p in flat], axis=0), np.max([p.max(axis=0) for p in flat], axis=0)
    scale = min((_WIDTH - 20) / max(high[0] - low[0], 1e-9), (_HEIGHT - 20) / max(high[1] - low[1], 1e-9))
    middle = (low + high) / 2
    lines = []
    for points, (_, colour, dash) in zip(flat, paths):
        xy = (points - middle) * [scale, -scale] + [_WIDTH / 2, _HEIGHT / 2]
        dots = " ".join(f"{x:.1f},{y:.1f}" for x, y in xy)
        dashed = f" stroke-dasharray='{dash}'" if dash else ""
        lines.append(f"<polyline points='{dots}' fill='none' stroke='{colour}' stroke-width='1.6'{dashed}/>")
    return f"<svg width='{_WIDTH}' height='{_HEIGHT}' role='img' aria-label='path from above'>{''.join(lines)}</svg>"
