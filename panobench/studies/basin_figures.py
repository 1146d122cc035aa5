"""Figures of the convergence-basin study, as Plotly dicts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

Measured = Mapping[str, Mapping[str, Any]]


def _range(measured: Measured) -> tuple[float, float]:
    """One range of losses for all, so that colours and heights can be compared."""
    values = np.concatenate([np.ravel(m["loss"]) for m in measured.values()])
    return float(values.min()), float(values.max())


def _rounded(values: Any) -> list[Any]:
    return [[float(f"{v:.4g}") for v in row] for row in values]


def levels(low: float, high: float) -> dict[str, float]:
    """About a dozen contour lines at round values between two losses."""
    rough = (high - low) / 12 or 1.0
    power = 10.0 ** np.floor(np.log10(rough))
    size = float(power * next(step for step in (1, 2, 5, 10) if step * power >= rough * 0.999))
    return {"start": float(np.ceil(low / size) * size), "end": float(np.floor(high / size) * size), "size": size}


def contour(name: str, measured: Measured) -> dict[str, Any]:
    """Loss over the plane with the starts: filled circles converged, crosses did not."""
    m = measured[name]
    low, high = _range(measured)
    data: list[dict[str, Any]] = [
        {
            "type": "contour",
            "x": m["offsets"],
            "y": m["offsets"],
            "z": _rounded(m["loss"]),
            "zmin": low,
            "zmax": high,
            "colorscale": "Viridis",
            "contours": levels(low, high),
            "line": {"width": 0.6},
            "colorbar": {"thickness": 10, "len": 0.9, "title": {"text": "loss"}, "nticks": 6, "tickformat": ".2~f"},
            "hovertemplate": "x %{x:.2f} z<br>z %{y:.2f} z<br>loss %{z:.4f}<extra></extra>",
        }
    ]
    for good, symbol, label in ((True, "circle", "converged"), (False, "x", "did not converge")):
        starts = [s for s in m["starts"] if s["converged"] is good]
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": label,
                "x": [round(s["distance"] * np.sin(s["direction"]), 4) for s in starts],
                "y": [round(s["distance"] * np.cos(s["direction"]), 4) for s in starts],
                "marker": {"symbol": symbol, "size": 8, "color": "#ffffff", "line": {"width": 1.5, "color": "#10202c"}},
                "hovertemplate": f"start, {label}<extra></extra>",
            }
        )
    axis = {"title": {"text": "right [median depths]"}, "constrain": "domain"}
    layout = {
        "xaxis": axis,
        "yaxis": {"title": {"text": "forward [median depths]"}, "scaleanchor": "x", "constrain": "domain"},
    }
    return {"data": data, "layout": layout}


def surface(name: str, measured: Measured) -> dict[str, Any]:
    """The loss as height."""
    m = measured[name]
    low, high = _range(measured)
    trace = {
        "type": "surface",
        "x": m["offsets"],
        "y": m["offsets"],
        "z": _rounded(m["loss"]),
        "cmin": low,
        "cmax": high,
        "colorscale": "Viridis",
        "showscale": False,
        "contours": {"z": {"show": True, "usecolormap": True, "width": 1}},
        "hovertemplate": "x %{x:.2f} z<br>z %{y:.2f} z<br>loss %{z:.4f}<extra></extra>",
    }
    scene = {
        "xaxis": {"title": {"text": "right"}},
        "yaxis": {"title": {"text": "forward"}},
        "zaxis": {"title": {"text": "loss"}, "range": [low, high]},
        "aspectmode": "manual",
        "aspectratio": {"x": 1, "y": 1, "z": 0.7},
        "camera": {"eye": {"x": 1.3, "y": -1.4, "z": 0.95}, "center": {"x": 0.0, "y": 0.0, "z": -0.15}},
    }
    return {"data": [trace], "layout": {"scene": scene}}


def _lines(names: Sequence[str], x: Sequence[Any], rows: Sequence[Sequence[Any]]) -> list[dict[str, Any]]:
    return [
        {
            "type": "scatter",
            "mode": "lines+markers",
            "name": name,
            "meta": {"run": -2, "colour": k},
            "x": list(x),
            "y": list(row),
            "line": {"width": 2},
            "marker": {"size": 7},
        }
        for k, (name, row) in enumerate(zip(names, rows))
    ]


def shares(rings: Sequence[float], rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Share of starts that converge over their distance, a line per field of view."""
    data = _lines([r["FoV"] for r in rows], rings, [[r[f"{ring:g} z [%] ↑"] for ring in rings] for r in rows])
    layout = {
        "xaxis": {"title": {"text": "Distance of the start [median depths]"}, "rangemode": "tozero"},
        "yaxis": {"title": {"text": "Converged [%]"}, "range": [-4, 104]},
        "showlegend": True,
    }
    return {"data": data, "layout": layout}


def eigenvalues(measured: Measured) -> dict[str, Any]:
    """The six eigenvalues, largest first, a line per field of view."""
    data = _lines(
        list(measured),
        [f"λ{k + 1}" for k in range(6)],
        [[float(f"{v:.4g}") for v in m["eigenvalues"]] for m in measured.values()],
    )
    layout = {
        "xaxis": {"title": {"text": "Eigenvalue, largest first"}, "type": "category"},
        "yaxis": {"title": {"text": "Size, per pixel"}, "type": "log"},
        "showlegend": True,
    }
    return {"data": data, "layout": layout}
