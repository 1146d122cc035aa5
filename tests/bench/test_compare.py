"""The regression gate: rules, noise, new failures, exit codes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from panobench.bench.records.compare import Rule, compare
from panobench.bench.records.record import RunRecord, write_record
from panobench.cli.main import run as panobench
from panobench.errors import InputError, PanobenchError


def make(
    sequence: str, ate: float | None, *, seed: int = 0, status: str = "ok", method: str = "m", **more: Any
) -> RunRecord:
    return RunRecord.from_dict(_document(sequence, ate, seed, status, method, more))


def _document(
    sequence: str, ate: float | None, seed: int, status: str, method: str, more: dict[str, Any]
) -> dict[str, Any]:
    return {
        "schema": 1,
        "status": status,
        "spec": {"method": method, "dataset": "rooms", "sequence": sequence, "seed": seed, "camera": "erp"},
        "metrics": {"ate_rmse_m": ate, "pano_psnr_db": more.get("psnr", 30.0), "tracked": 1.0},
        "timing": {"fps": more.get("fps", 5.0)},
    }


def store(path: Path, runs: list[RunRecord]) -> Path:
    for k, record in enumerate(runs):
        folder = path / "runs" / f"r{k}"
        folder.mkdir(parents=True)
        write_record(folder, record)
    return path


BASE = [make(s, ate, seed=k) for s in "abcd" for k, ate in enumerate([0.0100, 0.0101, 0.0099])]
WORSE = [make(s, ate, seed=k) for s in "abcd" for k, ate in enumerate([0.0120, 0.0121, 0.0119])]


@pytest.mark.parametrize(
    ("text", "key", "falls", "amount", "relative", "each"),
    [
        ("ate>5%", "ate_rmse_m", False, 0.05, True, False),
        ("any: fps < 10 %", "fps", True, 0.1, True, True),
        ("psnr<0.3", "psnr_db", True, 0.3, False, False),
        ("ate_rmse_m>1e-3", "ate_rmse_m", False, 1e-3, False, False),
        ("memory>20%", "peak_rss_bytes", False, 0.2, True, False),
    ],
)
def test_rules_parse(text: str, key: str, falls: bool, amount: float, relative: bool, each: bool) -> None:
    rule = Rule.parse(text)
    assert (rule.key, rule.falls, rule.relative, rule.each) == (key, falls, relative, each)
    assert rule.amount == pytest.approx(amount)


@pytest.mark.parametrize(
    ("text", "says"),
    [("ate", "expected NAME>AMOUNT"), ("atee>5%", "did you mean 'ate'"), ("ate>5.5.5%", "not a number"), ("", "NAME>")],
)
def test_rules_that_do_not_parse(text: str, says: str) -> None:
    with pytest.raises(PanobenchError, match=says):
        Rule.parse(text)


def test_a_clear_regression_breaks_the_rule() -> None:
    found = compare(BASE, WORSE, [Rule.parse("ate>5%"), Rule.parse("ate>30%"), Rule.parse("fps<1%")])
    assert [v.broken for v in found.verdicts] == [True, False, False]
    assert found.verdicts[0].change is not None
    assert found.verdicts[0].change.value == pytest.approx(0.2)
    assert found.regression
    assert not compare(WORSE, BASE, [Rule.parse("ate>5%")]).regression


def test_noise_does_not_break_a_rule() -> None:
    noisy = [make(s, ate, seed=k) for s in "abcd" for k, ate in enumerate([0.007, 0.0108, 0.014])]
    found = compare(
        noisy,
        [make(s, a, seed=k) for s in "abcd" for k, a in enumerate([0.0065, 0.0116, 0.0135])],
        [Rule.parse("ate>5%")],
    )
    change = found.verdicts[0].change
    assert change is not None
    assert change.value > 0.05
    assert not found.regression


def test_each_sequence_can_be_judged() -> None:
    one_worse = [*BASE[:9], *WORSE[9:]]
    assert not compare(BASE, one_worse, [Rule.parse("ate>10%")]).regression
    found = compare(BASE, one_worse, [Rule.parse("any:ate>10%")])
    assert [v.label for v in found.verdicts if v.broken] == ["m erp rooms/d"]


def test_new_failures_are_a_regression_without_any_rule() -> None:
    failing = [*BASE[:-1], make("d", None, seed=2, status="lost")]
    found = compare(BASE, failing, [])
    assert found.new_failures == ["m erp rooms/d"]
    assert found.regression
    assert not compare(failing, failing, []).regression
    assert not compare(failing, BASE, []).regression


def test_cells_of_one_side_are_told() -> None:
    found = compare(BASE[:6], BASE[3:9], [])
    assert (found.only_base, found.only_new) == (["m erp rooms/a"], ["m erp rooms/c"])
    with pytest.raises(InputError, match="no cell in common"):
        compare(BASE[:3], BASE[6:], [])


def test_two_methods_can_be_compared_on_the_same_sequences() -> None:
    other = [make(s, ate, seed=k, method="other") for s in "abcd" for k, ate in enumerate([0.0120, 0.0121, 0.0119])]
    assert compare(BASE, other, [Rule.parse("ate>5%")]).regression


def test_the_command_and_its_exit_codes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base, worse = store(tmp_path / "base", BASE), store(tmp_path / "worse", WORSE)
    assert panobench(["compare", str(base), str(base), "--fail-on", "ate>5%"]) == 0
    assert "no regression" in capsys.readouterr().out
    assert panobench(["compare", str(base), str(worse), "--fail-on", "ate>5%"]) == 1
    printed = capsys.readouterr().out
    assert "FAIL  ate>5% over all sequences: +20.00%, 95% interval +1" in printed
    assert "10.00 / 12.00" in printed
    assert panobench(["compare", str(base), str(worse), "--fail-on", "ate>5%", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["regression"] is True
    assert panobench(["compare", str(base), str(worse), "--markdown"]) == 0
    assert "| cell |" in capsys.readouterr().out
    assert panobench(["compare", str(base), str(worse), "--fail-on", "atr>5%"]) == 2
    assert panobench(["compare", str(base), str(tmp_path / "none")]) == 2
    capsys.readouterr()
    assert panobench(["compare", str(base), str(base), "--fail-on", "lpips>5%"]) == 2
    assert "'lpips>5%' judges nothing" in capsys.readouterr().err
    assert panobench(["compare", str(base), str(worse), "--fail-on", "lpips>5%", "--fail-on", "ate>5%"]) == 1
    (base / "runs" / "r0" / "run.json").write_text("{")
    assert panobench(["compare", str(base), str(worse)]) == 2
    assert "r0/run.json:1: not valid JSON" in capsys.readouterr().err


def test_a_run_that_failed_before_it_chose_a_depth_belongs_to_the_cell_it_was_meant_for() -> None:
    good = make("a", 0.01)
    good.spec.other["depth"] = "bootstrap"
    crashed = make("a", None, status="crashed")
    crashed.spec.other["depth"] = None
    found = compare([good], [crashed], [])
    assert found.regression
    assert found.new_failures == ["m erp bootstrap rooms/a"]
    assert found.only_new == []


def test_runs_of_other_options_are_other_cells_and_old_runs_have_the_defaults() -> None:
    wide, narrow, old = make("a", 0.01), make("a", 0.02), make("a", 0.03)
    wide.spec.other["width"] = 1024
    narrow.spec.other["width"] = 512
    with pytest.raises(InputError, match="no cell in common"):
        compare([wide], [narrow], [])
    assert len(compare([old], [narrow], []).cells) == 1, "it was stored before there was such an option"
