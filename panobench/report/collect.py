"""Read run folders into ``Run`` objects. A folder that cannot be read becomes a ``Problem``, never a gap."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from panobench.bench.records.record import DepthRecord, read_record
from panobench.bench.records.rescore import Protocol
from panobench.bench.records.runfolder import FRAMES, GROUNDTRUTH, LOG, RENDERS, RUN_JSON, TRAJECTORY, folders_with
from panobench.bench.records.study_record import STUDY_JSON, StoredStudy, read_study
from panobench.bench.run.masking import MASK
from panobench.bench.suite.store import QUARANTINE
from panobench.datasets.files.trajectory_io import read_tum
from panobench.errors import InputError
from panobench.report.model import Array, Collection, DepthPictures, Errors, ImagePair, Problem, Run
from panobench.types import Trajectory

LOG_LINES = 40
_RENDER = re.compile(r"^(novel_)?(\d+)\.(jpg|jpeg|png|webp)$", re.IGNORECASE)
_SUFFIXES = ("jpg", "jpeg", "png", "webp")


def collect(paths: Iterable[Path]) -> Collection:
    """Read every run and study under ``paths``: run folders, or folders (stores, studies) that contain some.

    Raises InputError when a path does not exist or nothing readable is found below any of them.
    """
    runs: list[Run] = []
    problems: list[Problem] = []
    studies: dict[Path, StoredStudy] = {}
    seen: set[Path] = set()
    for path in paths:
        if not path.exists():
            raise InputError("no such file or folder; give run folders or a folder that contains them", path)
        folders = find_runs(path)
        problems += [Problem(p, "set aside by the suite because it could not be read") for p in find_quarantined(path)]
        found = find_studies(path)
        if not folders and not found:
            raise InputError("no run.json or study.json here or below; is this a run folder?", path)
        for folder in found:
            try:
                studies[folder.resolve()] = read_study(folder)
            except InputError as error:
                problems.append(Problem(folder, str(error)))
        for folder in folders:
            if folder.resolve() in seen:
                continue
            seen.add(folder.resolve())
            try:
                runs.append(read_run(folder))
            except (InputError, OSError, ValueError) as error:
                problems.append(Problem(folder, str(error)))
    if not runs and not studies:
        raise InputError(f"none of the {len(problems)} run folder(s) can be read: {problems[0].message}")
    runs.sort(key=lambda r: (r.dataset, r.sequence, r.method, sorted(r.variant.items()), r.seed or 0, str(r.folder)))
    return Collection(tuple(runs), tuple(problems), tuple(studies.values()))


def find_runs(path: Path) -> list[Path]:
    """Folders with a run.json at or below ``path``; hidden folders and unfinished ones are not entered."""
    return folders_with(RUN_JSON, path.parent if path.is_file() else path)


def find_studies(path: Path) -> list[Path]:
    """Folders with a study.json at or below ``path``, as for runs."""
    return folders_with(STUDY_JSON, path) if path.is_dir() else []


def find_quarantined(path: Path) -> list[Path]:
    """Runs that a suite has set aside in the store at ``path``; the report shows them too."""
    folder = path / QUARANTINE
    return sorted(p for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []


def read_run(folder: Path) -> Run:
    """One run folder. Raises InputError when run.json is not usable; other files may be absent or damaged."""
    record = read_record(folder)
    warnings: list[str] = []
    trajectory = _optional_tum(folder / TRAJECTORY, warnings)
    groundtruth = _optional_tum(folder / GROUNDTRUTH, warnings)
    frames = _frames(folder / FRAMES, warnings)
    return Run(
        folder=folder,
        record=record,
        trajectory=trajectory,
        groundtruth=groundtruth,
        errors=trajectory_errors(trajectory, groundtruth, Protocol.of(record)) if trajectory is not None else None,
        frames=frames,
        pairs=_pairs(folder / RENDERS),
        mask=mask if (mask := folder / MASK).is_file() else None,
        depth=_depth(folder, record.depth),
        hidden=_first(folder / RENDERS, "hidden"),
        log_tail=_log_tail(folder / LOG),
        warnings=tuple(warnings),
    )


def trajectory_errors(estimate: Trajectory, truth: Trajectory | None, protocol: Protocol) -> Errors | None:
    """The error per pose by the matching and the alignment of the ATE; None where that is not defined."""
    from panobench.metrics.alignment import match
    from panobench.metrics.trajectory import align, chosen_alignment

    if protocol.skip_s > 0 and len(estimate):
        estimate = estimate.select(np.flatnonzero(estimate.times >= estimate.times[0] + protocol.skip_s))
    how = chosen_alignment(protocol.alignment)
    matched = match(estimate, truth)
    aligned = align(matched, how) if matched is not None else None
    if matched is None or aligned is None:
        return None
    translation, rotation = aligned.errors()
    return Errors(
        times=matched.estimate.times,
        positions=aligned.positions,
        translation=translation,
        rotation=rotation,
        alignment={"sim3": "Sim(3)", "se3": "SE(3)", "none": "none"}[how],
        transform=aligned.transform,
    )


def _optional_tum(path: Path, warnings: list[str]) -> Trajectory | None:
    if not path.is_file() or path.stat().st_size == 0:  # a run that failed before the first pose has an empty file
        return None
    try:
        trajectory = read_tum(path)
    except (InputError, OSError) as error:
        warnings.append(str(error))
        return None
    return trajectory if len(trajectory) else None


def _frames(path: Path, warnings: list[str]) -> dict[str, Array]:
    """The columns of frames.csv as numbers; text and empty cells become NaN, true and false 1 and 0."""
    if not path.is_file():
        return {}
    try:
        with path.open(newline="", encoding="utf-8", errors="replace") as stream:
            rows = list(csv.DictReader(stream))
    except (OSError, csv.Error) as error:
        warnings.append(f"{path}: {error}")
        return {}
    names = [name for name in (rows[0] if rows else {}) if name]
    return {name: np.array([_cell(row.get(name)) for row in rows], dtype=np.float64) for name in names}


def _cell(text: Any) -> float:
    word = str(text or "").strip().lower()
    if word in ("true", "false"):
        return 1.0 if word == "true" else 0.0
    try:
        return float(word)
    except ValueError:
        return math.nan


def _pairs(folder: Path) -> tuple[ImagePair, ...]:
    if not folder.is_dir():
        return ()
    pairs = []
    for path in sorted(folder.iterdir()):
        match = _RENDER.match(path.name)
        if match:
            truth = _first(folder, f"{path.stem}_gt")
            pairs.append(ImagePair(int(match.group(2)), path, truth, novel=match.group(1) is not None))
    return tuple(pairs)


def _first(folder: Path, stem: str) -> Path | None:
    return next((p for s in _SUFFIXES if (p := folder / f"{stem}.{s}").is_file()), None)


def _depth(folder: Path, about: DepthRecord) -> DepthPictures | None:
    depth, confidence = _first(folder / RENDERS, "depth"), _first(folder / RENDERS, "depth_confidence")
    if depth is None and confidence is None:
        return None
    span = about.range or []
    return DepthPictures(
        depth,
        confidence,
        name=about.source or "",
        message=about.message or "",
        span=(span[0], span[1]) if len(span) == 2 else None,
        oracle=about.oracle,
    )


def _log_tail(path: Path) -> str:
    if not path.is_file():
        return ""
    with path.open("rb") as stream:
        stream.seek(0, 2)
        stream.seek(max(0, stream.tell() - 32_768))
        text = stream.read().decode("utf-8", errors="replace")
    return "\n".join(text.splitlines()[-LOG_LINES:])
