"""`panobench run` and `panobench list` as a user meets them: exit codes, one-line errors, JSON, speed of starting."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest

from panobench.bench.records.record import FramesRecord
from panobench.cli.main import run as panobench
from panobench.cli.run import tracked_text
from panobench.testing import TinySequence, erp_camera

pytestmark = pytest.mark.usefixtures("fake_plugin")


def words(*extra: str, method: str = "fake-still") -> list[str]:
    return ["run", "--method", method, "--dataset", "tiny", "--width", "128", *extra]


def test_a_run_prints_a_summary(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(words("--out", str(tmp_path / "r"), "--holdout", "4")) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith(f"ok  {tmp_path / 'r'}")
    assert "12 of 12 frames" in printed.out
    assert "ATE" in printed.out
    assert (tmp_path / "r" / "run.json").is_file()


def test_json_and_quiet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(words("--out", str(tmp_path / "r"), "--json")) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["status"] == "ok"
    assert printed.err == ""
    assert panobench(words("--out", str(tmp_path / "q"), "--quiet")) == 0
    assert capsys.readouterr() == ("", "")


def test_verbose_shows_the_log_as_it_is_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    blind = ("--sequence", "blind", "--out", str(tmp_path / "r"))
    assert panobench(words(*blind, "--verbose", "--json")) == 0
    printed = capsys.readouterr()
    assert "still started" in printed.err
    assert printed.err == (tmp_path / "r" / "log.txt").read_text()
    assert json.loads(printed.out)["status"] == "ok"
    assert panobench(words(*blind, "--verbose", "--quiet")) == 2
    assert "--quiet and --verbose exclude each other" in capsys.readouterr().err


def test_a_width_that_the_recording_does_not_have_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    sequence = TinySequence(erp_camera(128), n=8)
    (tmp_path / "images").mkdir()
    for index in range(8):
        cv2.imwrite(str(tmp_path / "images" / f"{index:03d}.png"), sequence.image(index)[..., ::-1])
    where = ["run", "--method", "fake-still", "--dataset", "images", "--root", str(tmp_path / "images"), "--json"]
    said = {}
    for width in (128, 256):
        assert panobench([*where, "--width", str(width), "--out", str(tmp_path / f"{width}")]) == 0
        said[width] = "; ".join(json.loads(capsys.readouterr().out)["remarks"])
    assert "images are enlarged 2.0 times" in said[256]
    assert "enlarged" not in said[128]


def test_set_reaches_the_method(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "r"
    options = ["--set", "features=7", "--set", "inner.steps=4,5", "--preset", "quick", "--json", "--out", str(out)]
    assert panobench(words(*options, method="fake-options")) == 0
    spec = json.loads(capsys.readouterr().out)["spec"]
    assert spec["config"]["features"] == 7
    assert spec["config"]["inner"] == {"gain": 0.1, "steps": [4, 5]}
    assert spec["settings"] == {"features": "7", "inner.steps": "4,5"}
    assert spec["preset"] == "quick"


def test_a_run_that_fails_has_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(words("--out", str(tmp_path / "r"), "--quiet", method="fake-crash")) == 1
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1
    assert "crashed: frame 3: ValueError: three is my limit" in printed.err
    assert (tmp_path / "r" / "run.json").is_file()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["runn"], "unknown command 'runn': did you mean 'run'"),
        (["run", "--metod", "x"], "--method"),
        (["run", "--every", "two"], "--every"),
        (["run", "--set", "x", "--method", "fake-still", "--dataset", "tiny"], "expected KEY=VALUE"),
        (["run", "--method", "fake-stil", "--dataset", "tiny"], "did you mean 'fake-still'"),
        (["run", "--method", "fake-still", "--dataset", "tinny"], "did you mean 'tiny'"),
        (["run", "--method", "fake-still", "--dataset", "tiny", "--sequence", "broken"], "frame 5: the image is"),
        (["run", "--method", "fake-still", "--dataset", "tiny", "--camera", "pinhole:frnt"], "did you mean 'front'"),
        (["run", "--method", "fake-still", "--dataset", "tiny", "--fov", "wide"], "field of view"),
        (["run", "--method", "fake-still", "--dataset", "tiny", "--holdout", "1"], "--holdout 1"),
        (["list", "metods"], "did you mean 'method'"),
        (["list", "method", "fake-stil"], "did you mean 'fake-still'"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert panobench(arguments) == 2
    printed = capsys.readouterr()
    assert says in printed.err
    assert printed.err.startswith("panobench: ")
    assert printed.err.count("\n") == 1
    assert printed.out == ""
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []


def test_a_bug_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    import panobench.cli.list as module

    def broken() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(module, "registry", broken)
    with pytest.raises(ZeroDivisionError):
        panobench(["list"])


def test_ctrl_c_keeps_what_was_tracked(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "panobench.cli.main", *words("--out", str(tmp_path / "r"), method="fake-slow")]
    process = subprocess.Popen(
        command,
        env={**os.environ, "FAKE_SLEEP": "1.5", "FAKE_PROGRESS": str(tmp_path / "frame")},
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    deadline = time.monotonic() + 300
    while not (tmp_path / "frame").exists() and process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=300)
    (tmp_path / "frame").unlink()
    assert process.returncode == 130, err
    document = json.loads((tmp_path / "r" / "run.json").read_text())
    assert document["status"] == "interrupted"
    assert 1 <= document["frames"]["given"] < 12
    assert document["frames"]["tracked"] == document["frames"]["given"]
    assert [p.name for p in tmp_path.iterdir()] == ["r"]


@pytest.mark.parametrize("arguments", [["--help"], ["list"], ["--version"]])
def test_starting_does_not_import_heavy_modules(arguments: list[str]) -> None:
    code = (
        "import sys; from panobench.cli.main import run; run(sys.argv[1:]);"
        "print([m for m in ('torch', 'numba', 'numpy', 'cv2', 'scipy', 'evo', 'plotly') if m in sys.modules])"
    )
    # without the test plugin: a plugin may import what it likes
    env = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, env=env)
    assert done.returncode == 0, done.stderr
    assert done.stdout.rstrip().endswith("[]")


@pytest.mark.parametrize("arguments", [["--help"], ["list"]])
def test_starting_takes_under_half_a_second_of_processor_time(arguments: list[str]) -> None:
    """Not of wall-clock time, which a busy machine stretches. The least of three: the first may compile modules."""
    import panobench as package

    env = {**os.environ, "PYTHONPATH": str(Path(package.__file__).parents[1])}  # without the test plugin
    used = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-m", "panobench.cli.main", *arguments], env=env, check=True, capture_output=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        used.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(used) < 0.5


def test_list_shows_origin_and_whether_it_can_run(capsys: pytest.CaptureFixture[str]) -> None:
    assert panobench(["list", "--json"]) == 0
    listing = json.loads(capsys.readouterr().out)
    methods = {m["name"]: m for m in listing["method"]}
    assert methods["fake-still"]["origin"] == "panobench-fake 1.5"
    assert methods["fake-still"]["unavailable"] is None
    assert "no_such_package" in methods["fake-absent"]["unavailable"]
    assert {c["name"]: c["origin"] for c in listing["camera"]}["erp"] == "built-in"
    assert listing["failed_plugins"] == {}
    assert panobench(["list", "methods"]) == 0
    printed = " ".join(capsys.readouterr().out.split())  # whatever the terminal's width is
    assert "[panobench-fake 1.5]" in printed
    assert "cannot run here: needs the Python package(s) no_such_package" in printed
    assert panobench(["list", "method", "fake-options", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["presets"] == {"quick": {"features": 10, "inner": {"gain": 0.1}}}


def test_a_run_that_ended_at_once_does_not_count_to_zero() -> None:
    assert tracked_text(FramesRecord(given=0, planned=40)) == "none of 40 planned: it ended before the first was done"
    assert tracked_text(FramesRecord(given=9, planned=40, tracked=8)) == "8 of 9 frames, 40 planned"
    assert tracked_text(FramesRecord(given=40, planned=40, tracked=40)) == "40 of 40 frames"
