"""The shared adapter against a stand-in program that works, is missing, crashes, hangs, lies or strays."""

from __future__ import annotations

import os
import stat
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest

from panobench.datasets.base import FrameSequence
from panobench.errors import MethodError, MethodTimeoutError, UnavailableError, UsageError
from panobench.external import confine
from panobench.external.adapter import ExternalConfig, ExternalMethod, Job
from panobench.external.launch import parse_place
from panobench.external.process import clean_environment, log_tail, run_logged
from panobench.methods.base import MethodContext
from panobench.testing import TinySequence, run_method
from panobench.types import RunStatus

LANDLOCK = confine.landlock_version() > 0
ROWS = "".join(f"{0.1 * i:.6f} {i} 0 0 0 0 0 1\n" for i in range(4))


class StandIn(ExternalMethod):
    """Gives the program the work folder and reads ``out.txt``."""

    title, program, variable = "StandIn", "no-such-stand-in", "PANOBENCH_STANDIN"

    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        return Job([str(context.work)], context.work / "out.txt", statuses={3: RunStatus.LOST})


def gone(pids: list[int]) -> bool:
    """No such process but perhaps a zombie; a killed one may take the kernel a moment."""

    def alive(pid: int) -> bool:
        try:
            return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
        except psutil.NoSuchProcess:
            return False

    end = time.monotonic() + 30
    while any(map(alive, pids)) and time.monotonic() < end:
        time.sleep(0.02)
    return not any(map(alive, pids))


Script = Callable[[str], Path]


@pytest.fixture
def script(tmp_path: Path) -> Script:
    """Writes an executable Python program whose first argument is the work folder ``work``."""

    def write(body: str) -> Path:
        path = tmp_path / "program"
        path.write_text(f"#!{sys.executable} -IS\nimport os, sys, time\nwork = sys.argv[1]\n{body}\n")
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return path

    return write


def run(program: Path, tmp_path: Path, **options: object) -> object:
    work = tmp_path / "run" / "work"
    work.mkdir(parents=True)
    config = ExternalConfig(command=str(program), **options)  # type: ignore[arg-type]
    return run_method(StandIn(config), TinySequence(n=8), work=work).estimate


def good(rows: str = ROWS) -> str:
    return f"open(work + '/out.txt', 'w').write({rows!r})"


def test_a_good_program_is_read(script: Script, tmp_path: Path) -> None:
    estimate = run(script(good()), tmp_path)
    assert np.allclose(estimate.trajectory.times, [0, 0.1, 0.2, 0.3])
    assert np.allclose(estimate.trajectory.positions[:, 0], range(4))


def test_its_program_and_time_are_in_the_estimate(script: Script, tmp_path: Path) -> None:
    estimate = run(script(good()), tmp_path)
    assert estimate.extra["place"] == "local"
    assert estimate.extra["program_seconds"] >= 0


def test_a_missing_program_says_how_to_name_it(tmp_path: Path) -> None:
    with pytest.raises(
        UnavailableError, match=r"'no-such-stand-in' is not on PATH; name it in PANOBENCH_STANDIN_COMMAND"
    ):
        run_method(StandIn(), TinySequence(n=2), work=tmp_path)
    assert StandIn.missing() is not None


def test_the_environment_variable_names_the_program(
    script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PANOBENCH_STANDIN_COMMAND", str(script(good())))
    assert StandIn.missing() is None
    assert len(run_method(StandIn(), TinySequence(n=8)).estimate.trajectory) == 4


def test_a_crash_shows_the_end_of_the_log(script: Script, tmp_path: Path) -> None:
    body = "print('loading'); print('no vocabulary', file=sys.stderr); sys.stdout.flush(); sys.exit(7)"
    with pytest.raises(MethodError, match=r"StandIn ended with exit code 7; the log ends: .*no vocabulary") as caught:
        run(script(body), tmp_path)
    assert caught.value.run_status == "crashed"
    assert "\n" not in str(caught.value)


def test_a_signal_is_named(script: Script, tmp_path: Path) -> None:
    with pytest.raises(MethodError, match="killed by signal 11"):
        run(script("os.kill(os.getpid(), 11)"), tmp_path)


def test_a_kill_from_outside_is_taken_as_out_of_memory(script: Script, tmp_path: Path) -> None:
    with pytest.raises(MethodError) as caught:
        run(script("os.kill(os.getpid(), 9)"), tmp_path)
    assert caught.value.run_status == "out-of-memory"


def test_exit_codes_are_mapped(script: Script, tmp_path: Path) -> None:
    with pytest.raises(MethodError) as caught:
        run(script("sys.exit(3)"), tmp_path)
    assert caught.value.run_status == "lost"


def test_a_hanging_program_and_its_children_are_ended(
    script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = (
        "import subprocess\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(500)'])\n"
        "print('waiting for a camera', flush=True)\n"
        "open(work + '/pids', 'w').write(f'{os.getpid()} {child.pid}')\ntime.sleep(500)"
    )
    place, clock = tmp_path / "run" / "work" / "pids", time.monotonic

    def later() -> float:
        """The time limit is over as soon as both processes are there, however slow the machine."""
        ready = place.exists() and len(place.read_text().split()) == 2
        return clock() + (1000.0 if ready else 0.0)

    monkeypatch.setattr("panobench.external.process.time.monotonic", later)
    begin = clock()
    with pytest.raises(MethodTimeoutError, match=r"ended after 900 s; the log ends: waiting for a camera") as caught:
        run(script(body), tmp_path, timeout_s=900)
    monkeypatch.undo()
    assert clock() - begin < 400, "it waited for the program instead of ending it"
    assert caught.value.run_status == "timeout"
    pids = [int(p) for p in place.read_text().split()]
    assert gone(pids)


def test_one_that_ignores_the_request_to_end_is_killed(script: Script, tmp_path: Path) -> None:
    body = "import signal\nsignal.signal(signal.SIGTERM, signal.SIG_IGN)\ntime.sleep(60)"
    with pytest.raises(MethodTimeoutError):
        run(script(body), tmp_path, timeout_s=0.5)


def test_ctrl_c_ends_the_program(script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = script("open(work + '/pid', 'w').write(str(os.getpid()))\ntime.sleep(60)")
    work = tmp_path / "w"
    work.mkdir()

    def interrupt(_: float) -> None:
        if (work / "pid").exists() and (work / "pid").read_text():
            raise KeyboardInterrupt

    monkeypatch.setattr("panobench.external.process.time.sleep", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run_logged([str(program), str(work)], cwd=work, environment={}, log=work / "log", timeout_s=30)
    monkeypatch.undo()
    assert gone([int((work / "pid").read_text())])


def test_a_flood_of_output_is_stopped(script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panobench.external.process.MAX_LOG_BYTES", 10000)
    with pytest.raises(MethodError, match="filled its log"):
        run(script("while True: print('spam' * 1000, flush=True); time.sleep(0.01)"), tmp_path)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (ROWS + "0.4 1 2", r"out\.txt:5: the row has 3 values"),
        ("0.0 0 0 0 0 0 0 one\n", r"out\.txt:1: 'one' is not a number"),
        ("0.0 nan 0 0 0 0 0 1\n", r"not a finite number"),
        ("0.0 0 0 0 9 9 9 9\n", r"the quaternion has norm"),
        ("0.1 0 0 0 0 0 0 1\n0.0 0 0 0 0 0 0 1\n", r"not later than the one before"),
        ("17.25 0 0 0 0 0 0 1\n", r"time 17\.25 s belongs to none of the 8 frames"),
        ("0.10 0 0 0 0 0 0 1\n0.101 0 0 0 0 0 0 1\n", r"two poses belong to the same frame"),
        ("\x00\x01\x02 garbage \xff\n", r"out\.txt:1"),
    ],
)
def test_a_partial_or_malformed_trajectory_is_an_error_with_the_log(
    rows: str, words: str, script: Script, tmp_path: Path
) -> None:
    with pytest.raises(MethodError, match=words) as caught:
        run(script(f"print('saved trajectory', flush=True)\n{good(rows)}"), tmp_path)
    assert "the log ends: saved trajectory" in str(caught.value)
    assert caught.value.run_status == "crashed"


def test_no_trajectory_is_an_error(script: Script, tmp_path: Path) -> None:
    with pytest.raises(MethodError, match="the program wrote no such file"):
        run(script("pass"), tmp_path)


def test_an_empty_trajectory_means_nothing_was_tracked(script: Script, tmp_path: Path) -> None:
    assert len(run(script(good("# time x y z\n")), tmp_path).trajectory) == 0


@pytest.mark.skipif(not LANDLOCK, reason="the kernel has no Landlock")
@pytest.mark.parametrize("where", ["/../escape.txt", "/../../escape.txt"])
def test_writing_outside_the_work_folder_is_refused(where: str, script: Script, tmp_path: Path) -> None:
    with pytest.raises(MethodError, match=r"it may write to its work folder only.*Permission"):
        run(script(f"open(work + {where!r}, 'w').write('x')"), tmp_path)
    assert not list(tmp_path.rglob("escape.txt"))


@pytest.mark.skipif(not LANDLOCK, reason="the kernel has no Landlock")
def test_neither_can_it_remove_or_change_what_is_there(script: Script, tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("data")
    body = (
        "changes = (os.remove, lambda p: os.truncate(p, 0), lambda p: open(p, 'a'))\nfor f in changes:\n"
        f"    try:\n        f({str(precious)!r})\n    except OSError:\n        pass\n"
    )
    run(script(body + good()), tmp_path)
    assert precious.read_text() == "data"


def test_without_kernel_support_strays_are_found(
    script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(confine, "landlock_version", lambda: 0)
    body = f"open(work + '/../escape.txt', 'w').write('x')\n{good()}"
    with pytest.raises(MethodError, match=r"wrote outside its work folder: .*escape\.txt"):
        run(script(body), tmp_path)


def test_without_kernel_support_a_tidy_program_passes(
    script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(confine, "landlock_version", lambda: 0)
    assert len(run(script(good()), tmp_path).trajectory) == 4


def test_the_environment_is_an_allow_list(script: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET_TOKEN", "hunter2")
    monkeypatch.setenv("WANTED", "yes")
    body = f"import json\njson.dump(dict(os.environ), open(work + '/env.json', 'w'))\n{good()}"
    run(script(body), tmp_path, keep_env=("WANTED",))
    seen = (tmp_path / "run" / "work" / "env.json").read_text()
    assert "hunter2" not in seen
    assert '"WANTED": "yes"' in seen
    assert f'"HOME": "{tmp_path}' in seen


def test_arguments_are_no_shell(script: Script, tmp_path: Path) -> None:
    body = f"open(work + '/args', 'w').write(repr(sys.argv[2:]))\n{good()}"
    run(script(body), tmp_path, extra="--a '$(touch x); b' `c`")
    assert (tmp_path / "run" / "work" / "args").read_text() == "['--a', '$(touch x); b', '`c`']"


def test_a_virtual_environment_comes_first_on_the_path(script: Script, tmp_path: Path) -> None:
    (tmp_path / "env" / "bin").mkdir(parents=True)
    os.symlink(sys.executable, tmp_path / "env" / "bin" / "python")
    script(good()).rename(tmp_path / "env" / "bin" / "slam")
    estimate = run(Path("slam"), tmp_path, run_in=f"venv:{tmp_path / 'env'}")
    assert len(estimate.trajectory) == 4


def fake_tool(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A docker, apptainer or conda that notes its arguments and runs what follows the word ``slam``."""
    folder = tmp_path / "tools"
    folder.mkdir()
    tool = folder / name
    tool.write_text(
        f"#!{sys.executable} -IS\nimport sys, os\n"
        f"open({str(tmp_path / 'said')!r}, 'a').write(repr(sys.argv[1:]) + '\\n')\n"
        "if 'slam' in sys.argv:\n    work = sys.argv[-1]\n"
        f"    open(work + '/out.txt', 'w').write({ROWS!r})\n"
    )
    tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
    return tmp_path / "said"


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("docker:image:1", ["'run', '--rm'", "'--network', 'none'", "'image:1', 'slam'", "type=bind,source="]),
        ("apptainer:image.sif", ["'exec', '--containall'", "'image.sif', 'slam'", "'--bind'"]),
    ],
)
def test_containers_get_only_the_work_folder(
    place: str, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = fake_tool(tmp_path, place.partition(":")[0], monkeypatch)
    assert len(run(Path("slam"), tmp_path, run_in=place).trajectory) == 4
    for word in words:
        assert word in said.read_text()


def test_conda_runs_in_the_named_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(confine, "landlock_version", lambda: 0)  # the stand-in notes outside its work folder
    said = fake_tool(tmp_path, "conda", monkeypatch)
    with pytest.raises(MethodError, match="wrote outside"):
        run(Path("slam"), tmp_path, run_in="conda:slam-env")
    assert "['run', '--no-capture-output', '-n', 'slam-env', 'slam'" in said.read_text()


def test_a_place_that_is_not_there_is_unavailable(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "the program 'docker' is not on PATH" in str(StandIn.missing(ExternalConfig(run_in="docker:image")))
    assert "no virtual environment" in str(StandIn.missing(ExternalConfig(run_in=f"venv:{tmp_path}")))
    assert "is no place to run" in str(StandIn.missing(ExternalConfig(run_in="ssh:host")))


@pytest.mark.parametrize("text", ["", "docker", "docker:", "local:x", "docker:--privileged", "shell:rm"])
def test_what_is_no_place_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        parse_place(text)


def test_a_log_tail_is_one_printable_line(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_bytes(b"one\n\x1b[31mtwo\x1b[0m\r50%\r100%\n\xff\n")
    tail = log_tail(log)
    assert "\n" not in tail
    assert tail.isprintable()
    assert "two" in tail
    assert log_tail(tmp_path / "none") == ""


def test_caches_point_below_the_work_folder(tmp_path: Path) -> None:
    environment = clean_environment(tmp_path, extra={"X": "1"})
    assert environment["X"] == "1"
    assert Path(environment["TMPDIR"]).is_relative_to(tmp_path)
