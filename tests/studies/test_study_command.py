"""`panobench study` with a real run, its result on disk, and its place in reports."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from panobench.bench.records.study_record import StoredStudy, StudyResult, read_study, write_study
from panobench.cli.main import run as cli
from panobench.errors import InputError
from panobench.report.build import write_report
from panobench.report.studies import study_tables


@pytest.mark.slow
def test_a_study_runs_resumes_and_is_reported(tmp_path: Path, fake_plugin: Path, capsys) -> None:
    out = tmp_path / "fov"
    command = ["study", "fov", "--quick", "--out", str(out)]
    for option in (
        "method=fake-still",
        "dataset=tiny",
        "sequences=blind",
        "fov=360",
        "pinhole=no",
        "baseline=none",
        "width=64",
    ):
        command += ["--set", option]
    assert cli(command) == 0
    first = capsys.readouterr()
    assert "[1/1] running fake-still" in first.err
    assert "Accuracy against field of view\nMethod" in first.out
    assert cli(command) == 0
    assert "running" not in capsys.readouterr().err
    assert cli([*command, "--json"]) == 0
    printed = capsys.readouterr()
    assert (json.loads(printed.out)["name"], printed.err) == ("fov", "")
    stored = read_study(out)
    assert stored.provenance["quick"] is True
    assert stored.provenance["command"].startswith("panobench study fov --out")
    collection = write_report([out], tmp_path / "r.html")
    assert (len(collection.runs), len(collection.studies)) == (1, 1)
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "<h1>Accuracy against field of view</h1>" in page
    assert "quick version" in page
    assert cli(["report", str(out), "-o", str(tmp_path / "r.csv")]) == 0
    assert (tmp_path / "r.fov.csv").read_text().startswith("table,origin,flags,label,Camera,FoV")


def test_mistakes_are_one_line(tmp_path: Path, capsys) -> None:
    for words, message in (
        (["fovv"], "did you mean 'fov'"),
        (["fov", "--set", "width"], "KEY=VALUE"),
        (["basin", "--set", "grid=1"], "option grid: must be at least 3"),
        (["fov", "--jobs", "0"], "--jobs 0"),
    ):
        assert cli(["study", *words, "--out", str(tmp_path)]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1


def result() -> StudyResult:
    rows = [
        {"Method": "a", "ATE [cm] ↓": 1.5, "PSNR ↑": 30.0, "source": "measured"},
        {"Method": "b <x>", "ATE [cm] ↓": "/", "PSNR ↑": None, "source": "measured"},
        {"Method": "c", "ATE [cm] ↓": 0.7, "PSNR ↑": 31.0, "source": "published"},
        {"Method": "d", "ATE [cm] ↓": 2.5, "PSNR ↑": float("inf"), "source": "measured"},
    ]
    figure = {"data": [{"type": "surface", "z": [[1, 2], [3, 4]]}], "layout": {"scene": {}}}
    lines = {"data": [{"x": [1, 10], "y": ["<b>", 2]}], "layout": {"xaxis": {"type": "log"}}}
    captions = {"mine": "What it is. What it says."}
    return StudyResult("mine", {"mine": rows}, {"f": figure, "g": lines}, ["a note"], "My study", captions)


def test_tables_rank_measured_rows_only(tmp_path: Path) -> None:
    write_study(tmp_path, result(), {"quick": False})
    table = study_tables([read_study(tmp_path)])[0]
    assert (table.name, table.title, table.caption) == ("mine", "What it is", "What it says.")
    assert [(c.label, c.unit, c.better) for c in table.columns[1:]] == [("ATE", "cm", "lower"), ("PSNR", "", "higher")]
    ate = {row.cells[0].text: row.cells[1] for row in table.rows}
    assert [ate[n].rank for n in ("a", "d", "c")] == [1, 2, None]
    assert ate["b <x>"].failed
    assert [row.origin for row in table.rows][-1] == "published"
    assert table.rows[2].cells[2].text == "n/a"  # infinity is no number


def test_a_study_without_runs_makes_a_page(tmp_path: Path) -> None:
    write_study(tmp_path / "s", result(), {"command": "panobench study mine"})
    write_report([tmp_path / "s"], tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "b &lt;x&gt;" in page
    assert "a note" in page
    assert 'id="sequences"' not in page
    assert 'data-figure="study0-f"' in page


@pytest.mark.parametrize("text", ["{", "[]", '{"schema": 99}', ""])
def test_a_damaged_study_is_said_or_shown(text: str, tmp_path: Path) -> None:
    (tmp_path / "study.json").write_text(text)
    with pytest.raises(InputError, match=r"study\.json"):
        read_study(tmp_path)
    with pytest.raises(InputError, match="none of the 1"):
        write_report([tmp_path], tmp_path / "r.html")


def test_odd_content_is_left_out(tmp_path: Path) -> None:
    odd = {"schema": 1, "tables": {"a": [1, {"x": [1]}], "b": 3}, "figures": {"f": {"data": 3}}, "notes": "no"}
    (tmp_path / "study.json").write_text(json.dumps(odd))
    stored = read_study(tmp_path)
    assert isinstance(stored, StoredStudy)
    assert stored.result.tables == {"a": [{"x": [1]}]}
    assert stored.result.figures == {}
    write_report([tmp_path], tmp_path / "r.html")
