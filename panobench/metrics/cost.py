"""The cost of a run besides time and memory, which the runner measures."""

from __future__ import annotations

from panobench.metrics.base import MetricInput


def cost_metrics(data: MetricInput) -> dict[str, float | None]:
    """Number of Gaussians (or points) in the map; keyframes per frame given."""
    estimate = data.estimate
    return {
        "map_gaussians": None if estimate.map is None else float(len(estimate.map)),
        "keyframe_share": len(estimate.keyframes) / len(data.frames) if data.frames else None,
    }
