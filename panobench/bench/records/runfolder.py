"""Run folders are written beside their place and renamed into it, so that each is there whole or not at all."""

from __future__ import annotations

import csv
import errno
import json
import os
import shutil
import uuid
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

from panobench.errors import InputError, PanobenchError, UsageError
from panobench.reading import parse_json, read_text
from panobench.writing import TEXT, disk_full, is_disk_full, json_ready, writing

SCHEMA = 1
RUN_JSON, LOG, TRAJECTORY, GROUNDTRUTH, FRAMES, MAP = (
    "run.json",
    "log.txt",
    "trajectory.tum",
    "groundtruth.tum",
    "frames.csv",
    "map.ply",
)
RENDERS = "renders"
#: A larger run.json was not written by panobench.
MAX_RUN_JSON_BYTES = 64 << 20


class PendingRun:
    """A run folder in the making: write below ``path``, then ``publish``.

    As a context manager it discards the folder when the block ends by an error. A full disk becomes OutputError, no
    matter which code in the block met it.
    """

    def __init__(self, target: Path, force: bool = False) -> None:
        """Raises UsageError when ``target`` is taken: by something that is no run, or by a run without ``force``.

        OutputError when it cannot be written.
        """
        self.target = Path(os.path.abspath(target))
        check_free(self.target, force)
        self.force = force
        self.path = self.target.parent / f".{self.target.name}.{os.getpid()}.{uuid.uuid4().hex[:8]}.part"
        with writing(self.target):
            self.target.parent.mkdir(parents=True, exist_ok=True)
            _sweep(self.target)
            self.path.mkdir()

    def __enter__(self) -> PendingRun:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is None:
            return
        self.discard()
        if isinstance(error, Exception) and not isinstance(error, PanobenchError) and is_disk_full(error):
            raise disk_full(self.target) from error

    def publish(self) -> Path:
        """Flush everything to the disk and rename into place. Raises UsageError if the place was taken meanwhile."""
        check_free(self.target, self.force)
        old = None
        with writing(self.target):
            _sync_tree(self.path)
            if self.target.is_dir() and any(self.target.iterdir()):
                old = self.path.with_suffix(".old")
                os.rename(self.target, old)
            os.rename(self.path, self.target)
            _sync(self.target.parent)
        if old is not None:
            shutil.rmtree(old, ignore_errors=True)
        return self.target

    def discard(self) -> None:
        shutil.rmtree(self.path, ignore_errors=True)


def check_free(target: Path, force: bool) -> None:
    """Raise UsageError unless a run may be put at ``target`` (free, empty, or a run to be replaced).

    Raises OutputError when it cannot be read.
    """
    with writing(target):
        if not target.exists():
            return
        if not target.is_dir():
            raise UsageError(f"{target}: is a file; give a folder for the run")
        if not any(target.iterdir()):
            return
    if not (target / RUN_JSON).is_file():
        raise UsageError(f"{target}: is not empty and not a run folder; give another folder")
    if not force:
        raise UsageError(f"{target}: a run is already there; give another folder, or --force to replace it")


def _sweep(target: Path) -> None:
    """Remove what runs to the same place left behind when their process was killed."""
    for path in target.parent.glob(f".{_glob_literal(target.name)}.*.part"):
        owner = path.name[len(target.name) + 2 :].split(".")[0]
        if owner.isdigit() and not psutil.pid_exists(int(owner)):
            shutil.rmtree(path, ignore_errors=True)


def _glob_literal(name: str) -> str:
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def _sync_tree(path: Path) -> None:
    for folder, _, files in os.walk(path):
        for name in files:
            _sync(Path(folder) / name)
        _sync(Path(folder))


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):  # file systems that cannot flush folders
            raise
    finally:
        os.close(handle)


def folders_with(name: str, path: Path) -> list[Path]:
    """Folders that hold a file ``name``, at or below ``path``, in order; those named .x and _x are not entered."""
    if (path / name).is_file():
        return [path]
    found: list[Path] = []
    for child in sorted(p for p in path.iterdir() if p.is_dir()):
        if not child.name.startswith((".", "_")):
            found.extend(folders_with(name, child))
    return found


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Strict JSON: NaN and infinity become null."""
    path.write_text(json.dumps(json_ready(document), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def read_run_json(folder: Path) -> dict[str, Any]:
    """run.json of a run folder. Raises InputError naming file and line when it is not usable."""
    path = folder / RUN_JSON
    if not path.exists():
        raise InputError("the file is missing; is this a run folder?", path)
    document = parse_json(read_text(path, "the run.json", MAX_RUN_JSON_BYTES), path)
    if not isinstance(document, dict) or not isinstance(document.get("status"), str):
        raise InputError("not a run: it has no status", path)
    if document.get("schema") != SCHEMA:
        raise InputError(f"schema {document.get('schema')!r}, this panobench reads {SCHEMA}", path)
    return document


def write_frames(path: Path, rows: list[dict[str, Any]]) -> None:
    """frames.csv: the columns of the first row first, then any other columns sorted; empty where not known."""
    first = list(rows[0]) if rows else []
    columns = first + sorted({name for row in rows for name in row} - set(first))
    with path.open("w", newline="", **TEXT) as file:
        writer = csv.DictWriter(file, columns, restval="")
        writer.writeheader()
        for row in rows:
            writer.writerow({k: "" if v is None else v for k, v in row.items()})
