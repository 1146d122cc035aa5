"""A new run option is a field of RunRequest, and seen everywhere: what forgets one gives wrong results in silence."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from panobench.bench.run.request import RunRequest, run_option, run_options
from panobench.errors import UsageError


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What panobench makes of one more option, ``shutter``; see one_more_option.py."""
    script = Path(__file__).with_name("one_more_option.py")
    words = [sys.executable, str(script), str(tmp_path_factory.mktemp("suite"))]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_it_makes_another_cell_with_another_label(seen: dict[str, Any]) -> None:
    assert len(set(seen["identities"])) == 2
    assert seen["labels"] == ["sparse erp rooms/room1 seed 0", "sparse erp rolling shutter rooms/room1 seed 0"]


def test_data_opened_without_it_are_not_taken_for_data_with_it(seen: dict[str, Any]) -> None:
    assert seen["inputs opened"] == 2, "of three requests, two of them alike"


def test_runs_that_differ_in_it_are_not_compared_and_old_runs_have_its_default(seen: dict[str, Any]) -> None:
    assert not seen["compared"]
    assert seen["old runs compared"] == 1


def test_a_run_can_be_made_again(seen: dict[str, Any]) -> None:
    assert seen["round trip"]
    assert "--shutter rolling" in " ".join(seen["command"])


def test_suites_and_studies_take_it(seen: dict[str, Any]) -> None:
    assert seen["suite"]["shutter"] == seen["study"]["shutter"] == "rolling"
    assert seen["study cell"]["shutter"] == "global"


def test_the_command_line_has_it(seen: dict[str, Any]) -> None:
    assert seen["run --help"]["--shutter"] == "How the shutter works."
    assert seen["import --help"]["--shutter"] == "How its shutter worked."


def test_reports_tell_its_variants_apart(seen: dict[str, Any]) -> None:
    assert [v.get("shutter") for v in seen["variants"]] == [None, "rolling"]
    assert seen["variant labels"] == ["sparse", "sparse · rolling shutter"]


def test_every_option_says_what_it_is() -> None:
    assert [option.name for option in run_options()] == list(RunRequest().to_dict())
    for option in run_options():
        assert option.help.endswith(".")
        assert option.flag.startswith("--")
        assert option.label is None or option.type is bool or "{}" in option.label
    assert [o.name for o in run_options() if not o.separates] == ["root", "save_map", "check", "seed"]
    inputs = {o.name for o in run_options() if o.changes_input}
    images = {"camera", "dataset", "sequence", "root", "fov", "width", "every", "max_frames"}
    truth = {"groundtruth", "groundtruth_scale", "align_time"}
    given = {"rate", "calibration", "topic", "imu_topic", "groundtruth_topic", "layout"}
    assert inputs == {*images, *truth, *given}


@dataclass(frozen=True)
class Bounded(RunRequest):
    depth_bits: int | None = run_option(None, "Bits.", changes_input=True, label="{} bits", minimum=8)


def test_bounds_are_checked() -> None:
    assert Bounded(depth_bits=8).depth_bits == 8
    for value in (7, True, 8.5):
        with pytest.raises(UsageError, match=r"--depth-bits .*: must be a whole number of at least 8"):
            Bounded(depth_bits=value)  # type: ignore[arg-type]
