"""Run folders appear whole or not at all, and a damaged run.json is told from a good one."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from panobench.bench.records.runfolder import PendingRun, read_run_json, write_frames, write_json
from panobench.errors import InputError, UsageError

GOOD = {"schema": 1, "status": "ok"}


def publish(target: Path, force: bool = False, **values: object) -> None:
    pending = PendingRun(target, force)
    write_json(pending.path / "run.json", {**GOOD, **values})
    pending.publish()


def test_publish_and_discard(tmp_path: Path) -> None:
    pending = PendingRun(tmp_path / "a" / "run")
    write_json(pending.path / "run.json", GOOD)
    assert not (tmp_path / "a" / "run").exists()
    pending.publish()
    assert read_run_json(tmp_path / "a" / "run") == GOOD
    other = PendingRun(tmp_path / "a" / "other")
    other.discard()
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == ["run"]


def test_what_is_there_is_not_overwritten(tmp_path: Path) -> None:
    publish(tmp_path / "run", n=1)
    with pytest.raises(UsageError, match="a run is already there"):
        PendingRun(tmp_path / "run")
    publish(tmp_path / "run", force=True, n=2)
    assert read_run_json(tmp_path / "run")["n"] == 2
    (tmp_path / "empty").mkdir()
    publish(tmp_path / "empty")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").write_text("precious")
    with pytest.raises(UsageError, match="not a run folder"):
        PendingRun(tmp_path / "full", force=True)
    (tmp_path / "file").write_text("x")
    with pytest.raises(UsageError, match="is a file"):
        PendingRun(tmp_path / "file")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty", "file", "full", "run"]


def test_leavings_of_killed_runs_are_swept_but_not_those_of_living_ones(tmp_path: Path) -> None:
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    (tmp_path / f".run.{dead.pid}.0123abcd.part").mkdir()
    (tmp_path / f".run.{os.getpid()}.0123abcd.part").mkdir()
    PendingRun(tmp_path / "run").discard()
    assert [p.name for p in tmp_path.iterdir()] == [f".run.{os.getpid()}.0123abcd.part"]


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "not valid JSON"),
        (b'{"schema": 1,\n "status": ', "run.json:2: not valid JSON"),
        (b"[]", "no status"),
        (b'{"schema": 1, "status": 7}', "no status"),
        (b'{"schema": 99, "status": "ok"}', "schema 99"),
        (b"\xff\xfe\x00", "not UTF-8 text"),
        (b"[" * 100_000, "not valid JSON"),
    ],
)
def test_damaged_run_json(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "run.json").write_bytes(content)
    with pytest.raises(InputError, match=says):
        read_run_json(tmp_path)


def test_missing_run_json(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is this a run folder"):
        read_run_json(tmp_path)


def test_json_is_strict(tmp_path: Path) -> None:
    import numpy as np

    write_json(tmp_path / "x.json", {"a": float("nan"), "b": [np.float32(1.5), np.inf], "c": np.arange(2), "d": (1,)})
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": None, "b": [1.5, None], "c": [0, 1], "d": [1]}


def test_frames_csv_has_the_columns_of_all_rows(tmp_path: Path) -> None:
    write_frames(tmp_path / "f.csv", [{"index": 0, "time": 0.5}, {"index": 1, "time": None, "loss": 2}])
    assert (tmp_path / "f.csv").read_text().split() == ["index,time,loss", "0,0.5,", "1,,2"]
    write_frames(tmp_path / "f.csv", [])
    assert (tmp_path / "f.csv").read_text().strip() == ""
