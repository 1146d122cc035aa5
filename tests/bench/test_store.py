"""The store: damaged results are set aside, replaced ones kept, locks hold, a full disk harms nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from panobench.bench.records.runfolder import read_run_json, write_json
from panobench.bench.run.request import RunRequest
from panobench.bench.suite.cells import Cell, Planned
from panobench.bench.suite.store import Store
from panobench.errors import InputError, OutputError

CELL = Cell(RunRequest(method="m", dataset="tiny", sequence="a/../b"))


def put(store: Store, cell: Cell = CELL, key: str = "k", **values: Any) -> Path:
    with store.lock(cell) as mine, store.workplace(cell) as place:
        assert mine
        (place / "run").mkdir()
        about = {"cell": {"identity": cell.identity, "key": key}, **values}
        write_json(place / "run" / "run.json", {"schema": 1, "status": "ok", **about})
        return store.put(Planned(cell, key), place / "run").folder


def test_results_are_found_again(tmp_path: Path) -> None:
    store = Store(tmp_path / "s")
    assert store.check(CELL) == (None, None)
    folder = put(store)
    assert folder.parent == tmp_path / "s" / "runs"  # whatever the names in the cell hold
    found = store.find(CELL)
    assert found is not None
    assert (found.key, found.status) == ("k", "ok")
    assert [s.folder for s in store.runs()[0]] == [folder]
    assert list((tmp_path / "s" / ".work").iterdir()) == []


def test_replaced_results_are_kept_aside_but_not_for_ever(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for number in range(6):
        put(store, n=number)
    assert len(list((tmp_path / "runs").iterdir())) == 1
    assert read_run_json(store.folder(CELL))["n"] == 5
    kept = sorted(read_run_json(p)["n"] for p in (tmp_path / "_superseded").iterdir())
    assert kept == [2, 3, 4]


@pytest.mark.parametrize(
    "content", [b"", b'{"schema": 1, "status"', b'{"schema": 1, "status": "ok", "cell": {"identity": "another"}}', None]
)
def test_damaged_results_go_to_the_quarantine(tmp_path: Path, content: bytes | None) -> None:
    store = Store(tmp_path)
    folder = put(store)
    (folder / "trajectory.tum").write_text("precious")
    if content is None:
        (folder / "run.json").unlink()
    else:
        (folder / "run.json").write_bytes(content)
    stored, damaged = store.check(CELL)
    assert stored is None
    assert damaged is not None
    assert "run.json" in damaged.reason
    assert (damaged.folder / "trajectory.tum").read_text() == "precious"
    assert [q.reason for q in store.quarantined()] == [damaged.reason]
    assert store.check(CELL) == (None, None)
    put(store)
    assert store.find(CELL) is not None


def test_a_lock_is_held_across_processes_and_freed_by_death(tmp_path: Path) -> None:
    store = Store(tmp_path)
    code = (
        "import sys, time, json; from pathlib import Path\n"
        "from panobench.bench.suite.store import Store; from panobench.bench.suite.cells import Cell\n"
        "with Store(Path(sys.argv[1])).lock(Cell.from_dict(json.loads(sys.argv[2]))) as mine:\n"
        "    print(mine, flush=True); time.sleep(300)"
    )
    import json

    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path), json.dumps(CELL.to_dict())], stdout=subprocess.PIPE, text=True
    )
    assert holder.stdout is not None
    assert holder.stdout.readline() == "True\n"
    with store.lock(CELL) as mine:
        assert not mine
    holder.kill()
    holder.communicate()
    with store.lock(CELL) as mine:
        assert mine


def test_leavings_in_the_workplace_are_swept(tmp_path: Path) -> None:
    store = Store(tmp_path)
    left = tmp_path / ".work" / CELL.slug / "attempt-1"
    left.mkdir(parents=True)
    (left / "half").write_text("x")
    with store.workplace(CELL) as place:
        assert list(place.iterdir()) == []


def test_something_else_is_not_a_store(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="not a suite's store"):
        Store(tmp_path).require()
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"), Store(tmp_path / "file").lock(CELL):
        pass
