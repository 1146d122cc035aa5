"""The base class of adapters to other people's programs: write the input, run the command, read the trajectory.

A subclass says what the program wants (``prepare``) and where its answer will be. What can go wrong in between is
handled here.
"""

from __future__ import annotations

import os
import shlex
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_match import interpolate_poses
from panobench.errors import InputError, MethodError, MethodTimeoutError, UnavailableError, UsageError
from panobench.external import confine
from panobench.external.findings import Finding, library_finding
from panobench.external.launch import Place, parse_place
from panobench.external.process import Finished, clean_environment, last_lines, log_tail, run_logged
from panobench.external.trajectory import TrajectoryFormat, read_answer
from panobench.external.watch import list_files, watched_folders, written_outside
from panobench.methods.base import BatchMethod, MethodContext
from panobench.options import Options, option
from panobench.types import Estimate, RunStatus, Trajectory

#: The last lines of the program's log that are copied into the run's log. The work folder is removed after the run.
LOGGED_LINES = 100
#: What the program prints, in the work folder.
PROGRAM_LOG = "program.log"
_REFUSED = ("permission denied", "read-only file system", "errno 13", "eacces")


@dataclass(frozen=True)
class ExternalConfig(Options):
    """How the program is run (every adapter has these)."""

    command: str = option("", "the program; empty: the adapter's environment variable, else its usual name on PATH")
    run_in: str = option(
        "", "local, venv:FOLDER, conda:NAME, docker:IMAGE or apptainer:IMAGE; empty: the variable, else local"
    )
    timeout_s: float = option(3600.0, "the program is ended after this time", unit="s", above=0)
    extra: str = option("", "further arguments, split as a shell would; there is no shell")
    keep_env: tuple[str, ...] = option((), "names of further environment variables the program may see")


@dataclass(frozen=True)
class Job:
    """One run of a program. Paths are absolute and, except for ``reads``, below the work folder.

    arguments:  what follows the program's name on the command line.
    trajectory: the file that the program writes; ``format`` says how.
    reads:      files or folders outside the work folder that the program must see (a vocabulary).
    statuses:   exit codes with a meaning. Otherwise 0 is success, 126 and 127 "unavailable", all others "crashed".
    keyframes:  a second file of the same format that holds the keyframes, if the program writes one.
    frame_seconds: a file with the seconds that tracking took, one number per frame; they are stored in frames.csv.
    interpolate_gap_s: frames between two answered ones at most this far apart get an interpolated pose (0: none do).
    silent_when_lost: success without a trajectory file means that nothing was tracked. Otherwise it is an error.
    """

    arguments: list[str]
    trajectory: Path
    format: TrajectoryFormat = field(default_factory=TrajectoryFormat)
    reads: tuple[Path, ...] = ()
    cwd: Path | None = None
    environment: Mapping[str, str] = field(default_factory=dict)
    statuses: Mapping[int, RunStatus] = field(default_factory=dict)
    keyframes: Path | None = None
    frame_seconds: Path | None = None
    interpolate_gap_s: float = 0.0
    silent_when_lost: bool = False


class ExternalProgramError(MethodError):
    """A program failed. ``run_status`` says how; the message ends with the last lines of the program's log."""

    def __init__(self, message: str, status: RunStatus, log: Path) -> None:
        tail = log_tail(log)
        super().__init__(f"{message}; the log ends: {tail}" if tail else f"{message}; its log is empty")
        self.run_status = status.value


class ExternalTimeoutError(ExternalProgramError, MethodTimeoutError):
    """A program took longer than its time limit and was ended."""


class ExternalMethod(BatchMethod):
    """Base class of adapters.

    title: the program's name for people. program: its usual name on PATH. variable: the start of the environment
    variables <variable>_COMMAND and <variable>_RUN_IN, which name the program and where it runs. metric: the
    program's scale is metric.
    """

    title: ClassVar[str]
    program: ClassVar[str]
    variable: ClassVar[str]
    config_class: ClassVar[type[ExternalConfig]] = ExternalConfig
    metric: ClassVar[bool] = False

    def __init__(self, config: ExternalConfig | None = None) -> None:
        self.config: ExternalConfig = config or self.config_class()

    @abstractmethod
    def prepare(self, sequence: FrameSequence, context: MethodContext) -> Job:
        """Write the program's input below ``context.work`` (an absolute path) and say how to run the program."""

    def command(self) -> str:
        """The program to start: the option, the environment variable, or the program's usual name."""
        return self.config.command or os.environ.get(f"{self.variable}_COMMAND", "") or self.program

    def place(self) -> Place:
        """Where the program runs. Raises UsageError for text that names no such place."""
        return parse_place(self.config.run_in or os.environ.get(f"{self.variable}_RUN_IN", "") or "local")

    def files(self) -> list[Path]:
        """Files on whose content results depend: the program, if it can be seen (not inside a container)."""
        place = self.place()
        found = place.find(self.command()) if place.kind in ("local", "venv") else None
        return [] if found is None else [Path(found)]

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        """For a spec's probe: None if the program can be started, otherwise one line that says what is missing."""
        method = cls(config)
        try:
            place = method.place()
        except UsageError as error:
            return str(error)
        reason = place.problem()
        if reason is None and place.find(method.command()) is None:
            reason = f"{cls.title}'s program '{method.command()}' is not on PATH; name it in {cls.variable}_COMMAND"
        return reason

    @classmethod
    def diagnose(cls) -> list[Finding]:
        """For `panobench doctor`: what is there and what is missing, in the order in which it is needed."""
        method = cls()
        try:
            place = method.place()
        except UsageError as error:
            return [Finding(False, "place", str(error), f"set {cls.variable}_RUN_IN to local or one of these")]
        where = place.kind + (f":{place.target}" if place.target else "")
        found = [Finding(place.problem() is None, "place", place.problem() or where)]
        if not found[0].ok:
            return found
        program = place.find(method.command())
        fix = f"name it: export {cls.variable}_COMMAND=/path/to/{cls.program}, or {cls.variable}_RUN_IN=docker:IMAGE"
        found.append(Finding(program is not None, "program", program or f"'{method.command()}' is not on PATH", fix))
        if program is not None and place.kind in ("local", "venv"):
            found.append(library_finding("shared libraries", Path(program), "install them, or set LD_LIBRARY_PATH"))
        confined = confine.landlock_version() > 0 or place.tool is not None
        detail = "writes are confined to the work folder" if confined else "no Landlock: writes are checked afterwards"
        return [*found, Finding(True, "confinement", detail)]

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """Prepare, run and read. Raises UnavailableError, UnsupportedError or an ExternalProgramError."""
        reason = self.missing(self.config)
        if reason is not None:
            raise UnavailableError(reason)
        context.work = context.work.resolve()
        job = self.prepare(sequence, context)
        log = context.work / PROGRAM_LOG
        finished, confined = self._start(job, context, log)
        self._check_exit(job, finished, confined, log)
        estimate = self._read(job, sequence, log)
        estimate.extra = {
            "program": self.command(),
            "place": self.place().kind,
            "program_seconds": round(finished.seconds, 3),
            **estimate.extra,
        }
        return estimate

    def _start(self, job: Job, context: MethodContext, log: Path) -> tuple[Finished, bool]:
        """Run the program to its end. The flag says whether the kernel or a container confined its writes."""
        environment = clean_environment(context.work, self.config.keep_env, job.environment)
        argv = [self.command(), *job.arguments, *shlex.split(self.config.extra)]
        launch = self.place().launch(argv, context.work, environment, job.reads, job.cwd)
        context.log(f"{self.title}: {shlex.join(argv)}")
        folders = [] if launch.confined else watched_folders(context.work)
        before = list_files(folders, context.work)
        try:
            finished = run_logged(
                launch.argv,
                cwd=job.cwd or context.work,
                environment=launch.environment,
                log=log,
                timeout_s=self.config.timeout_s,
                on_stop=launch.stop,
            )
        except OSError as error:
            raise UnavailableError(f"{self.title}: cannot start {launch.argv[0]}: {error.strerror}") from error
        outside = written_outside(before, list_files(folders, context.work))
        if outside:
            names = ", ".join(map(str, outside[:3]))
            raise ExternalProgramError(f"{self.title} wrote outside its work folder: {names}", RunStatus.CRASHED, log)
        context.log(f"{self.title}: exit code {finished.returncode} after {finished.seconds:.1f} s; its last lines:")
        for line in last_lines(log, LOGGED_LINES):
            context.log(f"| {line}")
        return finished, launch.confined

    def _check_exit(self, job: Job, finished: Finished, confined: bool, log: Path) -> None:
        """Return if the answer may be read, otherwise raise the error that the exit code stands for."""
        code = finished.returncode
        if finished.stopped == "timeout":
            message = f"{self.title} was ended after {self.config.timeout_s:g} s"
            raise ExternalTimeoutError(message, RunStatus.TIMEOUT, log)
        if finished.stopped == "log":
            raise ExternalProgramError(f"{self.title} filled its log and was ended", RunStatus.CRASHED, log)
        status = job.statuses.get(code)
        if status is RunStatus.OK or (status is None and code == 0):
            return
        if status is None:
            status = {126: RunStatus.UNAVAILABLE, 127: RunStatus.UNAVAILABLE, -9: RunStatus.OUT_OF_MEMORY}.get(code)
        if status is None and code == 137:
            status = RunStatus.OUT_OF_MEMORY
        how = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
        if confined and any(word in log_tail(log, 40, 4000).lower() for word in _REFUSED):
            how += " (it may write to its work folder only, and something was refused)"
        raise ExternalProgramError(f"{self.title} {how}", status or RunStatus.CRASHED, log)

    def _read(self, job: Job, sequence: FrameSequence, log: Path) -> Estimate:
        """The answer of a program that went through. Raises ExternalProgramError for files that do not parse."""
        try:
            if job.silent_when_lost and not job.trajectory.exists():
                trajectory = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
            else:
                trajectory = read_answer(job.trajectory, job.format, sequence.times)
            keyframes = np.zeros(0)
            if job.keyframes is not None and job.keyframes.exists():
                keyframes = read_answer(job.keyframes, job.format, sequence.times).times
        except InputError as error:
            raise ExternalProgramError(f"{self.title}'s trajectory: {error}", RunStatus.CRASHED, log) from error
        index = {float(t): i for i, t in enumerate(sequence.times)}
        estimate = Estimate(trajectory, keyframes=[index[float(t)] for t in keyframes], metric=self.metric)
        if job.interpolate_gap_s > 0 and len(trajectory) > 1:
            estimate.trajectory = interpolate_poses(trajectory, sequence.times, max_gap=job.interpolate_gap_s)
            added = np.setdiff1d(estimate.trajectory.times, trajectory.times)
            estimate.frames = {index[float(t)]: {"interpolated": 1.0} for t in added}
            estimate.extra = {"interpolated_frames": len(added), "interpolate_gap_s": job.interpolate_gap_s}
        for i, seconds in enumerate(_numbers(job.frame_seconds, len(sequence))):
            estimate.frames.setdefault(i, {})["program_tracking_s"] = seconds
        return estimate


def _numbers(path: Path | None, count: int) -> list[float]:
    """The numbers in a file, none if it does not hold exactly ``count`` of them."""
    if path is None or not path.exists():
        return []
    try:
        numbers = [float(word) for word in path.read_text(errors="replace").split()]
    except ValueError:
        return []
    return numbers if len(numbers) == count else []
