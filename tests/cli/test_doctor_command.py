"""`panobench doctor`: what is missing, in words that say what to do."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from panobench import MethodSpec, OnlineMethod
from panobench.cli import doctor
from panobench.cli.main import run as panobench
from panobench.external.adapter import ExternalMethod, Job
from panobench.external.findings import Finding, missing_libraries
from panobench.methods.base import MethodContext
from panobench.plugins import Registered, registry


class Fine(OnlineMethod):
    start = track = finish = None  # type: ignore[assignment]


class Program(ExternalMethod):
    title, program, variable = "Program", "no-such-program", "PANOBENCH_DOCTORED"

    def prepare(self, sequence: Any, context: MethodContext) -> Job:
        raise NotImplementedError


def program_missing() -> str | None:
    return Program.missing()


def explode() -> None:
    raise RuntimeError("the probe is broken")


@pytest.fixture
def known(monkeypatch: pytest.MonkeyPatch) -> dict[str, Registered]:
    here = __name__
    specs = [
        MethodSpec("fine", "works", f"{here}:Fine", licence="x"),
        MethodSpec(
            "needy", "wants a package", f"{here}:Fine", requires=("no_such.module",), install="pip install needy"
        ),
        MethodSpec("outside", "wants a program", f"{here}:Program", probe=f"{here}:program_missing"),
        MethodSpec("shaky", "has a broken probe", f"{here}:Fine", probe=f"{here}:explode"),
    ]
    entries = {s.name: Registered(s, "test 1.0") for s in specs}
    monkeypatch.setitem(registry().entries, "method", entries)
    return entries


def test_a_method_that_can_run(known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["doctor", "fine"]) == 0
    assert "it can run here" in capsys.readouterr().out


def test_a_missing_package_comes_with_the_command_to_install_it(known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["doctor", "needy"]) == 1
    out = capsys.readouterr().out
    assert "MISSING Python package: no_such.module" in out
    assert "to install: pip install needy" in out


def test_a_missing_program_comes_with_the_variable_that_names_it(
    known: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert panobench(["doctor", "outside"]) == 1
    out = capsys.readouterr().out
    assert "MISSING program: 'no-such-program' is not on PATH" in out
    assert "export PANOBENCH_DOCTORED_COMMAND=" in out


def test_a_program_that_is_there_is_found(
    known: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PANOBENCH_DOCTORED_COMMAND", sys.executable)
    assert panobench(["doctor", "outside"]) == 0
    assert f"program: {sys.executable}" in capsys.readouterr().out


def test_a_wrong_place_is_explained(
    known: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PANOBENCH_DOCTORED_RUN_IN", "venv:/no/such/place")
    assert panobench(["doctor", "outside"]) == 1
    assert "/no/such/place is no virtual environment" in capsys.readouterr().out


def test_a_broken_probe_is_named_not_raised(known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["doctor", "shaky"]) == 1
    assert "its probe failed: RuntimeError: the probe is broken" in capsys.readouterr().out


def test_json_has_the_findings(known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["doctor", "needy", "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["ok"] is False
    assert answer["findings"][0]["fix"] == "pip install no_such.module"


def test_without_a_name_all_methods_are_listed(known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["doctor"]) == 0
    out = capsys.readouterr().out
    assert [line.split()[0] for line in out.splitlines()][:4] == ["fine", "needy", "outside", "shaky"]


def test_an_unknown_name_suggests_the_nearest(known: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["doctor", "fien"]) == 2
    assert "did you mean 'fine'" in capsys.readouterr().err


def test_a_plugin_that_failed_to_import_is_named(
    known: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(registry().failures, "sick", "ImportError: no module named x")
    assert panobench(["doctor", "sick"]) == 2
    assert "plugin 'sick' failed to import: ImportError: no module named x" in capsys.readouterr().err


def test_names_of_other_kinds_are_found_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor.find_entry(registry(), "erp").spec.kind == "camera"
    assert panobench(["doctor", "erp"]) == 0


def test_scripts_and_missing_files_have_no_missing_libraries(tmp_path: Path) -> None:
    (tmp_path / "script").write_text("#!/bin/sh\n")
    assert missing_libraries(tmp_path / "script") == []
    assert missing_libraries(tmp_path / "none") == []


def test_a_gpu_that_can_be_used_or_not(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from panobench.gpu import checks

    found = [Finding(True, "NVIDIA driver", "CUDA 13.0, 1 GPU")]
    monkeypatch.setattr(checks, "findings", lambda: iter(found))
    assert panobench(["doctor", "gpu"]) == 0
    assert "it can be used here" in capsys.readouterr().out
    found.append(Finding(False, "NVRTC", "is missing", "install it"))
    assert panobench(["doctor", "gpu"]) == 1
    assert "MISSING NVRTC: is missing\n          -> install it\n" in capsys.readouterr().out
    assert panobench(["doctor", "gpu", "--json"]) == 1
    assert json.loads(capsys.readouterr().out)["findings"][1]["what"] == "NVRTC"
