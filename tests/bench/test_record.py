"""run.json through one dataclass: what is written is read again, whoever wrote it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from panobench.bench.records.fields import JsonRecord
from panobench.bench.records.record import (
    CellRecord,
    DepthRecord,
    MapRecord,
    RunRecord,
    SpecRecord,
    empty_record,
    read_record,
    replace_record,
    write_record,
)
from panobench.bench.run.request import RunRequest
from panobench.errors import InputError
from panobench.types import RunStatus

#: As panobench 0.1.0 wrote it, before there was a record.
OLD: dict[str, Any] = {
    "schema": 1,
    "status": "ok",
    "message": "",
    "origin": "measured",
    "spec": {"method": "panogs", "camera": "erp", "dataset": "rooms", "sequence": "room1", "seed": 3, "width": 256,
             "settings": {"window": 5}, "depth": "bootstrap", "config": {"window": 5},
             "camera_model": {"model": "erp"}},
    "method": {"name": "panogs", "needs": ["rgb"]},
    "protocol": "1.2",
    "metric": False,
    "metrics": {"ate_rmse_m": 0.01, "lpips": None},
    "notes": {"lpips": "n/a"},
    "timing": {"fps": 4.5, "start_s": 1.0},
    "frames": {"given": 6, "planned": 6, "tracked": 5, "held_out": 1},
    "keyframes": [0, 3],
    "depth": {"source": "bootstrap", "oracle": False, "poses_given": False, "range": [0.8, 3.9]},
    "groundtruth": True,
    "extra": {"loops": 1},
    "provenance": {"panobench": "0.1.0", "machine": {"cpu": "x", "cores": 2}, "command": "panobench run", "seed": 3},
    "map": {"file": "map.ply", "gaussians": 100, "bytes": 5000},
    "cell": {"key": "k", "identity": "i", "label": "l", "limits": {"timeout_s": 9}},
}  # fmt: skip


def test_what_is_written_is_read_again(tmp_path: Path) -> None:
    record = empty_record(RunRequest(method="sparse", width=64), RunStatus.CRASHED, "it\nbroke")
    record.cell, record.map = CellRecord("s", "k", limits={"timeout_s": 5.0}), MapRecord("map.ply", 3, 9)
    record.depth = DepthRecord("network", ok=False, range=[1.0, 2.0])
    write_record(tmp_path, record)
    assert read_record(tmp_path) == record
    assert (record.message, record.spec.option("width"), record.number("tracked")) == ("it broke", 64, 0.0)


def test_files_of_the_first_version_are_read() -> None:
    record = RunRecord.from_dict(OLD)
    assert (record.spec.method, record.spec.sequence, record.spec.seed) == ("panogs", "room1", 3)
    assert (record.number("ate_rmse_m"), record.number("fps"), record.number("lpips")) == (0.01, 4.5, None)
    assert record.frames.tracked == 5
    assert record.depth.range == [0.8, 3.9]
    assert record.cell is not None
    assert record.cell.limits == {"timeout_s": 9.0}
    assert record.provenance.machine.cpu == "x"
    assert record.spec.variants() == {
        "camera": "erp", "depth": "bootstrap", "width": "256", "every": "1", "holdout": "0", "settings": "window=5",
        "imu": "auto", "device": "auto",
    }  # fmt: skip
    assert contains(record.to_dict(), OLD), "nothing is lost by reading and writing"


def contains(new: Any, old: Any) -> bool:
    if isinstance(old, dict):
        return all(key in new and contains(new[key], value) for key, value in old.items())
    return bool(new == old)


def test_what_a_newer_version_wrote_is_kept(tmp_path: Path) -> None:
    newer = {**OLD, "from_tomorrow": {"value": 0.3}, "frames": {**OLD["frames"], "masked": 2}}
    record = RunRecord.from_dict(newer)
    replace_record(tmp_path, record)
    written = json.loads((tmp_path / "run.json").read_text())
    assert written["from_tomorrow"] == {"value": 0.3}
    assert written["frames"]["masked"] == 2
    assert [p.name for p in tmp_path.iterdir()] == ["run.json"]


def test_what_is_not_known_is_left_out_of_the_file() -> None:
    written = RunRecord(status="ok").to_dict()
    assert "cell" not in written
    assert "range" not in written["depth"]
    assert written["map"] is None, "as it always was"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.dictionaries(st.sampled_from(sorted(OLD)), JSON), st.dictionaries(st.sampled_from(sorted(OLD["spec"])), JSON))
def test_strangers_files_do_no_harm(values: dict[str, Any], spec: dict[str, Any]) -> None:
    record = RunRecord.from_dict({**OLD, **values, "spec": spec})
    record.spec.variants()
    record.number("ate_rmse_m")
    assert isinstance(record.spec.sequence, str)
    check_types(record)


def check_types(record: JsonRecord) -> None:
    for name, value in vars(record).items():
        default = getattr(type(record)(), name)
        if isinstance(default, JsonRecord):
            assert isinstance(value, type(default))
            check_types(value)
        elif default is not None:
            assert isinstance(value, type(default)), name


def test_numbers_no_one_can_reckon_with_count_as_not_measured() -> None:
    record = RunRecord.from_dict({"metrics": {"a": 1e200, "b": float("nan"), "c": "4", "d": True, "e": 2}})
    assert record.metrics == {"a": None, "b": None, "c": None, "d": None, "e": 2.0}


def test_a_spec_says_what_took_effect() -> None:
    spec = SpecRecord.of(RunRequest(method="sparse"), depth="bootstrap", config={"features": 3})
    assert (spec.option("depth"), spec.config) == ("bootstrap", {"features": 3})
    assert next(iter(spec.to_dict())) == "method"


@pytest.mark.parametrize("text", ["", "[]", '{"schema": 1}', '{"schema": 7, "status": "ok"}', '{"status": 3}'])
def test_what_is_no_run_is_named(tmp_path: Path, text: str) -> None:
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(InputError, match=r"run\.json"):
        read_record(tmp_path)
