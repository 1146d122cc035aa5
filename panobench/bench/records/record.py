"""run.json holds what is known about a run when it is over. It is written and read through ``RunRecord``.

A new fact about runs is a field of ``RunRecord`` or one of its parts, with a default that stands for runs stored before
it existed; ``optional()`` fields are left out of the file where they are None.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from panobench.bench.records.fields import UNFIT, JsonRecord, fit, number, optional
from panobench.bench.records.provenance import ProvenanceRecord
from panobench.bench.records.runfolder import RUN_JSON, SCHEMA, read_run_json, write_json
from panobench.bench.run.request import RunRequest, run_options, value_text
from panobench.metrics.base import PROTOCOL_VERSION
from panobench.types import RunStatus
from panobench.verdict.base import Verdict
from panobench.writing import writing

#: Metrics that every run.json has, null where they were not measured, because other tools rely on them.
METRIC_NAMES = (
    "ate_rmse_m",
    "ate_keyframes_rmse_m",
    "rpe_trans_rmse_m",
    "tracked",
    "psnr_db",
    "ssim",
    "lpips",
    "pano_psnr_db",
    "ws_psnr_db",
    "holdout_psnr_db",
    "novel_psnr_db",
)


@dataclass
class SpecRecord(JsonRecord):
    """What was run: the run options as they took effect, the method's configuration, and the camera of its images.

    In the file the options stand beside ``config`` and ``camera_model``; here they are in ``other``, for ``option`` to
    look up. ``sequence`` and ``depth`` are those that were used, not those that were asked for.
    """

    config: dict[str, Any] = field(default_factory=dict)
    camera_model: dict[str, Any] | None = None

    @classmethod
    def of(cls, request: RunRequest, **used: Any) -> SpecRecord:
        """The record of a request. used: further fields, and options that took another effect than asked for."""
        own = {k: used.pop(k) for k in ("config", "camera_model") if k in used}
        return cls(**own, other={**request.to_dict(), **used})

    def to_dict(self) -> dict[str, Any]:
        """As ``JsonRecord.to_dict``, with the options first."""
        return {**self.other, "config": self.config, "camera_model": self.camera_model}

    def option(self, name: str) -> Any:
        """The value of a run option; its default where the run was stored before there was such an option."""
        option = next(option for option in run_options() if option.name == name)
        value = fit(self.other[name], option.type) if name in self.other else UNFIT
        return option.default if value is UNFIT else value

    def _text(self, name: str) -> str:
        value = self.other.get(name)
        return value if isinstance(value, str) else ""

    @property
    def method(self) -> str:
        """The method's name, "" if the file does not say."""
        return self._text("method")

    @property
    def dataset(self) -> str:
        """The dataset's name, "" if the file does not say."""
        return self._text("dataset")

    @property
    def sequence(self) -> str:
        """The sequence's name, "" if the file does not say."""
        return self._text("sequence")

    @property
    def seed(self) -> int | None:
        """The seed, None if the file does not say."""
        value = number(self.other.get("seed"))
        return None if value is None else int(value)

    def variants(self) -> dict[str, str]:
        """The options that may tell apart runs of one method on one sequence, as text; only those that were given."""
        values = {option.name: self.option(option.name) for option in run_options() if option.label is not None}
        given = {k: v for k, v in values.items() if v is not False and v not in (None, "", {}, [])}
        return {name: value_text(value) for name, value in given.items()}


@dataclass
class MethodRecord(JsonRecord):
    """What the method says about itself; see MethodSpec. origin: the package it came with."""

    name: str = ""
    origin: str = ""
    contract: str = ""
    licence: str = ""
    citation: str = ""
    needs: list[str] = field(default_factory=list)


@dataclass
class TimingRecord(JsonRecord):
    """Times, rates and resources of the method alone; see docs/protocol.md. None: it was not measured."""

    fps: float | None = None
    tracking_fps: float | None = None
    latency_p50_s: float | None = None
    latency_p95_s: float | None = None
    prepare_s: float | None = None
    late_compile_s: float | None = None
    start_s: float | None = None
    finish_s: float | None = None
    wall_s: float | None = None
    evaluation_s: float | None = None
    peak_rss_bytes: float | None = None
    cpu_s: float | None = None
    peak_gpu_bytes: float | None = optional()


@dataclass
class FramesRecord(JsonRecord):
    """Numbers of frames: given to the method, planned, with a pose, and held out of the map."""

    given: int = 0
    planned: int | None = None
    tracked: int = 0
    held_out: int = 0


@dataclass
class DepthRecord(JsonRecord):
    """Where the map's first depth came from.

    source: the estimator, "input" for depth given with every frame. oracle: the dataset's own depth was used.
    poses_given: the method was given true poses. frame, ok and message are those of the estimate; range is the 2nd and
    98th percentile of its depth.
    """

    source: str | None = None
    oracle: bool = False
    poses_given: bool = False
    frame: int | None = optional()
    ok: bool | None = optional()
    message: str | None = optional()
    range: list[float] | None = optional()


@dataclass
class MaskRecord(JsonRecord):
    """What of the view the method did not see.

    source: the estimator's name, "file", or "" for what the camera itself does not see. file: the mask's name.
    ok, message: what the estimator says of itself. found: share of the camera's view it hid; hidden: share that is
    hidden altogether, a mask that came with the data included. frames: how many frames have masks of their own, which
    hide more. seconds: how long it took to find.
    """

    source: str = ""
    file: str | None = optional()
    ok: bool = True
    message: str = ""
    found: float = 0.0
    hidden: float = 0.0
    frames: int = 0
    seconds: float | None = optional()
    details: dict[str, Any] | None = optional()


@dataclass
class MovingRecord(JsonRecord):
    """What a method found to move by itself and left out: in how many frames, and the mean and largest share."""

    frames: int = 0
    mean: float = 0.0
    most: float = 0.0


@dataclass
class TruthRecord(JsonRecord):
    """Ground truth and the frames it belongs to.

    frames: how many of the frames planned have a true pose. span_s: first and last time of the truth as recorded;
    frames_span_s: of the frames. up: the direction against gravity in its world.
    time_offset_s: what was added to the truth's times; offset_within_s: offsets this far
    away fit the motion nearly as well.
    """

    frames: int = 0
    span_s: list[float] | None = None
    frames_span_s: list[float] | None = None
    up: list[float] | None = optional()
    time_offset_s: float | None = optional()
    offset_within_s: float | None = optional()

    def __post_init__(self) -> None:
        for name, length in (("span_s", 2), ("frames_span_s", 2), ("up", 3)):
            if len(getattr(self, name) or ()) != length:
                setattr(self, name, None)


@dataclass
class MapRecord(JsonRecord):
    """The map file in the run's folder."""

    file: str = ""
    gaussians: int | None = None
    bytes: int | None = None


@dataclass
class VerdictRecord(JsonRecord):
    """Whether the run is right, from evidence that needs no ground truth; see ``verdict.base``.

    word: "trusted", "doubtful" or "failed". confidence: 0..1. evidence: name, trust and text of each piece. check: the
    second opinion that was asked for, a method's name or "backwards"; None without one.
    """

    word: str = ""
    confidence: float = 0.0
    reasons: list[str] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)
    evidence: list[dict[str, Any]] = field(default_factory=list)
    check: str | None = optional()

    @classmethod
    def of(cls, verdict: Verdict, check: str | None = None) -> VerdictRecord:
        """Of a verdict."""
        evidence = [{"name": e.name, "trust": e.trust, "text": e.text} for e in verdict.evidence]
        return cls(verdict.word.value, verdict.confidence, list(verdict.reasons), list(verdict.advice), evidence, check)


@dataclass
class CellRecord(JsonRecord):
    """The cell of a suite. key: hash of all that its result depends on. identity: hash of the cell."""

    suite: str = ""
    key: str = ""
    identity: str = ""
    label: str = ""
    repeat: int = 0
    limits: dict[str, float] = field(default_factory=dict)
    attempt: int = 1


@dataclass
class ImportedRecord(JsonRecord):
    """The file a trajectory was imported from, and how it was read; see ImportOptions.

    poses: how many it has. unplaced: how many of them belong to no frame. keyframes: it has those of keyframes alone.
    """

    trajectory: str = ""
    sha256: str = ""
    format: str | None = None
    inverse: bool = False
    time_offset_s: float = 0.0
    poses: int | None = None
    unplaced: int | None = None
    keyframes: bool = False
    renders: str | None = None


@dataclass
class RescoredRecord(JsonRecord):
    """The protocol and status that a run had before it was scored again."""

    protocol: str = ""
    status: str = ""


@dataclass
class RunRecord(JsonRecord):
    """Everything in run.json.

    status: a RunStatus value; message: why it is not ok. origin: "measured", "imported" or "published".
    metric: the method says that its scale is metres; gravity_aligned: that its world's z axis points up.
    notes: metric -> why it is None or odd. keyframes: frame indices.
    mask: what hid part of the view, if anything did. moving: what the method left out by itself, if anything.
    gpu: the name of the GPU that maps were computed on, if one was.
    groundtruth: whether a frame has any; groundtruth_scaled: in metres.
    truth, verdict: None for runs stored before there were such.
    remarks: what the dataset says about its data. extra: what the method reports.
    isolation: what the process that watched the run measured.
    """

    schema: int = SCHEMA
    status: str = ""
    message: str = ""
    origin: str = "measured"
    spec: SpecRecord = field(default_factory=SpecRecord)
    method: MethodRecord = field(default_factory=MethodRecord)
    protocol: str = ""
    metric: bool = False
    gravity_aligned: bool = False
    metrics: dict[str, float | None] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    timing: TimingRecord = field(default_factory=TimingRecord)
    frames: FramesRecord = field(default_factory=FramesRecord)
    keyframes: list[int] = field(default_factory=list)
    depth: DepthRecord = field(default_factory=DepthRecord)
    mask: MaskRecord | None = optional()
    moving: MovingRecord | None = optional()
    gpu: str | None = optional()
    groundtruth: bool = False
    groundtruth_scaled: bool = True
    truth: TruthRecord | None = optional()
    remarks: list[str] = field(default_factory=list)
    extra: dict[str, Any] = field(default_factory=dict)
    provenance: ProvenanceRecord = field(default_factory=ProvenanceRecord)
    map: MapRecord | None = None
    verdict: VerdictRecord | None = optional()
    cell: CellRecord | None = optional()
    isolation: dict[str, Any] | None = optional()
    imported: ImportedRecord | None = optional()
    rescored_from: RescoredRecord | None = optional()

    @property
    def ok(self) -> bool:
        """Whether the run went well."""
        return self.status == RunStatus.OK.value

    def number(self, name: str) -> float | None:
        """A metric or a timing by its name; None where it was not measured."""
        value = self.metrics.get(name)
        return value if value is not None else number(getattr(self.timing, name, self.timing.other.get(name)))


def empty_record(request: RunRequest, status: RunStatus, message: str) -> RunRecord:
    """The record of a run that has no results."""
    return RunRecord(
        status=status.value,
        message=" ".join(message.split()),
        spec=SpecRecord.of(request),
        method=MethodRecord(name=request.method),
        protocol=PROTOCOL_VERSION,
        metrics={**dict.fromkeys(METRIC_NAMES), "tracked": 0.0},
    )


def read_record(folder: Path) -> RunRecord:
    """The record of a run folder. Raises InputError naming file and line when run.json is not usable."""
    return RunRecord.from_dict(read_run_json(folder))


def write_record(folder: Path, record: RunRecord) -> None:
    """Write run.json below ``folder``."""
    write_json(folder / RUN_JSON, record.to_dict())


def replace_record(folder: Path, record: RunRecord) -> None:
    """Replace run.json by a rename: a reader sees the old or the new one. Raises OutputError."""
    part = folder / f".{RUN_JSON}.{os.getpid()}.part"
    try:
        with writing(folder):
            write_json(part, record.to_dict())
            os.replace(part, folder / RUN_JSON)
    finally:
        part.unlink(missing_ok=True)
