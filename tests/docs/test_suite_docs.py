"""docs/suites.md: its suite file is one, its names and exit codes are those of the code."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

from panobench.bench.records.compare import NAMES, Rule
from panobench.bench.suite.cells import Limits
from panobench.bench.suite.file import read_suite
from panobench.types import RunStatus

TEXT = (Path(__file__).parent.parent.parent / "docs" / "suites.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", TEXT, re.DOTALL)


def test_the_suite_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "demo.yaml").write_text(blocks("yaml")[0])
    suite = read_suite(tmp_path / "demo.yaml")
    assert len(suite.cells) == 2 * 2 * 2 * 3
    assert suite.cells[-1].request.settings == {"features": 500}


def test_the_workflow_is_yaml_and_its_rules_parse() -> None:
    steps = yaml.safe_load(blocks("yaml")[1])["jobs"]["gate"]["steps"]
    rules = re.findall(r'--fail-on "([^"]+)"', TEXT)
    assert len(rules) >= 5
    assert all(Rule.parse(r).key for r in rules)
    assert sum("panobench suite run" in s.get("run", "") for s in steps) == 2


def test_the_recipe_for_clusters_compiles() -> None:
    compile(blocks("python")[0], "recipe", "exec")


def test_every_status_limit_and_name_is_explained() -> None:
    for word in [s.value for s in RunStatus] + [*NAMES, *vars(Limits())]:
        assert f"`{word}`" in TEXT, word
