"""Stored runs scored again give the numbers of the run itself, or those of the other protocol."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from panobench.bench.records.record import RescoredRecord, RunRecord, read_record
from panobench.bench.records.rescore import Protocol, rescore
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.cli.main import run as panobench
from panobench.errors import InputError, UsageError
from panobench.metrics.base import PROTOCOL_VERSION

pytestmark = pytest.mark.usefixtures("fake_plugin")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return execute(RunRequest(method="fake-still", dataset="tiny", width=64), tmp_path / "run")


def test_the_same_protocol_gives_the_same_numbers(folder: Path) -> None:
    before, after = read_record(folder), rescore(folder, Protocol())
    assert after.protocol == before.protocol == PROTOCOL_VERSION
    assert after.status == "ok"
    for key, value in before.metrics.items():
        if isinstance(value, float):
            assert after.metrics[key] == pytest.approx(value, rel=1e-5), key
    assert after.timing == before.timing


def test_another_protocol_gives_other_numbers(folder: Path) -> None:
    free = rescore(folder, Protocol()).metrics
    rigid = rescore(folder, Protocol(alignment="se3"))
    raw = rescore(folder, Protocol(alignment="none")).metrics
    assert rigid.protocol == PROTOCOL_VERSION + "+align=se3"
    assert free["ate_rmse_m"] < rigid.metrics["ate_rmse_m"] < raw["ate_rmse_m"]
    assert rigid.metrics["scale"] == 1.0
    late = rescore(folder, Protocol(skip_s=0.55)).metrics
    assert late["tracked"] == 1.0
    assert late["path_length_m"] < free["path_length_m"]
    strict = rescore(folder, Protocol(failed_ate_m=0.001))
    assert strict.status == "lost"
    assert strict.rescored_from == RescoredRecord(PROTOCOL_VERSION, "ok")


def test_failed_runs_stay_failed(tmp_path: Path) -> None:
    folder = execute(RunRequest(method="fake-crash", dataset="tiny", width=64), tmp_path / "run")
    assert rescore(folder, Protocol(min_tracked=0.0)).status == "crashed"
    lost = execute(RunRequest(method="fake-loses-track", dataset="tiny", width=64), tmp_path / "lost")
    assert rescore(lost, Protocol()).status == "lost"
    assert rescore(lost, Protocol(min_tracked=0.3)).status == "ok"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("frames.csv", "index\n1\n"),
        ("frames.csv", "time\nabc\n"),
        ("frames.csv", ""),
        ("trajectory.tum", "0 1 2\n"),
        ("run.json", "{"),
    ],
)
def test_damaged_files_are_named(folder: Path, name: str, content: str) -> None:
    (folder / name).write_text(content)
    with pytest.raises(InputError, match=name):
        rescore(folder, Protocol())


@pytest.mark.parametrize(
    ("name", "metric", "protocol"),
    [
        ("1.2", True, Protocol()),
        ("1.0", True, Protocol("se3")),
        ("1.0", False, Protocol()),
        ("1.2+align=none+skip_s=2.5", False, Protocol("none", skip_s=2.5)),
        ("1.2+align=what+skip_s=-1", False, Protocol()),
        ("", False, Protocol()),
    ],
)
def test_the_protocol_of_a_run_is_read_from_its_name(name: str, metric: bool, protocol: Protocol) -> None:
    assert Protocol.of(RunRecord(protocol=name, metric=metric)) == protocol


def test_impossible_protocols() -> None:
    for values in ({"min_tracked": 2.0}, {"failed_ate_m": -1.0}, {"skip_s": np.inf}, {"alignment": "sim4"}):
        with pytest.raises(UsageError):
            Protocol(**values)  # type: ignore[arg-type]


def test_the_command(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["score", str(tmp_path), "--align", "se3", "--out", str(tmp_path / "new")]) == 0
    assert " -> " in capsys.readouterr().out
    assert read_record(tmp_path / "new" / "run").protocol == PROTOCOL_VERSION + "+align=se3"
    assert read_record(folder).protocol == PROTOCOL_VERSION
    assert (tmp_path / "new" / "run" / "trajectory.tum").read_bytes() == (folder / "trajectory.tum").read_bytes()
    assert panobench(["score", str(folder), "--max-ate", "0.001", "--in-place", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["after"]["status"] == "lost"
    assert read_record(folder).status == "lost"
    assert panobench(["score", str(folder), "--align", "sim4"]) == 2
    assert panobench(["score", str(folder), "--in-place", "--out", "x"]) == 2


def test_env_names_what_matters(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_DATA", "/data")
    monkeypatch.setenv("SECRET_TOKEN", "hunter2")
    assert panobench(["env", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["packages"]["numpy"] == np.__version__
    assert found["plugins"]["panobench-fake"] == "1.5"
    assert found["settings"]["PANOBENCH_DATA"] == "/data"
    assert "no_such_package" in found["cannot run here"]["method fake-absent"]
    assert panobench(["env"]) == 0
    assert "hunter2" not in capsys.readouterr().out
