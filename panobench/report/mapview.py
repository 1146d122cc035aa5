"""Draw a Gaussian map in the 3-D plot, by the centres of its larger, opaque Gaussians in their colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import InputError
from panobench.geometry import Sim3
from panobench.report.figures import EYE, LOOKED_AT, numbers
from panobench.report.model import Array, Run

#: Most Gaussians shown of one map, and of all maps of a page; more would make the page large and slow.
MOST, MOST_IN_ALL = 5000, 30_000
_MIN_OPACITY = 0.5
#: Gaussians higher than this share of the way from eye level to the top of the map are left out: one looks
#: into a room from above, and a ceiling would hide it.
_OPEN_FROM = 0.55
#: Gaussians this near to the line of sight to the path, as a share of the map's size, are left out where they are in
#: front of it: a corridor would hide it.
_SIGHT = 0.025


def map_trace(
    run: Run,
    turn: Array,
    *,
    onto: Sim3 | None = None,
    box: tuple[Array, Array] | None = None,
    most: int = MOST,
    seed: int = 0,
) -> dict[str, Any] | None:
    """A Plotly trace of the run's map in the world of the plot; None when there is no readable map.

    turn: rotation (3, 3) from the ground truth's world into the plot's, whose z is up. onto: what moved the run's path
    onto another one, without ground truth. box: corners of what the plot shows; Gaussians outside are left out. The
    sample is drawn without replacement with probability proportional to each Gaussian's extent.
    """
    from panobench.splat.ply import read_ply

    path = run.folder / "map.ply"
    if run.trajectory is None or not path.is_file() or (run.groundtruth is not None and run.errors is None):
        return None
    try:
        gaussians = read_ply(path)
    except (InputError, OSError, ValueError):
        return None
    points = np.asarray(gaussians.means, dtype=np.float64)
    eyes = run.trajectory.positions
    if run.errors is not None:
        points, eyes = run.errors.transform.apply_points(points), run.errors.transform.apply_points(eyes)
    elif onto is not None:
        points, eyes = onto.apply_points(points), onto.apply_points(eyes)
    points, eyes = points @ turn.T, eyes @ turn.T
    opacity = 1.0 / (1.0 + np.exp(-np.asarray(gaussians.opacity_logits, dtype=np.float64).ravel()))
    extent = np.exp(np.asarray(gaussians.log_scales, dtype=np.float64)).max(axis=1)
    keep = (opacity > _MIN_OPACITY) & np.isfinite(points).all(axis=1) & np.isfinite(extent)
    if box is not None:
        keep &= ((points >= box[0]) & (points <= box[1])).all(axis=1)
    if keep.sum() < 50:
        return None
    level = float(np.median(eyes[:, 2]))
    top = float(np.quantile(points[keep, 2], 0.98))
    low, high = np.quantile(points[keep], [0.02, 0.98], axis=0)
    keep &= (points[:, 2] < level + _OPEN_FROM * max(top - level, 0.0)) & ((points >= low) & (points <= high)).all(
        axis=1
    )
    keep &= ~_hides(points, eyes, _SIGHT * float(np.linalg.norm(high - low)))
    chosen = np.flatnonzero(keep)
    if len(chosen) > most:
        weight = np.minimum(extent[chosen], np.quantile(extent[chosen], 0.95))
        rng = np.random.default_rng(seed)
        chosen = np.sort(rng.choice(chosen, most, replace=False, p=weight / weight.sum()))
    if len(chosen) == 0:
        return None
    colours = (np.clip(np.asarray(gaussians.colours)[chosen], 0, 1) * 255).round().astype(int)
    x, y, z = (numbers(points[chosen, k], 4) for k in range(3))
    return {
        "type": "scatter3d",
        "mode": "markers",
        "name": "Map",
        "meta": {"run": -3, "colour": -2},
        "hoverinfo": "skip",
        "x": x,
        "y": y,
        "z": z,
        "marker": {"size": 2.4, "opacity": 0.85, "color": [f"#{r:02x}{g:02x}{b:02x}" for r, g, b in colours.tolist()]},
    }


def _hides(points: Array, path: Array, radius: float) -> NDArray[np.bool_]:
    """(N,) bool: points nearer than ``radius`` to the line from the path (M, 3) to whoever looks at the plot."""
    towards = np.array(EYE) - np.array(LOOKED_AT)
    towards /= np.linalg.norm(towards)
    hidden = np.zeros(len(points), dtype=bool)
    for place in path[:: max(1, len(path) // 100)]:
        apart = points - place
        along = apart @ towards
        hidden |= (along > 0) & ((apart**2).sum(axis=1) - along**2 < radius**2)
    return hidden


def map_size(run: Run) -> tuple[Path, int] | None:
    """The run's PLY file and its bytes, None when it has none."""
    path = run.folder / "map.ply"
    return (path, path.stat().st_size) if path.is_file() else None
