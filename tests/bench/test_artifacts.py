"""What a run reads besides code and data counts by content: networks, weights, programs, files that options name."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from panobench.bench.run.request import RunRequest
from panobench.bench.suite.cells import Cell, Planned, Planner
from panobench.errors import UsageError
from panobench.types import RunStatus

pytestmark = pytest.mark.usefixtures("fake_plugin")

DESCRIPTION = "width: 32\nheight: 16\n"


def plan(method: str = "fake-still", **options: Any) -> Planned:
    values: dict[str, Any] = {"dataset": "tiny", "sequence": "blind", "width": 64, "max_frames": 4, **options}
    return Planner().plan(Cell(RunRequest(method=method, **values)))


@pytest.fixture
def network(tmp_path: Path) -> Path:
    pytest.importorskip("onnxruntime")
    import panobench.depth.network

    path = tmp_path / "net.onnx"
    shutil.copy(Path(panobench.depth.network.__file__).parent / "weights" / "rooms-net.onnx", path)
    path.with_suffix(".yaml").write_text(DESCRIPTION)
    return path


def test_a_network_trained_again_under_its_name_gives_new_cells(network: Path) -> None:
    first = plan(depth=f"network:{network}")
    assert first.status is None
    assert plan(depth=f"network:{network}").key == first.key
    with network.open("ab") as file:
        file.write(b"\x7a\x00")  # a field that nobody reads: another network as far as anybody can tell
    second = plan(depth=f"network:{network}")
    assert second.status is None
    assert second.key != first.key
    network.with_suffix(".yaml").write_text(DESCRIPTION + "colour: bgr\n")
    third = plan(depth=f"network:{network}")
    assert third.key not in (first.key, second.key)
    assert plan().key == plan().key != first.key


def test_a_network_that_is_not_there_is_a_row_and_an_unknown_estimator_a_mistake(tmp_path: Path) -> None:
    missing = plan(depth=f"network:{tmp_path / 'no.onnx'}")
    assert missing.status is RunStatus.UNAVAILABLE
    assert "no such network" in missing.message
    with pytest.raises(UsageError, match="bootstap"):
        plan(depth="bootstap")


def test_files_that_options_name_count_by_content(tmp_path: Path) -> None:
    poses = tmp_path / "poses.tum"
    poses.write_text("0 0 0 0 0 0 0 1\n")
    settings = {"name": str(poses)}
    first = plan("fake-options", settings=settings)
    assert plan("fake-options", settings=settings).key == first.key
    poses.write_text("0 1 0 0 0 0 0 1\n")
    assert plan("fake-options", settings=settings).key != first.key
    for odd in ("/" + "x" * 5000, "/a\0b", "~nobody-at-all/x", str(tmp_path)):
        assert plan("fake-options", settings={"name": odd}).status is None


def test_a_program_compiled_again_counts(tmp_path: Path) -> None:
    program = tmp_path / "slam"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    first = plan("fake-program", settings={"command": str(program)})
    program.write_text("#!/bin/sh\nexit 0\n")
    assert plan("fake-program", settings={"command": str(program)}).key != first.key


def test_lpips_weights_count_once_they_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    without = plan().key
    (tmp_path / "alex.pth").write_bytes(b"a")
    (tmp_path / "alexnet-owt-x.pth").write_bytes(b"b")
    monkeypatch.setenv("PANOBENCH_LPIPS", str(tmp_path))
    first = plan().key
    (tmp_path / "alex.pth").write_bytes(b"c")
    keys = {without, first, plan().key}
    (tmp_path / "alex.pth").unlink()  # a wrong folder leaves a note in the run, and does not end it
    assert plan().status is None
    assert len({*keys, plan().key}) == 4


@pytest.mark.parametrize(
    ("answer", "status", "says"),
    [
        (lambda config: [__file__], None, ""),
        (lambda config: ["/no/such/file"], RunStatus.UNAVAILABLE, "No such file"),
        (lambda config: 1 / 0, RunStatus.UNAVAILABLE, "ZeroDivisionError"),
    ],
)
def test_a_spec_names_its_files(answer: Any, status: Any, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    import fake_plugin

    from panobench.plugins import registry
    from panobench.specs import MethodSpec

    before = plan().key
    monkeypatch.setattr(fake_plugin, "files", answer, raising=False)
    spec = registry().get(MethodSpec, "fake-still")
    object.__setattr__(spec, "files", "fake_plugin:files")
    found = plan()
    assert found.status is status
    assert says in found.message
    assert found.key != before
