"""The base of adapters to other people's programs: write input, run the command, read the trajectory.

A subclass says what the program wants (``prepare``) and where its answer is; everything that can go wrong in
between is handled here, once.
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
from panobench.errors import InputError, MethodError, MethodTimeoutError, UnavailableError, UsageError
from panobench.external import confine
from panobench.external.findings import Finding, missing_libraries
from panobench.external.launch import Place, parse_place
from panobench.external.process import Finished, clean_environment, last_lines, log_tail, run_logged
from panobench.external.trajectory import TrajectoryFormat, read_answer
from panobench.external.vocabulary import named_vocabulary
from panobench.external.watch import guarded_folders, listing, strays
from panobench.methods.base import BatchMethod, MethodContext
from panobench.options import Options, option
from panobench.types import Estimate, RunStatus, Trajectory

#: Of the program's log that go into the run's own: the work folder is removed afterwards.
LOGGED_LINES = 100
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
    """One program run. Paths are absolute, below the work folder but for ``reads``.

    arguments:  after the program's name.
    trajectory: the file the program writes. format: how.
    reads:      files or folders outside the work folder that it must see (a vocabulary).
    statuses:   exit codes that mean something; else 0 is a success, 126 and 127 "unavailable", the rest "crashed".
    keyframes:  a second file of the same format with the keyframes, if the program writes one.
    silent_when_lost: after a success without a trajectory file nothing was tracked; else that is an error.
    """

    arguments: list[str]
    trajectory: Path
    format: TrajectoryFormat = field(default_factory=TrajectoryFormat)
    reads: tuple[Path, ...] = ()
    cwd: Path | None = None
    environment: Mapping[str, str] = field(default_factory=dict)
    statuses: Mapping[int, RunStatus] = field(default_factory=dict)
    keyframes: Path | None = None
    silent_when_lost: bool = False


class ExternalProgramError(MethodError):
    """A program failed; ``run_status`` says how, the message ends with its log's last lines."""

    def __init__(self, message: str, status: RunStatus, log: Path) -> None:
        tail = log_tail(log)
        super().__init__(f"{message}; the log ends: {tail}" if tail else f"{message}; its log is empty")
        self.run_status = status.value


class ExternalTimeoutError(ExternalProgramError, MethodTimeoutError):
    """A program took longer than its limit and was ended."""


class ExternalMethod(BatchMethod):
    """Base class. ``title`` is the program's name for people, ``program`` its usual name on PATH.

    variable: start of the environment variables that name program and place:
    <variable>_COMMAND and <variable>_RUN_IN. metric: its scale is metres.
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
        """Write the program's input below ``context.work`` (resolved) and say how to run it."""

    def command(self) -> str:
        """The program to start: option, environment variable, or its usual name."""
        return self.config.command or os.environ.get(f"{self.variable}_COMMAND", "") or self.program

    def place(self) -> Place:
        """Where it runs. Raises UsageError for text that names no place."""
        return parse_place(self.config.run_in or os.environ.get(f"{self.variable}_RUN_IN", "") or "local")

    def files(self) -> list[Path]:
        """The program and the named vocabulary, whose content counts for suites; inside containers nothing is seen."""
        place = self.place()
        found = place.find(self.command()) if place.kind in ("local", "venv") else None
        vocabulary = named_vocabulary(self.config.vocabulary) if hasattr(self.config, "vocabulary") else None
        return [Path(p) for p in (found, vocabulary) if p is not None]

    @classmethod
    def missing(cls, config: ExternalConfig | None = None) -> str | None:
        """For probes: None if the program can be started, else one line what is missing."""
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
        """For `panobench doctor`: what is there and what is not, in the order in which it is needed."""
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
            missing = missing_libraries(Path(program))
            detail = f"needs {', '.join(missing)}" if missing else "all found"
            found.append(Finding(not missing, "shared libraries", detail, "install them, or set LD_LIBRARY_PATH"))
        confined = confine.landlock_version() > 0 or place.tool is not None
        detail = "writes are confined to the work folder" if confined else "no Landlock: strays are found afterwards"
        return [*found, Finding(True, "confinement", detail)]

    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """Prepare, run, read. Raises UnavailableError, UnsupportedError or an ExternalProgramError."""
        reason = self.missing(self.config)
        if reason is not None:
            raise UnavailableError(reason)
        context.work = context.work.resolve()
        job = self.prepare(sequence, context)
        log = context.work / "program.log"
        finished, confined = self._run(job, context, log)
        self._judge(job, finished, confined, log)
        try:
            if job.silent_when_lost and not job.trajectory.exists():
                trajectory = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
            else:
                trajectory = read_answer(job.trajectory, job.format, sequence.times)
            keys = None
            if job.keyframes is not None and job.keyframes.exists():
                keys = read_answer(job.keyframes, job.format, sequence.times)
        except InputError as error:
            raise ExternalProgramError(f"{self.title}'s trajectory: {error}", RunStatus.CRASHED, log) from error
        index = {float(t): i for i, t in enumerate(sequence.times)}
        return Estimate(
            trajectory,
            keyframes=[] if keys is None else [index[float(t)] for t in keys.times],
            metric=self.metric,
            extra={
                "program": self.command(),
                "place": self.place().kind,
                "program_seconds": round(finished.seconds, 3),
            },
        )

    def _run(self, job: Job, context: MethodContext, log: Path) -> tuple[Finished, bool]:
        environment = clean_environment(context.work, self.config.keep_env, job.environment)
        argv = [self.command(), *job.arguments, *shlex.split(self.config.extra)]
        launch = self.place().launch(argv, context.work, environment, job.reads, job.cwd)
        context.log(f"{self.title}: {shlex.join(argv)}")
        folders = [] if launch.confined else guarded_folders(context.work)
        before = listing(folders, context.work)
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
        outside = strays(before, listing(folders, context.work))
        if outside:
            names = ", ".join(map(str, outside[:3]))
            raise ExternalProgramError(f"{self.title} wrote outside its work folder: {names}", RunStatus.CRASHED, log)
        context.log(f"{self.title}: exit code {finished.returncode} after {finished.seconds:.1f} s; its last lines:")
        for line in last_lines(log, LOGGED_LINES):
            context.log(f"| {line}")
        return finished, launch.confined

    def _judge(self, job: Job, finished: Finished, confined: bool, log: Path) -> None:
        """Raise what the exit code stands for; return if the answer may be read."""
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
