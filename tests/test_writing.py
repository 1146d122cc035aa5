"""Disks that are full, and places that cannot be written: every command says so in one line and leaves nothing half."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench.cli.main import run as panobench
from panobench.errors import OutputError
from panobench.writing import is_disk_full, write_whole, writing

sys.path.insert(0, str(Path(__file__).parent / "datasets"))
from dataset_samples import save, synpano_scene

Capture = pytest.CaptureFixture[str]


def test_a_full_disk_is_recognised_through_other_errors() -> None:
    wrapped = ValueError("wrapped")
    wrapped.__cause__ = OSError(errno.ENOSPC, "No space left on device")
    assert is_disk_full(wrapped)
    assert not is_disk_full(OSError(errno.EACCES, "no"))
    assert not is_disk_full(None)
    with pytest.raises(OutputError, match="the disk is full; free some space"), writing(Path("s")):
        raise wrapped.__cause__
    with pytest.raises(OutputError, match=r"s: cannot be written \(no\); try x"), writing(Path("s"), denied="try x"):
        raise OSError(errno.EACCES, "no")


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = tmp_path / "new" / "page.html"
    write_whole(target, "old")
    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OutputError, match="the disk is full"):
        write_whole(target, b"new")
    assert [p.read_text() for p in target.parent.iterdir()] == ["old"]


def test_devices_are_written_to_and_links_stay(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_whole(tmp_path / "pipe", "page")
    assert os.read(reader, 10) == b"page"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
    with pytest.raises(OutputError, match="/dev/full: the disk is full"):
        write_whole(Path("/dev/full"), "page")
    with pytest.raises(OutputError, match="cannot be written"):
        write_whole(tmp_path, "page")
    (tmp_path / "link").symlink_to("page")
    write_whole(tmp_path / "link", "1")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "page").read_text() == "1"


def fail(*_: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def one_line(capsys: Capture, says: str) -> None:
    printed = capsys.readouterr()
    assert printed.err.startswith("panobench: ")
    assert says in printed.err
    assert printed.err.count("\n") == 1, printed.err
    assert printed.out == ""


@pytest.fixture
def run_command(fake_plugin: Path) -> list[str]:
    return ["run", "--method", "fake-still", "--dataset", "tiny", "--sequence", "blind", "--width", "128", "--quiet"]


@pytest.mark.parametrize("pages", [0, 1, 3, 6])  # of about 10 that the run takes
def test_a_run_on_a_full_disk(run_command: list[str], small_disk: Any, capsys: Capture, pages: int) -> None:
    small_disk.leave(pages)
    assert panobench([*run_command, "--out", str(small_disk.path / "r")]) == 2
    one_line(capsys, f"{small_disk.path / 'r'}: the disk is full; free some space and run the same command again")
    assert os.listdir(small_disk.path) == ["filler"]


def test_a_run_with_just_enough_room(run_command: list[str], small_disk: Any) -> None:
    small_disk.leave(30)
    assert panobench([*run_command, "--out", str(small_disk.path / "r")]) == 0


def test_a_method_that_meets_the_full_disk_is_not_blamed(
    run_command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    import fake_plugin

    monkeypatch.setattr(fake_plugin.Still, "track", fail)
    assert panobench([*run_command, "--out", str(tmp_path / "r")]) == 2
    one_line(capsys, "the disk is full")
    assert list(tmp_path.glob("*r*")) == []


@pytest.mark.parametrize("place", ["file/r", "n" * 300])
def test_a_run_that_cannot_be_stored(run_command: list[str], tmp_path: Path, capsys: Capture, place: str) -> None:
    (tmp_path / "file").write_text("")
    assert panobench([*run_command, "--out", str(tmp_path / place)]) == 2
    one_line(capsys, "cannot be written (")
    assert os.listdir(tmp_path) == ["file"]


def test_rescored_runs_on_a_full_disk(run_command: list[str], tmp_path: Path, small_disk: Any, capsys: Capture) -> None:
    assert panobench([*run_command, "--out", str(tmp_path / "r")]) == 0
    small_disk.leave(2)
    assert panobench(["score", str(tmp_path / "r"), "--out", str(small_disk.path / "new")]) == 2
    one_line(capsys, "the disk is full")
    assert [str(p) for p in small_disk.path.rglob("*") if p.is_file()] == [str(small_disk.path / "filler")]


Command = Callable[[Path, Path], list[str]]
_SYNTH = ["synth", "palvio", "--dataset", "synpano", "--source-width", "128", "--frames", "4", "--width", "160", "-q"]
COMMANDS: dict[str, Command] = {
    "view": lambda scene, out: ["view", str(scene), "--frames", "1", "--out", str(out)],
    "synth": lambda scene, out: [*_SYNTH, "--root", str(scene), "--out", str(out / "ID01.bag")],
    "plugin": lambda scene, out: ["plugin", "new", "mine", "--in", str(out)],
    "report": lambda scene, out: ["report", str(scene), "-o", str(out / "report.html")],
}


@pytest.mark.parametrize("command", COMMANDS)
def test_other_commands_on_a_full_disk(command: str, tmp_path: Path, small_disk: Any, capsys: Capture) -> None:
    scene = tmp_path / "room"
    if command == "report":
        sys.path.insert(0, str(Path(__file__).parent / "report"))
        from fake_runs import write_run

        write_run(scene)
    else:
        synpano_scene(scene, 5)
        for i in range(5):
            save(scene / f"images/{i:06d}.png", np.full((64, 128, 3), 50 * i, np.uint8))
    small_disk.leave(1)
    assert panobench(COMMANDS[command](scene, small_disk.path)) == 2
    one_line(capsys, "the disk is full")
    assert os.listdir(small_disk.path) == ["filler"]
