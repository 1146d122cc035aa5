"""The height above the ground as evidence: what drifts is doubted, and what climbs, flies off or is metric is not."""

from __future__ import annotations

import numpy as np

from panobench.methods.ground import height_above_ground
from panobench.types import Estimate, Trajectory
from panobench.verdict.height import FRAMES, LEAST, steady_height


def walk(heights: np.ndarray, climb: np.ndarray | None = None, *, metric: bool = False) -> Estimate:
    """An upright camera that walks ahead: heights (N,) above the ground, climb (N,) upwards."""
    n = len(heights)
    T = np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (n, 1, 1))  # y down, in a world with y up
    T[:, 2, 3] = 0.05 * np.arange(n)
    if climb is not None:
        T[:, 1, 3] = climb
    rows = {i: {"height": float(h)} for i, h in enumerate(heights)}
    return Estimate(Trajectory(np.arange(n) / 15, T), frames=rows, metric=metric)


def test_a_scale_that_shrinks_is_doubted() -> None:
    found = steady_height(walk(1.5 * np.exp(-np.linspace(0, 1.4, 300))))
    assert found is not None
    assert found.trust < 0.3
    assert "without a climb" in found.text


def test_furniture_below_is_no_drift() -> None:
    heights = np.full(300, 1.5)
    heights[100:140] = 0.9
    found = steady_height(walk(heights))
    assert found is not None
    assert found.trust == 1.0


def test_a_drone_that_rises_is_not_doubted() -> None:
    climb = np.linspace(0.0, 4.0, 300)
    found = steady_height(walk(0.3 + climb, climb))
    assert found is not None
    assert found.trust == 1.0


def test_it_never_fails_a_run_by_itself() -> None:
    found = steady_height(walk(np.geomspace(1.0, 100.0, 300)))
    assert found is not None
    assert found.trust == LEAST


def test_nothing_is_said_of_short_runs_metres_or_unknown_heights() -> None:
    falls = np.linspace(1.5, 0.3, FRAMES)
    assert steady_height(walk(falls[1:])) is None
    assert steady_height(walk(falls, metric=True)) is None
    assert steady_height(Estimate(walk(falls).trajectory)) is None


def test_height_above_a_floor_is_that_of_the_camera() -> None:
    rng = np.random.default_rng(0)
    rays = rng.normal(size=(4000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    with np.errstate(divide="ignore"):
        distance = np.where(rays[:, 1] > 0, 1.6 / rays[:, 1], np.nan)
    assert abs(height_above_ground(rays, distance) - 1.6) < 1e-9
    assert np.isnan(height_above_ground(rays[rays[:, 1] < 0.2], distance[rays[:, 1] < 0.2]))
