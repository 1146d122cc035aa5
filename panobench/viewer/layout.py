"""How the Rerun viewer is laid out: the map large, pictures beside it, curves below."""

from __future__ import annotations

import rerun.blueprint as rrb


def blueprint() -> rrb.Blueprint:
    """The same for a run that is watched and for one that is finished."""
    space = rrb.Spatial3DView(origin="/world", name="Map and path", background=[16, 22, 30])
    pictures = rrb.Vertical(
        rrb.Spatial2DView(origin="/images/frame", name="Frame"),
        rrb.Spatial2DView(origin="/images/render", name="Render"),
    )
    curves = rrb.Horizontal(
        rrb.TimeSeriesView(origin="/plots/error_mm", name="Position error [mm]"),
        rrb.TimeSeriesView(origin="/plots/latency_ms", name="Latency [ms]"),
    )
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(space, pictures, column_shares=[3, 2]), curves, row_shares=[3, 1]),
        rrb.TimePanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
    )
