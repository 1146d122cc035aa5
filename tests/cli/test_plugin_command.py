"""`panobench plugin new` and `panobench plugin check`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from panobench.cli.plugin import app
from panobench.errors import PanobenchError
from panobench.testing.scaffold import KINDS

runner = CliRunner()


def run_tests(folder: Path, *arguments: str, **variables: str) -> str:
    """The output of pytest in ``folder``; fails when a test there does."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1", **variables},
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_a_new_package_passes_its_own_tests_at_once(tmp_path: Path) -> None:
    done = runner.invoke(app, ["new", "my-idea", "--in", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "2 passed" in run_tests(tmp_path / "panobench-my-idea")


def test_so_do_those_of_all_other_kinds(tmp_path: Path) -> None:
    others = [kind for kind in KINDS if kind != "method"]
    for kind in others:
        done = runner.invoke(app, ["new", f"my-{kind}x", "--kind", kind, "--in", str(tmp_path)])
        assert done.exit_code == 0, done.output
    folders = [tmp_path / f"panobench-my-{kind}x" for kind in others]
    sources = os.pathsep.join(str(folder / "src") for folder in folders)
    assert "8 passed" in run_tests(tmp_path, *[str(f / "tests") for f in folders], PYTHONPATH=sources)


@pytest.mark.parametrize("name", ["Has Space", "../escape", "", "ünder", "9lives", "a--b"])
def test_a_bad_name_is_refused(name: str, tmp_path: Path) -> None:
    done = runner.invoke(app, ["new", name, "--in", str(tmp_path)])
    assert isinstance(done.exception, PanobenchError)
    assert not list(tmp_path.iterdir())


def test_a_name_that_is_taken_is_refused(tmp_path: Path) -> None:
    done = runner.invoke(app, ["new", "erp", "--kind", "camera", "--in", str(tmp_path)])
    assert "there is a camera 'erp' already" in str(done.exception)


def test_an_unknown_kind_names_the_nearest(tmp_path: Path) -> None:
    done = runner.invoke(app, ["new", "x", "--kind", "metod", "--in", str(tmp_path)])
    assert "did you mean 'method'" in str(done.exception)


def test_an_existing_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "panobench-x").mkdir()
    done = runner.invoke(app, ["new", "x", "--in", str(tmp_path)])
    assert "exists already" in str(done.exception)
    assert not list((tmp_path / "panobench-x").iterdir())


def test_check_passes_a_new_method_and_says_so_in_json(tmp_path: Path) -> None:
    runner.invoke(app, ["new", "checked", "--in", str(tmp_path)])
    done = runner.invoke(app, ["check", str(tmp_path / "panobench-checked"), "--json"])
    assert done.exit_code == 0, done.output
    answer = json.loads(done.output)
    assert answer["failed"] == 0
    assert {c["name"] for c in answer["checks"]} >= {"determinism", "no ground truth", "timing", "black frames"}


def test_check_fails_a_method_that_breaks_the_contract(tmp_path: Path) -> None:
    runner.invoke(app, ["new", "broken", "--in", str(tmp_path)])
    path = tmp_path / "panobench-broken" / "src" / "panobench_broken" / "method.py"
    path.write_text(
        path.read_text().replace("return None\n        if self._previous", "pass\n        if self._previous")
    )
    path.write_text(path.read_text().replace("self._poses.append(pose)", "self._poses.append(2 * pose)"))
    done = runner.invoke(app, ["check", str(tmp_path / "panobench-broken")])
    assert done.exit_code == 1
    assert "fail  answer: a pose's 3x3 part is no rotation" in done.output


def test_check_names_packages_that_exist() -> None:
    done = runner.invoke(app, ["check", "no-such-package"])
    assert "unknown plugin package" in str(done.exception)


def test_a_folder_without_an_entry_point_is_refused(tmp_path: Path) -> None:
    (tmp_path / "pyproject.toml").write_text("[project]\nname = 'x'\n")
    done = runner.invoke(app, ["check", str(tmp_path)])
    assert "has no entry point in group 'panobench'" in str(done.exception)


def test_a_plugin_that_does_not_import_is_named(tmp_path: Path) -> None:
    runner.invoke(app, ["new", "sick", "--in", str(tmp_path)])
    (tmp_path / "panobench-sick" / "src" / "panobench_sick" / "__init__.py").write_text("raise SystemExit('no')\n")
    done = runner.invoke(app, ["check", str(tmp_path / "panobench-sick")])
    assert "plugin 'sick' of panobench-sick cannot be loaded: SystemExit: no" in str(done.exception)
