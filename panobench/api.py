"""Runs from Python: do one, read stored ones, look at them, and score a trajectory.

    run = panobench.run(method="sparse", dataset="rooms", sequence="tiny", width=256)
    run.metrics["ate_rmse_m"], run.verdict, run.trajectory.positions

Everything is read from the run's folder when it is first asked for.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.cautions import cautions
from panobench.bench.records.record import RunRecord, VerdictRecord, read_record
from panobench.bench.records.runfolder import MAP, RUN_JSON, folders_with
from panobench.bench.run.request import RunRequest
from panobench.datasets.base import FrameSequence
from panobench.errors import InputError, UnavailableError, UsageError
from panobench.types import Estimate, RunStatus, Trajectory

if TYPE_CHECKING:
    import pandas

    from panobench.cameras.base import Camera
    from panobench.report.model import Run as StoredRun
    from panobench.splat.gaussians import GaussianMap


class Run:
    """One stored run.

    record: everything in its run.json. Raises InputError where ``folder`` is no run folder.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self.record: RunRecord = read_record(self.folder)

    def __repr__(self) -> str:
        spec = self.record.spec
        return f"<Run {spec.method} on {spec.dataset}/{spec.sequence}: {self.status}, {self.folder}>"

    @property
    def status(self) -> str:
        """How it ended: a RunStatus value."""
        return self.record.status

    @property
    def ok(self) -> bool:
        """Whether it went well."""
        return self.record.ok

    @property
    def metrics(self) -> dict[str, float | None]:
        """What was measured, by name; None where it could not be. Units are in the names: ``ate_rmse_m``."""
        return dict(self.record.metrics)

    @property
    def verdict(self) -> VerdictRecord | None:
        """Whether it can be trusted, with reasons and advice; None for runs stored before there were verdicts."""
        return self.record.verdict

    @property
    def cautions(self) -> tuple[str, ...]:
        """What to know before comparing it: words of ``panobench.bench.records.cautions.CAUTIONS``."""
        return cautions(self.record)

    @property
    def trajectory(self) -> Trajectory:
        """The estimate: times (N,) s, camera-to-world poses (N, 4, 4). Empty if no frame has a pose."""
        return self._stored.trajectory or Trajectory(np.zeros(0), np.zeros((0, 4, 4)))

    @property
    def groundtruth(self) -> Trajectory | None:
        """The true trajectory, None where there is none."""
        return self._stored.groundtruth

    @property
    def aligned(self) -> Trajectory | None:
        """The estimate in the ground truth's world and unit, as the run was scored; None without ground truth."""
        errors = self._stored.errors
        if errors is None:
            return None
        return Trajectory(self.trajectory.times, errors.transform.apply_poses(self.trajectory.T_wc))

    @property
    def frames(self) -> Mapping[str, NDArray[np.float64]]:
        """The columns of frames.csv by name, one number per frame given, NaN where there is none."""
        return self._stored.frames

    @cached_property
    def map(self) -> GaussianMap | None:
        """The Gaussians of its map, None if it stored none. Raises InputError for a file that is damaged."""
        path = self.folder / MAP
        if not path.is_file():
            return None
        from panobench.splat.gaussians import GaussianMap
        from panobench.splat.ply import read_ply

        return GaussianMap(*read_ply(path))

    @cached_property
    def camera(self) -> Camera:
        """The camera of the frames that the method got. Raises InputError where the run does not say."""
        from panobench.cameras.factory import camera_from_dict

        if self.record.spec.camera_model is None:
            raise InputError("the run does not say what camera its frames have", self.folder / RUN_JSON)
        return camera_from_dict(self.record.spec.camera_model)

    def render(self, i: int, camera: Camera | None = None) -> NDArray[np.float32]:
        """RGB (H, W, 3) in 0..1: the map seen from the i-th pose of the trajectory (-1 is the last), by ``camera``.

        camera: the run's own by default. Raises UsageError for a pose or a map that is not there.
        """
        from panobench.splat.render import Renderer

        if self.map is None:
            raise UsageError(f"{self.folder} has no map to render")
        if not -len(self.trajectory) <= i < len(self.trajectory):
            raise UsageError(f"pose {i}: the trajectory has {len(self.trajectory)}")
        seen = camera or self.camera
        renderer = Renderer(seen, "pinhole" if seen.kind == "pinhole" else "sphere")
        return np.ascontiguousarray(np.clip(renderer.forward(self.map, self.trajectory.T_wc[i]).colour, 0.0, 1.0))

    def to_dataframe(self) -> pandas.DataFrame:
        """The frames as a table: frames.csv, with the error of each pose where there is ground truth.

        Raises UnavailableError without pandas.
        """
        table = _pandas().DataFrame(dict(self.frames))
        errors = self._stored.errors
        if errors is not None and "time" in table:
            for name, values in (("error_m", errors.translation), ("error_deg", errors.rotation)):
                column = np.full(len(table), np.nan)
                nearest = np.abs(table["time"].to_numpy()[:, None] - errors.times[None, :]).argmin(axis=0)
                column[nearest] = values
                table[name] = column
        return table

    def report(self, output: Path | str) -> Path:
        """Write the report of this run, in the format of the file's suffix, and return its path."""
        from panobench.report.build import write_report

        write_report([self.folder], Path(output))
        return Path(output)

    def export(self, to: str, output: Path | str | None = None, **options: Any) -> Path:
        """Write it for another program, as `panobench export` does, whose options have the same names here.

        Raises UnknownNameError for a format that is not in ``panobench.bench.export.FORMATS``.
        """
        from panobench.bench.export import ExportOptions, export_run

        return export_run(self, to, None if output is None else Path(output), ExportOptions(**options))

    def walk(self, output: Path | str) -> Path:
        """Write one offline page in which one walks through its map, and return its path.

        Raises UsageError where it has no map.
        """
        from panobench.viewer.walk.page import walk_of_run, write_walk

        write_walk(walk_of_run(self), Path(output))
        return Path(output)

    @cached_property
    def _stored(self) -> StoredRun:
        from panobench.report.collect import read_run

        return read_run(self.folder)

    def _repr_html_(self) -> str:
        from panobench.report.card import card

        return card(self._stored)


class Runs(Sequence[Run]):
    """Stored runs in the order of their folders' names."""

    def __init__(self, runs: Sequence[Run]) -> None:
        self._runs = tuple(runs)

    def __len__(self) -> int:
        return len(self._runs)

    def __iter__(self) -> Iterator[Run]:
        return iter(self._runs)

    @overload
    def __getitem__(self, index: int) -> Run: ...
    @overload
    def __getitem__(self, index: slice) -> Runs: ...
    def __getitem__(self, index: int | slice) -> Run | Runs:
        return Runs(self._runs[index]) if isinstance(index, slice) else self._runs[index]

    def __repr__(self) -> str:
        return f"<{len(self)} runs, {sum(run.ok for run in self)} ok>"

    def where(self, **options: Any) -> Runs:
        """The runs with these run options: ``runs.where(method="panogs", width=512)``."""
        return Runs([r for r in self if all(r.record.spec.option(name) == value for name, value in options.items())])

    def to_dataframe(self) -> pandas.DataFrame:
        """A row per run: folder, run options, status, verdict, cautions, metrics and timing.

        Raises UnavailableError without pandas.
        """
        return _pandas().DataFrame([_row(run) for run in self])

    def report(self, output: Path | str) -> Path:
        """Write one report of all of them, in the format of the file's suffix, and return its path."""
        from panobench.report.build import write_report

        write_report([run.folder for run in self], Path(output))
        return Path(output)

    def figures(
        self,
        folder: Path | str,
        *,
        width: str = "3.4in",
        formats: str = "pdf,svg",
        rename: Mapping[str, str] | None = None,
    ) -> list[Path]:
        """Write figures for a paper, as `panobench report --figures` does, and return their paths.

        rename: what to call methods. Raises UsageError and UnavailableError as the command does.
        """
        from panobench.report.collect import collect
        from panobench.report.paper.style import parse_formats, parse_width
        from panobench.report.paper.write import write_figures

        collection = collect([run.folder for run in self])
        return write_figures(collection, Path(folder), parse_width(width), parse_formats(formats), dict(rename or {}))

    def _repr_html_(self) -> str:
        more = f"<p>and {len(self) - 20} more</p>" if len(self) > 20 else ""
        return "".join(run._repr_html_() for run in self[:20]) + more


def run(out: Path | str | None = None, *, force: bool = False, progress: bool = False, **options: Any) -> Run:
    """Do one run and return it, however it ended: look at its ``status``.

    options: those of `panobench run` by the names of ``RunRequest``: method, dataset, sequence, camera, width and so
    on. out: the run folder; a new one below runs/ by default. force: replace what is there. progress: a bar on
    standard error. Raises PanobenchError for what the caller can mend; nothing is written then.
    """
    from panobench.bench.run.runner import execute

    try:
        request = RunRequest(**options)
    except TypeError as error:
        raise UsageError(f"{error}; the options are the fields of panobench.RunRequest") from error
    target = None if out is None else Path(out)
    if not progress:
        return Run(execute(request, target, force=force))
    from panobench.cli.run import run_with_progress

    return Run(run_with_progress(request, target, force, show=True))


def load(store: Path | str) -> Runs:
    """The runs in a folder and below it: a run folder, the store of a suite, a study.

    Raises InputError where there is none, or one that cannot be read.
    """
    path = Path(store)
    if not path.exists():
        raise InputError("no such folder", path)
    folders = folders_with(RUN_JSON, path)
    if not folders:
        raise InputError("no run.json here or below", path)
    return Runs([Run(folder) for folder in folders])


@dataclass(frozen=True)
class Score:
    """What a trajectory scored: metrics by name, notes on what could not be measured, and whether it counts."""

    metrics: dict[str, float | None]
    status: str
    message: str = ""
    notes: dict[str, str] = field(default_factory=dict)


def score(trajectory: Trajectory | Path | str, sequence: FrameSequence | Trajectory, *, metric: bool = False) -> Score:
    """Judge a trajectory by the protocol, against a sequence's ground truth or a true trajectory.

    trajectory: poses at times of the sequence, or a TUM file of them. metric: its scale is metres, so that errors are
    measured without scale alignment as well. Raises InputError for a file that cannot be read or without ground truth.
    """
    from panobench.bench.records.rescore import StoredSequence
    from panobench.bench.run.evaluate import judge
    from panobench.datasets.files.trajectory_io import read_tum
    from panobench.metrics.base import MetricInput
    from panobench.metrics.trajectory import trajectory_metrics

    estimate = trajectory if isinstance(trajectory, Trajectory) else read_tum(Path(trajectory))
    given = StoredSequence(sequence.times, sequence) if isinstance(sequence, Trajectory) else sequence
    if given.groundtruth is None:
        raise InputError(f"sequence '{given.name}' has no ground truth to score a trajectory by")
    data = MetricInput(given, Estimate(estimate, metric=metric), list(range(len(given.times))))
    metrics = {**trajectory_metrics(data), "tracked": len(estimate) / len(given.times) if len(given.times) else 0.0}
    status, message = judge(metrics)
    return Score(metrics, RunStatus(status).value, message, dict(data.notes))


def _row(run: Run) -> dict[str, Any]:
    spec, verdict = run.record.spec, run.verdict
    return {
        "folder": str(run.folder),
        "method": spec.method,
        "dataset": spec.dataset,
        "sequence": spec.sequence,
        "seed": spec.seed,
        **spec.variants(),
        "status": run.status,
        "verdict": verdict.word if verdict else None,
        "cautions": "; ".join(run.cautions),
        **run.metrics,
        **{k: v for k, v in run.record.timing.to_dict().items() if isinstance(v, (int, float))},
    }


def _pandas() -> Any:
    try:
        import pandas
    except ModuleNotFoundError as error:
        raise UnavailableError("to_dataframe needs the Python package 'pandas': pip install pandas") from error
    return pandas
