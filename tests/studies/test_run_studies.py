"""The studies made of runs: which cells they plan, and what their tables say about results and failures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from panobench.bench.records.record import RunRecord
from panobench.bench.records.study_record import StudyResult
from panobench.bench.suite.cells import Cell
from panobench.bench.suite.store import Stored
from panobench.errors import UnknownNameError, UsageError
from panobench.plugins import registry
from panobench.specs import StudySpec
from panobench.studies import ablation, basin, cells, fov, iterations, robustness
from panobench.studies.base import StudyRequest

Answer = dict[str, Any]


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """``cells``: what was asked for. Every run is ok unless ``answer(cell)`` says otherwise."""
    state: dict[str, Any] = {"cells": [], "answer": lambda cell: {}}

    def run_cells(study: StudyRequest, name: str, asked: list[Cell]) -> dict[str, Stored]:
        state["cells"] = list(asked)
        found = {}
        for cell in asked:
            metrics = {"ate_rmse_m": 0.01, "tracked": 1.0, "psnr_db": 30.0, "ssim": 0.9, "lpips": None}
            document = {"status": "ok", "metrics": metrics, "timing": {"fps": 5.0, "tracking_fps": 20.0}}
            found[cell.identity] = stored({**document, **state["answer"](cell)})
        return found

    for module in (fov, ablation, iterations, robustness):
        monkeypatch.setattr(module, "run_cells", run_cells)
    return state


def stored(document: dict[str, Any]) -> Stored:
    return Stored(Path(), RunRecord.from_dict(document))


def study(tmp_path: Path, **options: Any) -> StudyRequest:
    return StudyRequest(tmp_path / "out", options=options)


def row(result: StudyResult, table: str, **wanted: str) -> dict[str, Any]:
    return next(r for r in result.tables[table] if all(r[k] == v for k, v in wanted.items()))


def test_fov_runs_every_field_of_view_and_sets_the_papers_rows_apart(tmp_path: Path, answers: Any) -> None:
    def answer(cell: Cell) -> Answer:
        degrees = float(cell.request.fov or 360)
        return {"metrics": {"ate_rmse_m": 3.6 / degrees, "tracked": 1.0}}

    answers["answer"] = answer
    result = fov.run(study(tmp_path, sequences="room1,room3"))
    asked = {(c.request.camera, c.request.fov, c.request.sequence) for c in answers["cells"]}
    assert len(asked) == 10
    assert {c.request.method for c in answers["cells"]} == {"panogs", "monogs"}
    assert all(c.request.camera == "pinhole:front" for c in answers["cells"] if c.request.method == "monogs")
    assert ("erp", "120", "room3") in asked
    assert ("erp", None, "room1") in asked
    assert ("pinhole:front", None, "room1") in asked
    assert row(result, "fov", FoV="120°")["room1 [cm] ↓"] == pytest.approx(3.0)
    paper = row(result, "fov", Method="PanoGS-SLAM", FoV="360°")
    assert (paper["source"], paper["room3 [cm] ↓"]) == ("published", 0.26)
    assert any("built-in rooms" in note for note in result.notes)
    assert result.figures["errors"]["data"][0]["x"] == [120.0, 200.0, 280.0, 360.0]


def test_failures_are_shown_and_counted(tmp_path: Path, answers: Any) -> None:
    def answer(cell: Cell) -> Answer:
        failed = cell.request.fov == "120" and cell.request.seed < 2
        return {"status": "lost", "message": "tracked 12%"} if failed else {}

    answers["answer"] = answer
    result = fov.run(study(tmp_path, sequences="room1", seeds="0,1,2", baseline="none"))
    narrow = row(result, "fov", FoV="120°")
    assert narrow["room1 [cm] ↓"] == narrow["Mean [cm] ↓"] == "/"
    assert sum("lost, tracked 12%" in note for note in result.notes) == 2
    assert result.figures["errors"]["data"][0]["x"] == [200.0, 280.0, 360.0]


def test_the_median_takes_the_worse_side_for_scores_as_for_errors(tmp_path: Path) -> None:
    options = cells.RunOptions()
    asked = [options.cell("room1", seed) for seed in range(3)]
    found = {}
    for cell, value in zip(asked, (20.0, 21.0, None)):
        document = {"status": "ok" if value else "lost", "metrics": {"psnr_db": value, "ate_rmse_m": value}}
        found[cell.identity] = stored(document)
    assert cells.median(found, asked, "psnr_db", higher_is_better=True) == 20.0
    assert cells.median(found, asked, "ate_rmse_m") == 21.0
    assert cells.median(found, asked[:1], "lpips") is None
    assert cells.mean([1.0, "/"]) == "/"
    assert cells.mean([1.0, None]) is None
    assert cells.mean([1.0, 2.0]) == 1.5
    assert cells.geometric_mean([1.0, 4.0]) == pytest.approx(2.0)
    assert cells.geometric_mean([1.0, "/"]) == "/"
    assert cells.geometric_mean([1.0, None]) is None


def test_ablation_changes_one_thing_at_a_time(tmp_path: Path, answers: Any) -> None:
    result = ablation.run(study(tmp_path, sequences="room1,room2"))
    settings = {(c.request.preset, tuple(c.request.settings.items()), c.request.depth) for c in answers["cells"]}
    assert (None, (), None) in settings
    assert (None, (("rendering.weights", "uniform"),), None) in settings
    assert ("paper", (("rendering.weights", "gaussian"),), None) in settings
    assert ("paper", (("tracking.solver", "gauss-newton"),), None) in settings
    assert (None, (("seeding.depth_guided", False), ("fixed_lag.sweep", False)), "constant") in settings
    assert len(answers["cells"]) == 2 * 12
    full = row(result, "ablation", Method="PanoGS-SLAM", Preset="default")
    assert full["ATE geom. mean [cm] ↓"] == pytest.approx(1.0)
    assert (full["ATE [cm] ↓"], full["PSNR [dB] ↑"], full["LPIPS ↓"]) == (pytest.approx(1.0), 30.0, None)
    assert row(result, "ablation", Method="w/o L_pano", source="published")["ATE [cm] ↓"] == 5.19


@pytest.mark.parametrize("preset", ["default", "paper"])
def test_every_variant_is_one_panogs_has(preset: str) -> None:
    from panobench.bench.run.config import method_config
    from panobench.specs import MethodSpec

    spec = registry().get(MethodSpec, "panogs")
    chosen = None if preset == "default" else preset
    base = method_config(spec, chosen, {})
    for name, (settings, changes) in ablation.variants(preset).items():
        assert (method_config(spec, chosen, settings) != base) == bool(settings), name
        assert set(changes) <= {"depth"}


def test_iterations_set_both_counts_and_give_speed(tmp_path: Path, answers: Any) -> None:
    result = iterations.run(study(tmp_path, counts="15/30,100/100"))
    settings = [c.request.settings for c in answers["cells"]]
    assert {"tracking.iterations": 100, "mapping.iterations": 100} in settings
    assert settings[-1] == {}
    assert answers["cells"][-1].request.preset is None
    assert [c.request.camera for c in answers["cells"] if c.request.method == "monogs"] == ["pinhole:front"] * 2
    ours = row(result, "iterations", source="measured", Method="panogs paper")
    assert (ours["ATE [cm] ↓"], ours["Frames/s ↑"], ours["Tracking/s ↑"]) == (pytest.approx(1.0), 5.0, 20.0)
    assert row(result, "iterations", Method="MonoGS")["ATE [cm] ↓"] == pytest.approx(231.4)
    with pytest.raises(UsageError, match="15/30"):
        iterations.run(study(tmp_path, counts="15-30"))


def test_robustness_disturbs_one_thing_at_a_time_and_shows_the_coverage_of_lost_runs(
    tmp_path: Path, answers: Any
) -> None:
    def answer(cell: Cell) -> Answer:
        if ":occluder" in (cell.request.sequence or ""):
            metrics = {"tracked": 0.8, "ate_rmse_m": 0.003}
            return {"status": "lost", "message": "tracked 80%", "metrics": metrics, "frames": {"given": 100}}
        if cell.request.every == 10:
            return {"status": "crashed", "message": "fell over", "metrics": {}}
        return {"metrics": {"ate_rmse_m": 0.002, "tracked": 1.0, "novel_psnr_db": 31.0}}

    answers["answer"] = answer
    result = robustness.run(study(tmp_path, sequences="room1,synpano/devroom", root="data", starts="false"))
    requests = [c.request for c in answers["cells"]]
    assert {r.dataset for r in requests} == {"disturbed"}
    assert len({c.identity for c in answers["cells"]}) == 2 * 2 * 10
    assert {r.sequence for r in requests if r.every == 5} == {"rooms/room1", "synpano/devroom"}
    noisy = row(result, "robustness", Method="sparse", Disturbance="noise, sigma 0.03")
    assert (noisy["room1 tracked [%] ↑"], noisy["room1 ATE [mm] ↓"]) == (100.0, pytest.approx(2.0))
    assert noisy["synpano/devroom PSNR [dB] ↑"] == 31.0
    hidden = row(result, "robustness", Method="panogs", Disturbance="occluder, 25% of the view")
    assert (hidden["room1 tracked [%] ↑"], hidden["room1 ATE [mm] ↓"]) == (pytest.approx(80.0), "/")
    crashed = row(result, "robustness", Method="panogs", Disturbance="one frame in 10")
    assert crashed["room1 tracked [%] ↑"] == "/"
    assert sum("lost, tracked 80%" in note for note in result.notes) == 4
    shown = result.figures["errors"]["data"][0]
    assert len(shown["x"]) == 8
    assert "one frame in 10" not in shown["y"]
    assert "one frame in 10" in result.figures["errors"]["layout"]["yaxis"]["categoryarray"]


@pytest.mark.parametrize(
    ("status", "tracked", "ate_m", "black", "expected"),
    [
        ("lost", 0.8, 0.003, 20, (100.0, 3.0)),  # all that show something
        ("lost", 0.8, 0.003, 5, (100 * 0.8 / 0.95, "/")),
        ("lost", 1.0, 4.0, 0, (100.0, "/")),  # an error no table shows
        ("ok", 0.95, 0.003, 0, (95.0, 3.0)),
        ("crashed", 0.95, 0.003, 0, ("/", "/")),
        ("lost", None, None, 0, ("/", "/")),
    ],
)
def test_black_frames_do_not_count_against_a_method(
    status: str, tracked: float | None, ate_m: float | None, black: int, expected: tuple[Any, Any]
) -> None:
    metrics = {"tracked": tracked, "ate_rmse_m": ate_m, "novel_psnr_db": 30.0}
    document = {"status": status, "metrics": metrics, "frames": {"given": 100}}
    found = robustness.outcome(stored(document), black)
    assert (found.tracked, found.ate_mm) == (pytest.approx(expected[0]) if expected[0] != "/" else "/", expected[1])
    assert robustness.black_frames(f"noise=0.03:black={black}") == black


def test_robustness_shows_from_how_far_a_frame_is_found(
    tmp_path: Path, answers: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def measure(options: basin.BasinOptions, request: StudyRequest) -> dict[str, Any]:
        assert (options.dataset, options.sequence, options.fov, options.pinhole) == ("rooms", "room1", (360.0,), False)
        starts = [
            {"distance": ring, "converged": ring < 0.3 or k == 0, "error": 0.01 * ring}
            for ring in options.rings
            for k in range(4)
        ]
        return {"360°": {"starts": starts, "median_depth_m": 2.0}}

    monkeypatch.setattr(basin, "measure", measure)
    found = robustness.run(study(tmp_path, disturbances="none")).tables["starts"]
    assert [r["Found [%] ↑"] for r in found] == [100.0, 100.0, 100.0, 25.0, 25.0, 25.0]
    assert found[1]["Start off by"] == "0.1 median depths (200 mm)"
    assert found[1]["Worst found [mm] ↓"] == pytest.approx(2.0)


def test_every_disturbance_of_the_robustness_study_is_one_there_is() -> None:
    from panobench.datasets.synthetic.disturb import Disturbances

    for text in robustness.DISTURBANCES:
        assert robustness.describe(text)
        if text != "none" and not text.startswith("every="):
            assert Disturbances.parse(text.split(":")).to_dict()
    for wrong in ("noise", "nois=1", "noise=x"):
        with pytest.raises(UsageError, match="NAME=NUMBER"):
            robustness.describe(wrong)


@pytest.mark.parametrize("name", ["fov", "ablation", "iterations", "basin", "robustness", "length"])
def test_studies_are_plugins_that_name_their_options(name: str, tmp_path: Path) -> None:
    run = registry().get(StudySpec, name).load()
    with pytest.raises(UnknownNameError, match="widht"):
        run(study(tmp_path, widht="64"))


def test_the_order_of_the_papers_ablation_is_said_beside_ours() -> None:
    rows = [
        {"Method": name, "Preset": preset, "ATE [cm] ↓": ate, "source": source}
        for preset, source, errors in (
            ("default", "measured", (0.2, 0.3, "/")),
            ("the paper's", "published", (0.78, 5.19, 1.27)),
        )
        for name, ate in zip(("PanoGS-SLAM", "w/o L_pano", "w/o DGIS"), errors)
    ]
    rows.append({"Method": "Adam tracking", "Preset": "default", "ATE [cm] ↓": 0.1, "source": "measured"})
    ours, paper = ablation.order_notes(rows)
    assert ours.endswith("preset default: PanoGS-SLAM 0.2 < w/o L_pano 0.3 < w/o DGIS lost.")
    assert paper.endswith("in the paper: PanoGS-SLAM 0.78 < w/o DGIS 1.27 < w/o L_pano 5.19.")
    assert ablation.order_notes(rows[:3]) == []


def test_steps_to_a_wider_view_are_counted_with_lost_runs_as_the_worst() -> None:
    ours = [(120.0, ["/", 3.0, "/"]), (200.0, [2.0, 1.0, "/"]), (360.0, [1.0, 4.0, None])]
    (note,) = fov.order_notes(ours, [(120.0, [3.0]), (360.0, [1.0])])
    assert "in 3 of 4 steps" in note
    assert "in the paper: 1 of 1" in note
    assert fov.order_notes(ours[:1], []) == []
