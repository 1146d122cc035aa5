"""The wheel holds all that the package reads and runs without a checkout; recipes name what it needs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
import yaml

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    builder = pytest.importorskip("hatchling.builders.wheel").WheelBuilder(str(ROOT))
    return Path(next(builder.build(directory=str(tmp_path_factory.mktemp("wheel")), versions=["standard"])))


def test_the_wheel_holds_all_of_the_package_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    expected = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "panobench").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {name for name in names if name.startswith("panobench/")} == expected
    assert {"panobench/viewer/walk/walk.html", "panobench/report/templates/report.html"} <= names
    assert all(name.startswith(("panobench/", "panobench-")) for name in names)
    assert any(name.endswith("licenses/LICENSE") for name in names)


def test_it_runs_without_the_checkout(wheel: Path, tmp_path: Path) -> None:
    target = tmp_path / "site"
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    code = (
        "import sys, panobench; from panobench.cli.main import main; print(panobench.__file__, file=sys.stderr);"
        "sys.argv[1:] = ['list', 'methods']; main()"
    )
    environment = {**os.environ, "PYTHONPATH": str(target)}
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert str(target) in done.stderr
    assert "panogs" in done.stdout


def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_conda_recipe_names_what_the_package_needs() -> None:
    """With conda-forge's names, and the same oldest versions."""
    other = {"torch": "pytorch", "opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
    recipe = (ROOT / "packaging" / "conda" / "meta.yaml").read_text()
    needed = dict(re.findall(r"^    - ([a-z0-9-]+) >=([\d.]+)", recipe.split("  run:")[1], re.MULTILINE))
    declared = {}
    for line in project()["dependencies"]:
        name, least = re.match(r"([a-z0-9-]+)>=([\d.]+)", line).groups()
        declared[other.get(name, name)] = least
    assert needed.pop("python") == project()["requires-python"].removeprefix(">=")
    assert needed == declared


def test_the_action_and_the_hooks_are_well_formed() -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text())
    assert action["runs"]["using"] == "composite"
    for step in action["runs"]["steps"]:
        assert "uses" in step or step["shell"] == "bash"
        assert "uses" not in step or re.fullmatch(r"[\w/-]+@[0-9a-f]{40}", step["uses"]), "a tag can be moved"
        # what a workflow passes in never becomes part of a script
        assert "${{" not in step.get("run", "")
    hooks = {hook["id"] for hook in yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())}
    assert hooks == {"panobench-suite", "panobench-plugin"}
    assert all(name in (ROOT / "docs" / "install.md").read_text() for name in hooks)


def test_the_image_is_built_from_what_its_context_holds() -> None:
    kept = re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text(), re.MULTILINE)
    copied = re.findall(r"^COPY (?!--from)(.+) \S+$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    assert {name for line in copied for name in line.split()} == set(kept)
    assert all((ROOT / name).exists() for name in kept)
