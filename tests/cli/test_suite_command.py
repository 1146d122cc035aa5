"""`panobench suite` as a user meets it: planning, choosing, exit codes, JSON, what is set aside."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from panobench.cli.main import run as panobench

pytestmark = pytest.mark.usefixtures("fake_plugin")

SUITE = """
name: demo
methods: [fake-still, fake-crash]
datasets: [{name: tiny, sequences: [blind]}]
options: {width: 64, max_frames: 4, timeout_s: 300}
"""


@pytest.fixture
def suite(tmp_path: Path) -> list[str]:
    (tmp_path / "suite.yaml").write_text(SUITE)
    return ["suite", "run", str(tmp_path / "suite.yaml"), "--out", str(tmp_path / "store")]


def rows(capsys: pytest.CaptureFixture[str]) -> dict[str, dict[str, str]]:
    return {row["cell"].split()[0]: row for row in json.loads(capsys.readouterr().out)}


@pytest.mark.slow
def test_a_suite_from_plan_to_status(suite: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench([*suite, "--dry-run"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("not run") == 2
    assert "to do: new" in printed
    assert panobench([*suite, "--only", "still"]) == 0
    printed = capsys.readouterr()
    assert printed.err.startswith("[1/1] ok            fake-still erp 64 px 4 frames tiny/blind seed 0  tracked 100%")
    assert printed.out.startswith("1 ok; runs in")
    assert panobench([*suite, "--dry-run", "--json"]) == 0
    planned = rows(capsys)
    assert (planned["fake-still"]["status"], planned["fake-still"]["to_do"]) == ("ok", "")
    assert planned["fake-crash"]["to_do"] == "new"
    assert panobench([*suite, "--json"]) == 1
    done = rows(capsys)
    assert done["fake-crash"]["status"] == "crashed"
    assert "three is my limit" in done["fake-crash"]["message"]
    (Path(done["fake-still"]["folder"]) / "run.json").write_text("{")
    assert panobench(["suite", "status", str(tmp_path / "store"), "--json"]) == 0
    found = {row["status"] for row in json.loads(capsys.readouterr().out)}
    assert found == {"crashed", "damaged"}
    assert panobench([*suite, "--dry-run"]) == 0
    printed = capsys.readouterr()
    assert "to do: its stored result was damaged" in printed.out
    assert "run.json:1: not valid JSON" in printed.err
    assert panobench([*suite, "--quiet"]) == 1
    assert "moved away" in capsys.readouterr().err
    assert panobench(["suite", "status", str(tmp_path / "store"), "--json"]) == 0
    assert [row["status"] for row in json.loads(capsys.readouterr().out)] == ["crashed", "ok", "quarantined"]


def test_a_dry_run_writes_nothing(suite: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench([*suite, "--dry-run"]) == 0
    assert "to do: new" in capsys.readouterr().out
    assert [p.name for p in tmp_path.iterdir()] == ["suite.yaml"]


@pytest.mark.parametrize(
    ("extra", "says"),
    [
        (["--jobs", "0"], "--jobs 0"),
        (["--retry", "faild"], "did you mean 'failed'"),
        (["--only", "nothing"], "selection --only"),
        (["--executor", "dusk"], "did you mean 'dask'"),
        (["--scheduler", "tcp://x:1"], "--scheduler is for --executor dask"),
    ],
)
def test_mistakes_are_one_line(
    suite: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str], extra: list[str], says: str
) -> None:
    assert panobench([*suite, *extra]) == 2
    printed = capsys.readouterr()
    assert says in printed.err
    assert printed.err.count("\n") == 1
    assert not (tmp_path / "store").exists()


def test_options_the_method_does_not_have_are_mistakes(
    suite: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "suite.yaml").write_text(SUITE.replace("fake-crash", "{name: fake-options, set: {featurs: 1}}"))
    assert panobench(suite) == 2
    assert "did you mean 'features'" in capsys.readouterr().err


def test_status_of_something_else(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["suite", "status", str(tmp_path)]) == 2
    assert "not a suite's store" in capsys.readouterr().err
