from __future__ import annotations

import json
import re

import numpy as np
import pytest

from panobench.datasets.files.trajectory_io import write_tum
from panobench.geometry import Sim3, so3_exp
from panobench.report import figures
from panobench.report.collect import collect, read_run
from panobench.report.drawing import plan_svg
from panobench.report.html import build_html
from panobench.report.mapview import MOST, map_trace
from panobench.report.variants import variants
from panobench.splat.ply import write_ply
from panobench.types import Trajectory


def write_map(folder, n=200, opacity=4.0):
    """A box of n Gaussians around the loop of the fake runs, in the estimate's world; y is down."""
    rng = np.random.default_rng(0)
    means = rng.uniform(-2, 2, (n, 3))
    quats = np.tile([1.0, 0.0, 0.0, 0.0], (n, 1))
    colours = np.tile([1.0, 0.5, 0.0], (n, 1))
    write_ply(folder / "map.ply", means, np.full((n, 3), -3.0), quats, np.full(n, opacity), colours)
    return means


def test_the_map_stands_upright_in_the_world_of_the_plot(make_run):
    folder = make_run("a", noise=0.0001)
    write_map(folder)
    run = read_run(folder)
    turn = figures.upright([run])
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(turn @ [0, -1, 0], [0, 0, 1], atol=1e-3)  # up is -y in the fake world
    trace = map_trace(run, turn)
    assert trace is not None
    assert set(trace["marker"]["color"]) == {"#ff8000"}
    assert max(trace["z"]) < 0.6 * 2  # open towards the top
    assert min(trace["z"]) < -1.5
    assert trace == map_trace(run, turn)


def test_a_map_does_not_hide_the_path(make_run):
    """Seen as the plot is when it opens, no Gaussian lies before a place of the path; those behind it stay."""
    folder = make_run("a", noise=0.0)
    write_map(folder, n=MOST)
    run = read_run(folder)
    turn = figures.upright([run])
    trace = map_trace(run, turn)
    points = np.array([trace[k] for k in "xyz"]).T
    towards = np.subtract(figures.EYE, figures.LOOKED_AT)
    towards /= np.linalg.norm(towards)
    for place in run.trajectory.positions @ turn.T:
        apart = points - place
        along = apart @ towards
        beside = np.linalg.norm(apart - along[:, None] * towards, axis=1)
        assert not ((beside < 0.1) & (along > 0.01)).any()
        assert ((beside < 0.4) & (along < 0)).any()


def test_only_maps_that_can_be_placed_are_drawn(make_run):
    folder = make_run("a")
    assert map_trace(read_run(folder), np.eye(3)) is None
    write_map(folder, opacity=-4.0)
    assert map_trace(read_run(folder), np.eye(3)) is None
    (folder / "map.ply").write_bytes(b"ply\nwhat")
    assert map_trace(read_run(folder), np.eye(3)) is None
    write_map(folder, n=MOST * 4)
    trace = map_trace(read_run(folder), np.eye(3))
    assert trace is not None
    assert len(trace["x"]) == MOST


def test_trajectories_are_drawn_aligned(make_run):
    folder = make_run("a", noise=0.0)
    run = read_run(folder)
    moved = Sim3(3.0, so3_exp([0.1, 0.7, -0.4]), np.array([5.0, 0.0, 1.0])).apply_poses(run.trajectory.T_wc)
    lines = [f"{t:.9f} {' '.join(map(str, T[:3, 3]))} 0 0 0 1" for t, T in zip(run.trajectory.times, moved)]
    (folder / "trajectory.tum").write_text("\n".join(lines))
    _, plan = figures.trajectory_figures([read_run(folder)], ["a"], [0])
    truth, estimate = (next(t for t in plan["data"] if t["name"] == name) for name in ("Ground truth", "a"))
    np.testing.assert_allclose(estimate["x"], truth["x"], atol=1e-4)
    np.testing.assert_allclose(estimate["y"], truth["y"], atol=1e-4)


def test_without_truth_axes_do_not_claim_metres(make_run):
    spatial, plan = figures.trajectory_figures([read_run(make_run("a", truth=False))], ["a"], [0])
    assert "[m]" not in json.dumps([spatial["layout"], plan["layout"]])
    assert len(plan["data"]) == 1


def test_axes_become_logarithmic_when_methods_are_far_apart(make_run):
    near = [read_run(make_run("a", noise=0.001)), read_run(make_run("b", noise=0.003))]
    far = [near[0], read_run(make_run("c", noise=0.1))]
    axis = [figures.error_figure(runs, ["x", "y"], [0, 1], "translation")["layout"]["yaxis"] for runs in (near, far)]
    assert axis[0]["type"] == "linear"
    assert axis[0]["title"]["text"] == "Position error [mm]"
    assert axis[1]["type"] == "log"
    assert 10.0 in axis[1]["tickvals"]


def test_long_traces_are_thinned_and_gaps_kept():
    keep = figures.thin(10_000)
    assert len(keep) == figures.MAX_POINTS
    assert (keep[0], keep[-1]) == (0, 9_999)
    assert figures.numbers(np.array([1.23456789, np.nan, np.inf])) == [1.2346, None, None]


def test_labels_say_where_methods_were_given_different_input(make_run):
    make_run("a", spec={"width": 256})
    folder = make_run("b", method="sparse", spec={"width": 512, "preset": "fast"}).parent
    make_run("c", method="imported", origin="imported", spec={"width": None})
    assert [v.label for v in variants(collect([folder]))] == ["panogs · 256 px", "sparse · 512 px", "imported"]


@pytest.mark.parametrize("key", ["3d", "top", "ate", "rot", "latency", "loss"])
def test_a_page_has_every_plot_of_its_data(make_run, key):
    folder = make_run("a")
    write_map(folder)
    assert f'"seq0-{key}"' in build_html(collect([folder]))


def test_without_truth_paths_are_aligned_to_the_most_trusted(make_run, edit):
    folders = [make_run(name, truth=False, method=name, noise=0.0) for name in ("one", "two")]
    turned = Sim3(3.0, so3_exp(np.array([0.2, 0.1, 0.0])), np.array([1.0, 2.0, 3.0]))
    moved = read_run(folders[1]).trajectory
    write_tum(folders[1] / "trajectory.tum", Trajectory(moved.times, turned.apply_poses(moved.T_wc)))
    edit(folders[0], lambda d: d.update(verdict={"word": "trusted", "confidence": 0.9}))
    runs = [read_run(folder) for folder in folders]
    reference, onto = figures.alignment_without_truth(runs)
    assert reference == 0
    assert list(onto) == [1]
    spatial, _ = figures.trajectory_figures(runs, ["one", "two"], [0, 1], onto)
    first, second = (np.array([trace[k] for k in "xyz"]) for trace in spatial["data"])
    assert np.abs(first - second).max() < 1e-3
    assert figures.alignment_without_truth([runs[0]]) is None


def test_a_lost_path_and_a_far_map_do_not_shrink_the_plot(make_run):
    good, lost = make_run("a", noise=0.001), make_run("b", method="lost", status="lost", noise=400.0)
    spatial, _ = figures.trajectory_figures([read_run(good), read_run(lost)], ["a", "b"], [0, 1])
    low, high = spatial["layout"]["scene"]["xaxis"]["range"]
    assert high - low < 8


def test_paper_has_the_path_before_any_script_has_drawn_it(make_run):
    _, plan = figures.trajectory_figures([read_run(make_run("a"))], ["a"], [3])
    svg = plan_svg(plan)
    assert svg.count("<polyline") == 2
    assert 'data-colour="3"' in svg
    numbers = [float(v) for v in re.findall(r"[\d.]+(?=[,\s\"])", svg.split('points="')[1].split('"')[0] + " ")]
    assert min(numbers) >= 0
    assert max(numbers) <= 320


@pytest.mark.parametrize("values", [[0.33, 0.37], [2.9, 3.8], [1.0, 1.0], [6.0, 9.0], [0.02, 300.0], [5.0, 5.0]])
def test_an_axis_of_values_that_lie_close_together_has_labels(values: list[float]) -> None:
    axis = figures.log_axis(values)
    low, high = axis.get("range", np.log10([min(values), max(values)]))
    assert low <= np.log10(min(values)) <= np.log10(max(values)) <= high
    shown = [text for tick, text in zip(axis["tickvals"], axis["ticktext"]) if low <= np.log10(tick) <= high]
    assert len(shown) >= 2
