"""Write the page: the map in compact columns, the path, and where the camera starts."""

from __future__ import annotations

import base64
import gzip
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import UsageError
from panobench.geometry import distances_along, quaternion_from_matrix
from panobench.splat.gaussians import GaussianMap
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run

Array = NDArray[np.float64]

#: Most Gaussians of a page (33 bytes each before compression): it stays below 15 MB. The faintest are left out.
MOST = 300_000
#: Poses of the flight, and points of the line that shows the path.
FLIGHT, LINE = 240, 1500
#: Steps of the columns: of a scale's natural logarithm, and of a colour.
_SCALE_STEPS, _COLOUR_STEPS = 2000.0, 4096.0
#: What the view from above shows: this quantile of the distances of opaque Gaussians from the path's middle.
_NEAR = 0.9
#: It leaves out what is above this share of the way from the path to the top of the map: one looks into a room.
_OPEN_FROM = 0.45
_HERE = Path(__file__).parent
_SCRIPTS = ("splats.js", "walk.js")


@dataclass(frozen=True)
class Walk:
    """What a page shows. T_wc (N, 4, 4): the path, which may be empty; keyframes: indices into it."""

    title: str
    gaussians: GaussianMap
    T_wc: Array = field(default_factory=lambda: np.zeros((0, 4, 4)))
    keyframes: tuple[int, ...] = ()
    facts: tuple[str, ...] = ()


def walk_of_run(run: Run) -> Walk:
    """Raises UsageError where the run has no map."""
    if run.map is None or not len(run.map):
        raise UsageError(f"{run.folder} has no map to walk through")
    spec = run.record.spec
    times, own = run.frames.get("time", np.zeros(0)), run.trajectory.times
    wanted = [times[k] for k in run.record.keyframes or () if k < len(times)]
    keyframes = [int(np.abs(own - t).argmin()) for t in wanted if len(own) and np.abs(own - t).min() < 1e-4]
    facts = (f"{len(run.map):,} Gaussians".replace(",", "\u202f"), f"{len(own)} poses")
    return Walk(
        f"{spec.method} on {spec.sequence or spec.dataset}", run.map, run.trajectory.T_wc, tuple(keyframes), facts
    )


def write_walk(walk: Walk, target: Path) -> None:
    """Write the page. Raises UsageError for a map with nothing to show, and OutputError."""
    write_whole(target, walk_page(walk))


def walk_page(walk: Walk) -> str:
    """The whole page: no network, everything from data escaped."""
    import jinja2
    from markupsafe import Markup

    from panobench.report.html import safe_json

    gaussians = _shown(walk.gaussians)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_HERE), autoescape=True, undefined=jinja2.StrictUndefined
    )
    return environment.get_template("walk.html").render(
        title=walk.title,
        facts=walk.facts,
        about=safe_json(_about(walk, gaussians)),
        map=base64.b64encode(_packed(gaussians)).decode("ascii"),
        scripts=[Markup((_HERE / name).read_text(encoding="utf-8")) for name in _SCRIPTS],
    )


def _shown(gaussians: GaussianMap) -> GaussianMap:
    """What can be drawn and seen; of too many, those that are largest and least transparent."""
    keep = np.abs(gaussians.quats).max(axis=1, initial=0) > 0
    for values in gaussians.arrays():
        keep &= np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    alpha = 1.0 / (1.0 + np.exp(-gaussians.opacity_logits.astype(np.float64)))
    keep &= alpha > 1.0 / 255.0
    if not keep.any():
        raise UsageError("the map has nothing to show: every Gaussian is transparent or not finite")
    chosen = np.flatnonzero(keep)
    if len(chosen) > MOST:
        weight = alpha * np.exp(np.sort(gaussians.log_scales, axis=1)[:, 1:].sum(axis=1))
        chosen = np.sort(chosen[np.argsort(-weight[chosen], kind="stable")[:MOST]])
    return gaussians.select(chosen)


def _packed(gaussians: GaussianMap) -> bytes:
    """Columns one after the other: means, logarithms of scales, quaternions (w, x, y, z), colours, opacities."""

    def steps(values: NDArray[Any], size: float) -> bytes:
        return np.clip(np.rint(values * size), -32767, 32767).astype("<i2").tobytes()

    quats = gaussians.quats / np.linalg.norm(gaussians.quats.astype(np.float64), axis=1, keepdims=True)
    alpha = 1.0 / (1.0 + np.exp(-gaussians.opacity_logits.astype(np.float64)))
    # the means come first because they are read in place, as words of four bytes
    columns = [
        gaussians.means.astype("<f4").tobytes(),
        steps(gaussians.log_scales, _SCALE_STEPS),
        steps(quats, 32767.0),
        steps(gaussians.colours, _COLOUR_STEPS),
        np.rint(255.0 * alpha).astype(np.uint8).tobytes(),
    ]
    return gzip.compress(b"".join(columns), 6, mtime=0)


def _about(walk: Walk, gaussians: GaussianMap) -> dict[str, Any]:
    """The page's numbers: poses as position and quaternion (x, y, z, w)."""
    from panobench.bench.export.movie import flight

    T_wc = walk.T_wc
    first = T_wc[0] if len(T_wc) else np.eye(4)
    up = -T_wc[:, :3, 1].mean(axis=0) if len(T_wc) else np.array([0.0, -1.0, 0.0])
    up = up / np.linalg.norm(up) if np.linalg.norm(up) > 0.1 else -first[:3, 1]
    eyes = T_wc[:, :3, 3] if len(T_wc) else np.zeros((1, 3))
    means = gaussians.means[gaussians.opacity_logits > 0].astype(np.float64)
    means = means if len(means) else gaussians.means.astype(np.float64)
    centre = 0.5 * (eyes.min(axis=0) + eyes.max(axis=0))
    away = np.linalg.norm(means - centre, axis=1)
    reach = float(np.linalg.norm(eyes - centre, axis=1).max())
    radius = max(float(np.quantile(away, _NEAR)), 1.3 * reach, 1e-3)
    # a far shell may hold most Gaussians: what the path could see is a few times as far as what is nearest to it
    radius = min(radius, max(6.0 * float(np.quantile(away, 0.2)), 1.6 * reach, 1e-3))
    heights = means[away <= radius] @ up
    level = float(np.median(eyes @ up))
    top = float(np.quantile(heights, 0.98)) if len(heights) else level
    line = eyes[np.unique(np.linspace(0, len(eyes) - 1, min(len(eyes), LINE)).round().astype(int))]
    length = float(distances_along(eyes)[-1])
    unit = max(float(np.quantile(away, 0.5)), 1e-3)
    return {
        "count": len(gaussians),
        "scaleSteps": _SCALE_STEPS,
        "colourSteps": _COLOUR_STEPS,
        "up": _rounded(up),
        "unit": min(unit, radius),
        "start": _pose(first),
        "flight": [_pose(T) for T in flight(T_wc, FLIGHT)] if len(T_wc) > 1 else [],
        "path": [_rounded(p) for p in line] if len(T_wc) > 1 else [],
        "keyframes": [_pose(T_wc[k]) for k in walk.keyframes],
        "seconds": float(np.clip(length / (0.35 * unit), 10.0, 90.0)),
        "frame": {
            "centre": _rounded(centre),
            "radius": radius,
            "ceiling": level + _OPEN_FROM * max(top - level, 0.1 * radius),
        },
    }


def _pose(T: Array) -> list[float]:
    w, x, y, z = quaternion_from_matrix(T[:3, :3])
    return _rounded(np.array([*T[:3, 3], x, y, z, w]))


def _rounded(values: Array) -> list[float]:
    return [round(float(v), 6) for v in values]
