"""Output that cannot be written or encoded, names that are not UTF-8, and `python -m panobench`."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import pytest
from rich.console import Console

from panobench.cli.main import run as panobench
from panobench.cli.progress import ProgressBar
from panobench.testing import TinySequence


def command(*words: str, **options: Any) -> subprocess.CompletedProcess[bytes]:
    environment = {**os.environ, **options.pop("env", {})}
    return subprocess.run([sys.executable, "-m", "panobench", *words], env=environment, timeout=120, **options)


def test_python_m_panobench() -> None:
    done = command("--version", stdout=subprocess.PIPE)
    assert done.returncode == 0
    assert done.stdout.startswith(b"panobench ")


@pytest.mark.parametrize("words", [["list"], ["list", "--json"], ["--help"], ["env"]])
def test_a_full_standard_output_is_one_line(words: list[str]) -> None:
    with open("/dev/full", "w") as full:
        done = command(*words, stdout=full, stderr=subprocess.PIPE)
    assert done.returncode == 2
    assert done.stderr.decode().count("\n") == 1
    assert "standard output cannot be written (No space left on device)" in done.stderr.decode()


def test_a_full_standard_error_is_no_crash() -> None:
    with open("/dev/full", "w") as full:
        assert command("run", "--method", "nothing", stdout=subprocess.DEVNULL, stderr=full).returncode == 2


@pytest.mark.parametrize("lost", ["full", "closed", "nobody reads"])
def test_a_command_goes_on_without_standard_error(tmp_path: Path, lost: str) -> None:
    """What it says beside the result (a guessed data set, notes, warnings) is not worth losing it for."""
    folder = tmp_path / "walk"
    folder.mkdir()
    for i in range(3):
        (folder / f"{i}.png").write_bytes(cv2.imencode(".png", TinySequence(n=3).image(i))[1].tobytes())
    words = ["convert", "images", "--root", str(folder), "--to", "erp", "--width", "64", "--out", str(tmp_path / "out")]
    options: dict[str, Any] = {"stdout": subprocess.PIPE}
    if lost == "closed":
        options["preexec_fn"] = lambda: os.close(2)
    read, write = os.pipe()
    os.close(read)
    with open("/dev/full", "w") as full:
        options |= {"stderr": full} if lost == "full" else {"stderr": write} if lost == "nobody reads" else {}
        done = command(*words, **options)
    os.close(write)
    assert done.returncode == 0
    assert b"nothing says when" not in done.stdout
    assert list(tmp_path.glob("out/**/frames.csv"))


def test_a_closed_standard_output_and_a_reader_that_goes() -> None:
    assert command("list", stdout=subprocess.DEVNULL, preexec_fn=lambda: os.close(1)).returncode == 0
    read, write = os.pipe()
    os.close(read)
    done = command("list", stdout=write, stderr=subprocess.PIPE)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


@pytest.mark.parametrize("environment", [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0"}])
def test_an_output_that_has_not_all_letters(tmp_path: Path, environment: dict[str, str]) -> None:
    done = command(
        "view", str(tmp_path / "Straße°.mp4"), env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert done.returncode == 2
    assert b"no such file or folder" in done.stderr
    assert b"Traceback" not in done.stderr


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Panoramas in a folder whose name has a byte that is not UTF-8, as old archives have them; images likewise."""
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/Gr\xfcn"))
    (folder / "images").mkdir(parents=True)
    sequence = TinySequence(n=3)
    for i in range(3):
        data = cv2.imencode(".png", sequence.image(i)[..., ::-1])[1].tobytes()
        (folder / "images" / os.fsdecode(b"stra\xdfe%d.png" % i)).write_bytes(data)
    return folder


@pytest.mark.usefixtures("fake_plugin")
def test_names_that_are_not_utf8_run(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = Path(os.fsdecode(os.fsencode(tmp_path) + b"/o\xfct"))
    words = ["run", "--method", "fake-still", "--dataset", "synpano", "--root", str(scene), "--width", "128"]
    assert panobench([*words, "--out", str(out)]) in (0, 1)
    assert "udcfc" in (out / "run.json").read_text(encoding="utf-8")
    assert json.loads((out / "run.json").read_text())["provenance"]["dataset"]["root"] == str(scene)
    assert "stra\\udcdfe0.png" in (out / "frames.csv").read_text(encoding="utf-8")
    for target in ("page.html", "table.csv"):
        assert panobench(["report", str(out), "-o", str(tmp_path / target)]) == 0
        (tmp_path / target).read_text(encoding="utf-8")
    capsys.readouterr()


def test_a_missing_file_with_such_a_name_is_one_line(capfd: pytest.CaptureFixture[str]) -> None:
    assert panobench(["view", os.fsdecode(b"/nowhere/Stra\xdfe.mp4")]) == 2
    assert capfd.readouterr().err == "panobench: /nowhere/Stra\\udcdfe.mp4: no such file or folder\n"


def test_progress_moves_on_while_a_run_finishes() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=150)
    with ProgressBar("sparse on room1", console) as bar:
        bar.started(2, None)
        bar.stage("tracking")
        bar.frame(0, 0.0, None, 0.5)
        bar.stage("finishing")
        time.sleep(1.3)
    shown = console.file.getvalue()  # type: ignore[attr-defined]
    assert "2.0 frames/s" in shown
    assert "finishing" in shown
    assert "1 s" in shown.split("finishing", 1)[1]


def test_tables_are_drawn_on_terminals_alone(monkeypatch, capsys):
    from panobench.cli.table import print_table

    rows = [["[red]cell[/]", "lost", "1.5"]]
    assert not print_table(("Cell", "Status", "ATE"), rows)
    assert capsys.readouterr().out == ""
    monkeypatch.setattr("sys.stdout.isatty", lambda: True, raising=False)
    assert print_table(("Cell", "Status", "ATE"), rows, right=(2,), status=1)
    out = capsys.readouterr().out
    assert "[red]cell[/]" in out, "texts are no markup"
    assert "Status" in out
