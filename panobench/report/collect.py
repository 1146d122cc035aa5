"""Read run folders into ``Run`` objects. A folder that cannot be read becomes a ``Problem``, never a gap."""

from __future__ import annotations

import csv
import json
import math
import re
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from panobench.bench.request import run_options
from panobench.bench.runfolder import read_run_json
from panobench.datasets.trajectory_io import read_tum
from panobench.errors import InputError
from panobench.geometry import Sim3, so3_log, umeyama
from panobench.report.model import (
    Array,
    Collection,
    DepthPictures,
    Errors,
    ImagePair,
    Origin,
    Problem,
    Run,
)
from panobench.studies.stored import STUDY_JSON, StoredStudy, read_study
from panobench.types import Trajectory

LOG_LINES = 40
#: Where a suite's store puts run folders that cannot be read (panobench.bench.store).
QUARANTINE = "_quarantine"
#: Largest time difference, as a share of the median frame interval, for a pose to meet its ground truth.
TIME_TOLERANCE = 0.4
_RENDER = re.compile(r"^(novel_)?(\d+)\.(jpg|jpeg|png|webp)$", re.IGNORECASE)
#: Beyond it sums and squares overflow; nothing that is measured comes near.
_LARGEST = 1e100
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
    if path.is_file():
        path = path.parent
    return _folders_with("run.json", path)


def find_studies(path: Path) -> list[Path]:
    """Folders with a study.json at or below ``path``, as for runs."""
    return _folders_with(STUDY_JSON, path) if path.is_dir() else []


def _folders_with(name: str, path: Path) -> list[Path]:
    if (path / name).is_file():
        return [path]
    found: list[Path] = []
    for child in sorted(p for p in path.iterdir() if p.is_dir()):
        if not child.name.startswith((".", "_")):
            found.extend(_folders_with(name, child))
    return found


def find_quarantined(path: Path) -> list[Path]:
    """Runs a suite has set aside in the store at ``path``, for the report not to hide them."""
    folder = path / QUARANTINE
    return sorted(p for p in folder.iterdir() if p.is_dir()) if folder.is_dir() else []


def read_run(folder: Path) -> Run:
    """One run folder. Raises InputError when run.json is not usable; other files may be absent or damaged."""
    document = read_run_json(folder)
    spec = _mapping(document.get("spec"))
    warnings: list[str] = []
    trajectory = _optional_tum(folder / "trajectory.tum", warnings)
    groundtruth = _optional_tum(folder / "groundtruth.tum", warnings)
    metrics, timing = _mapping(document.get("metrics")), _mapping(document.get("timing"))
    numbers = {key: _number(value) for key, value in {**metrics, **timing}.items()}
    protocol = _text(document.get("protocol"))
    errors = None
    if trajectory is not None and groundtruth is not None:
        errors = trajectory_errors(trajectory, groundtruth, alignment=_alignment(document, protocol))
        path, ate = groundtruth.path_length(), numbers.get("ate_rmse_m")
        if ate is not None and path > 0:
            numbers["ate_percent"] = _number(100.0 * ate / path)
    numbers.setdefault("map_gaussians", _number(_mapping(document.get("map")).get("gaussians")))
    return Run(
        folder=folder,
        identifier=str(document.get("id") or folder.name),
        origin=_origin(document, spec),
        status=str(document.get("status") or "unknown"),
        message=_text(document.get("message") or document.get("error")),
        method=_name(spec.get("method")) or "unknown method",
        dataset=_name(spec.get("dataset")) or "unknown dataset",
        sequence=_text(spec.get("sequence")) or _name(spec.get("dataset")) or "unknown sequence",
        seed=_integer(spec.get("seed")),
        variant=_variant(spec),
        numbers=numbers,
        document=document,
        trajectory=trajectory,
        groundtruth=groundtruth,
        errors=errors,
        keyframes=_keyframes(document),
        frames=_frames(folder / "frames.csv", warnings),
        pairs=_pairs(folder / "renders"),
        depth=_depth(folder, document),
        log_tail=_log_tail(folder / "log.txt"),
        command=_command(document, spec),
        protocol=protocol,
        true_depth=bool(_mapping(document.get("depth")).get("oracle")),
        given_poses=bool(_mapping(document.get("depth")).get("poses_given")),
        warnings=tuple(warnings),
    )


def trajectory_errors(estimate: Trajectory, truth: Trajectory, *, alignment: str = "Sim(3)") -> Errors | None:
    """Match by time, align ("Sim(3)", "SE(3)" or "none"), and give the error per pose; None under three matches."""
    mine, theirs = match_times(estimate.times, truth.times)
    if len(mine) < 3:
        return None
    est, ref = estimate.select(mine), truth.select(theirs)
    transform = Sim3(1.0, np.eye(3), np.zeros(3))
    if alignment != "none":
        transform = umeyama(est.positions, ref.positions, with_scale=alignment == "Sim(3)")
    moved = transform.apply_poses(est.T_wc)
    delta = np.swapaxes(ref.T_wc[:, :3, :3], -1, -2) @ moved[:, :3, :3]
    return Errors(
        times=est.times,
        positions=moved[:, :3, 3],
        translation=np.linalg.norm(moved[:, :3, 3] - ref.positions, axis=1),
        rotation=np.degrees(np.linalg.norm(so3_log(delta), axis=1)),
        alignment=alignment,
        transform=transform,
    )


def match_times(times: Array, reference: Array) -> tuple[np.ndarray, np.ndarray]:
    """Indices into ``times`` and ``reference`` of mutual partners within the tolerance."""
    if len(times) == 0 or len(reference) == 0:
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    right = np.clip(np.searchsorted(reference, times), 1, max(len(reference) - 1, 1))
    right = np.minimum(right, len(reference) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(times - reference[left]) <= np.abs(times - reference[right]), left, right)
    step = float(np.median(np.diff(times))) if len(times) > 1 else 0.05
    keep = np.flatnonzero(np.abs(times - reference[nearest]) <= max(TIME_TOLERANCE * step, 1e-6))
    return keep, nearest[keep]


def _alignment(document: Mapping[str, Any], protocol: str) -> str:
    """The alignment the run was scored with: the protocol's own choice, or the one its name states."""
    for word, alignment in (("sim3", "Sim(3)"), ("se3", "SE(3)"), ("none", "none")):
        if f"align={word}" in protocol:
            return alignment
    rigid = document.get("metric") and protocol.split("+")[0] == "1.0"  # protocol 1.0 kept the scale of metric methods
    return "SE(3)" if rigid else "Sim(3)"


def _mapping(value: Any) -> dict[str, Any]:
    return dict(value) if isinstance(value, Mapping) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _number(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    return float(value) if abs(value) <= _LARGEST and math.isfinite(value) else None


def _integer(value: Any) -> int | None:
    number = _number(value)
    return None if number is None else int(value)


def _text(value: Any) -> str:
    if value is None:
        return ""
    return value if isinstance(value, str) else json.dumps(value, sort_keys=True, default=str)


def _name(value: Any) -> str:
    """A plugin's name, written either as text or as {"name": ...}."""
    if isinstance(value, Mapping):
        value = value.get("name")
    return _text(value)


def _origin(document: Mapping[str, Any], spec: Mapping[str, Any]) -> Origin:
    stated = str(document.get("origin") or spec.get("origin") or "").lower()
    if stated in ("imported", "published"):
        return "imported" if stated == "imported" else "published"
    return "imported" if _name(spec.get("method")) in ("import", "trajectory") else "measured"


def _variant(spec: Mapping[str, Any]) -> dict[str, str]:
    """The options that may tell two variants of a method apart, as short text."""
    method = _mapping(spec.get("method"))
    sources = [spec, method, _mapping(spec.get("options"))]
    found: dict[str, str] = {}
    for key in (option.name for option in run_options() if option.label is not None):
        names = ("settings", "set", "overrides") if key == "settings" else (key,)
        for source in sources:
            value = next((source[name] for name in names if source.get(name) not in (None, "", {}, [])), None)
            if value is not None:
                found[key] = _variant_text(value)
                break
    return found


def _variant_text(value: Any) -> str:
    if isinstance(value, Mapping):
        if "name" in value:
            return _text(value["name"])
        return ", ".join(f"{k}={_variant_text(v)}" for k, v in sorted(value.items()))
    if isinstance(value, (list, tuple)):
        return ", ".join(_variant_text(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else _text(value)


def _keyframes(document: Mapping[str, Any]) -> tuple[int, ...]:
    value = document.get("keyframes")
    return tuple(int(k) for k in value if _number(k) is not None) if isinstance(value, list) else ()


def _optional_tum(path: Path, warnings: list[str]) -> Trajectory | None:
    if not path.is_file() or path.stat().st_size == 0:  # empty: it failed before the first pose
        return None
    try:
        trajectory = read_tum(path)
    except (InputError, OSError) as error:
        warnings.append(str(error))
        return None
    return trajectory if len(trajectory) else None


def _frames(path: Path, warnings: list[str]) -> dict[str, Array]:
    """frames.csv as columns of numbers; text and empty cells become NaN, true/false 1/0."""
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


def _depth(folder: Path, document: Mapping[str, Any]) -> DepthPictures | None:
    def find(stem: str) -> Path | None:
        return _first(folder, stem) or _first(folder / "renders", stem)

    depth, confidence = find("depth"), find("depth_confidence")
    if depth is None and confidence is None:
        return None
    about = _mapping(document.get("depth"))
    span = [v for v in _list(about.get("range")) if _number(v) is not None]
    return DepthPictures(
        depth,
        confidence,
        name=_text(about.get("source")) or _name(_mapping(document.get("spec")).get("depth")),
        message=_text(about.get("message")),
        span=(float(span[0]), float(span[1])) if len(span) == 2 else None,
        oracle=bool(about.get("oracle")),
    )


def _log_tail(path: Path) -> str:
    if not path.is_file():
        return ""
    with path.open("rb") as stream:
        stream.seek(0, 2)
        stream.seek(max(0, stream.tell() - 32_768))
        text = stream.read().decode("utf-8", errors="replace")
    return "\n".join(text.splitlines()[-LOG_LINES:])


def _command(document: Mapping[str, Any], spec: Mapping[str, Any]) -> str:
    """The command that makes this run again: the recorded one, else built from the spec."""
    stored = document.get("command") or _mapping(document.get("provenance")).get("command")
    if isinstance(stored, str) and stored:
        return stored
    if isinstance(stored, list) and stored:
        return shlex.join(str(word) for word in stored)
    words = ["panobench", "run"]
    flat = {**_mapping(spec.get("options")), **spec}
    for key in (
        "method",
        "preset",
        "camera",
        "dataset",
        "sequence",
        "root",
        "width",
        "fov",
        "depth",
        "every",
        "max_frames",
        "holdout",
        "seed",
    ):
        value = flat.get(key)
        value = _name(value) if isinstance(value, Mapping) else value
        if value not in (None, "", [], False):
            words += [f"--{key.replace('_', '-')}", _variant_text(value)]
    settings = flat.get("settings") or flat.get("set")
    if isinstance(settings, Mapping):
        for key, value in settings.items():
            words += ["--set", f"{key}={_variant_text(value)}"]
    return shlex.join(words)
