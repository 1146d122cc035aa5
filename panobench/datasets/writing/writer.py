"""Writes the panobench sequence format: complete or not at all, and resumable.

``camera.yaml``, ``images/``, ``frames.csv`` (time, file), optional ``groundtruth.tum``, ``imu.csv``,
``depth/``, ``mask.png``, ``novel.csv`` with ``novel/``, and ``meta.json``. Everything is written under
``<name>.partial`` with a journal of finished frames and their checksums, and renamed into place at the end.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.files.checksums import sha256_bytes, sha256_file
from panobench.datasets.files.images import encode_depth, encode_image
from panobench.datasets.files.trajectory_io import rows_from_poses, tum_text
from panobench.errors import DatasetError, UsageError
from panobench.locking import lock
from panobench.types import Imu, NovelView, Trajectory
from panobench.writing import writing

FORMAT_VERSION = 1
JOURNAL = "journal.jsonl"
LOCK = ".lock"
FORMATS = ("png", "jpg")
CONTINUES = "free some space and run the command again: it continues"


@dataclass(frozen=True)
class FrameRecord:
    """A finished frame: index in the source, time, files relative to the sequence and their SHA-256."""

    index: int
    time: float
    files: dict[str, str]

    @property
    def image(self) -> str:
        return next(name for name in self.files if name.startswith("images/"))


def imu_text(imu: Imu) -> str:
    """The content of imu.csv: time in s, angular rate in rad/s, specific force in m/s^2."""
    lines = ["time,wx,wy,wz,ax,ay,az"]
    for t, w, a in zip(imu.times, imu.gyro, imu.accel):
        lines.append(",".join([f"{t:.9f}", *(f"{x:.12g}" for x in (*w, *a))]))
    return "\n".join(lines) + "\n"


def camera_yaml(camera: Camera) -> str:
    """The content of camera.yaml, which names the mask; its pixels are in mask.png."""
    import yaml

    mask = {} if camera.mask is None else {"mask": "mask.png"}
    return str(yaml.safe_dump({**camera.to_dict(), **mask}, sort_keys=False))


class SequenceWriter:
    """Writes one sequence to ``path`` frame by frame; ``add`` may be called from several threads.

    fingerprint: JSON values that say what is written. A partial folder with the same fingerprint is continued; with
    another one it is refused unless ``restart``. Raises UsageError if ``path`` exists or if another process is writing
    it. Call ``close`` if ``finish`` is not reached.
    """

    def __init__(
        self,
        path: Path,
        camera: Camera,
        *,
        image_format: str = "png",
        fingerprint: dict[str, Any] | None = None,
        restart: bool = False,
    ) -> None:
        if image_format not in FORMATS:
            raise UsageError(f"image format '{image_format}': choose one of {', '.join(FORMATS)}")
        self.path = path
        self.partial = path.with_name(path.name + ".partial")
        self.camera = camera
        self._suffix = "." + image_format
        self._lock = threading.Lock()
        self._handle: int | None = None
        self._records: dict[int, FrameRecord] = {}
        self.fingerprint = _plain(fingerprint or {})
        self._refuse_finished()
        with writing(self.partial, CONTINUES):
            self._hold()
            try:
                self._refuse_finished()  # by another process, while we waited
                if restart:
                    self._empty()
                self._open_journal({"format": FORMAT_VERSION, "what": self.fingerprint})
            except BaseException:
                self.close()
                raise

    def _refuse_finished(self) -> None:
        if self.path.exists():
            raise UsageError(f"{self.path} exists already; remove it or choose another --out")

    def _hold(self) -> None:
        """Lock the partial folder for this writer; the system releases the lock when the process ends."""
        self.partial.mkdir(parents=True, exist_ok=True)
        handle = os.open(self.partial / LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            held = lock(handle, self.partial / LOCK)
            held = held and os.path.samestat(os.fstat(handle), os.stat(self.partial / LOCK))
        except FileNotFoundError:
            held = False  # another writer has just finished with it
        if not held:
            os.close(handle)
            raise UsageError(f"{self.path} is being written by another process; wait for it or choose another --out")
        self._handle = handle

    def close(self) -> None:
        """Release the sequence; an unfinished one stays and can be continued."""
        if self._handle is None:
            return
        (self.partial / LOCK).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self.partial.rmdir()  # if nothing was written at all
        os.close(self._handle)
        self._handle = None

    def _empty(self) -> None:
        for child in self.partial.iterdir():
            if child.is_dir() and not child.is_symlink():
                shutil.rmtree(child)
            elif child.name != LOCK:
                child.unlink()

    def _open_journal(self, head: dict[str, Any]) -> None:
        journal = self.partial / JOURNAL
        if journal.is_file():
            lines = journal.read_text(encoding="utf-8").splitlines()
            if not lines or _parse(lines[0]) != head:
                raise UsageError(
                    f"{self.partial} holds an unfinished sequence made with other options; "
                    "remove it, or repeat those options to finish it"
                )
            for line in lines[1:]:
                values = _parse(line)  # the last line may be cut short by a crash
                if values is not None:
                    record = FrameRecord(values["index"], values["time"], values["files"])
                    if self._intact(record):
                        self._records[record.index] = record
            text = [json.dumps(head), *(_record_line(r) for r in self._records.values())]
            replacement = self.partial / (JOURNAL + ".new")
            replacement.write_text("\n".join(text) + "\n", encoding="utf-8")
            os.replace(replacement, journal)
        else:
            if any(child.name != LOCK for child in self.partial.iterdir()):
                raise UsageError(f"{self.partial} is in the way and is no unfinished sequence; remove it")
            (self.partial / "images").mkdir(parents=True)
            journal.write_text(json.dumps(head) + "\n", encoding="utf-8")

    def _intact(self, record: FrameRecord) -> bool:
        for name, checksum in record.files.items():
            path = self.partial / name
            if not path.is_file() or sha256_file(path) != checksum:
                return False
        return True

    @property
    def done(self) -> frozenset[int]:
        """Indices of the frames that were written and whose checksums match."""
        return frozenset(self._records)

    def add(
        self,
        index: int,
        time: float,
        image: NDArray[np.uint8],
        depth: NDArray[np.float32] | None = None,
    ) -> None:
        """Write one frame: RGB (H, W, 3) of the camera's size, radial depth (H, W) or None."""
        size = (self.camera.height, self.camera.width)
        if image.shape[:2] != size:
            raise ValueError(f"frame {index} is {image.shape}, the camera {size}")
        contents = {f"images/{index:06d}{self._suffix}": encode_image(image, self._suffix)}
        if depth is not None:
            contents[f"depth/{index:06d}.npy"] = encode_depth(depth)
        with writing(self.partial, CONTINUES):
            for name, data in contents.items():
                target = self.partial / name
                target.parent.mkdir(exist_ok=True)
                target.write_bytes(data)
            record = FrameRecord(index, float(time), {n: sha256_bytes(d) for n, d in contents.items()})
            with self._lock, (self.partial / JOURNAL).open("a", encoding="utf-8") as journal:
                journal.write(_record_line(record) + "\n")
                self._records[index] = record

    def finish(
        self,
        *,
        groundtruth: Trajectory | None = None,
        imu: Imu | None = None,
        novel: Iterable[NovelView] = (),
        meta: dict[str, Any] | None = None,
    ) -> Path:
        """Write the files that describe the frames and rename the folder. Raises DatasetError without a frame.

        ``novel`` views must be images of this sequence's camera.
        """
        records = sorted(self._records.values(), key=lambda r: r.index)
        if not records:
            raise DatasetError("no frame was written", self.partial)
        times = np.array([r.time for r in records])
        if (np.diff(times) <= 0).any():
            raise DatasetError("the frames' times do not increase", self.partial)
        rows = ["time,file", *(f"{r.time:.9f},{r.image}" for r in records)]
        checksums = {name: value for r in records for name, value in r.files.items()}
        texts = {"camera.yaml": camera_yaml(self.camera), "frames.csv": "\n".join(rows) + "\n"}
        if groundtruth is not None and len(groundtruth):
            texts["groundtruth.tum"] = tum_text(groundtruth)
        if imu is not None:
            texts["imu.csv"] = imu_text(imu)
        files = {name: text.encode("utf-8") for name, text in texts.items()}
        files |= self._novel_files(list(novel))
        if self.camera.mask is not None:
            files["mask.png"] = encode_image(self.camera.mask, ".png")
        checksums |= {name: sha256_bytes(data) for name, data in files.items()}
        about = {"format": FORMAT_VERSION, "what": self.fingerprint, **(meta or {})}
        if imu is not None and imu.T_body_cam is not None:
            about["body_T_cam"] = imu.T_body_cam.tolist()
        about["checksums"] = checksums
        files["meta.json"] = (json.dumps(about, indent=1) + "\n").encode()
        with writing(self.partial, CONTINUES):
            for name, data in files.items():
                (self.partial / name).parent.mkdir(exist_ok=True)
                (self.partial / name).write_bytes(data)
            (self.partial / JOURNAL).unlink()
            (self.partial / LOCK).unlink()
            os.replace(self.partial, self.path)
        self.close()
        return self.path

    def _novel_files(self, views: list[NovelView]) -> dict[str, bytes]:
        """novel.csv and the images it names; {} without views."""
        if not views:
            return {}
        files = {}
        rows = ["file,x,y,z,qx,qy,qz,qw"]
        for k, view in enumerate(views):
            if view.image.shape[:2] != (self.camera.height, self.camera.width):
                raise ValueError(f"novel view '{view.name}' is {view.image.shape}, not of the sequence's camera")
            name = f"novel/{k:03d}{self._suffix}"
            files[name] = encode_image(view.image, self._suffix)
            row = rows_from_poses(view.T_wc[None])[0]
            rows.append(",".join([name, *(f"{x:.15g}" for x in row)]))
        files["novel.csv"] = ("\n".join(rows) + "\n").encode()
        return files


def finished_as(path: Path, fingerprint: dict[str, Any]) -> bool:
    """Whether ``path`` is a finished sequence of this fingerprint whose files are unchanged.

    Raises UsageError if something else is there, DatasetError if one of its files was changed or lost.
    """
    if not path.exists():
        return False
    meta = path / "meta.json"
    values = _parse(meta.read_text(encoding="utf-8")) if meta.is_file() else None
    if not isinstance(values, dict) or values.get("what") != _plain(fingerprint):
        raise UsageError(f"{path} exists already and was made with other options; remove it or choose another --out")
    for name, checksum in values.get("checksums", {}).items():
        file = path / name
        if not file.is_file() or sha256_file(file) != checksum:
            raise DatasetError("the file changed since it was written; remove the sequence and convert again", file)
    return True


def _plain(values: dict[str, Any]) -> Any:
    """The value as JSON returns it: tuples become lists, numpy numbers are refused."""
    return json.loads(json.dumps(values))


def _record_line(record: FrameRecord) -> str:
    return json.dumps({"index": record.index, "time": record.time, "files": record.files})


def _parse(line: str) -> Any:
    try:
        return json.loads(line)
    except ValueError:
        return None


def write_sequence(
    path: Path,
    camera: Camera,
    frames: Iterable[tuple[float, NDArray[np.uint8], NDArray[np.float32] | None]],
    *,
    groundtruth: Trajectory | None = None,
    imu: Imu | None = None,
    novel: Iterable[NovelView] = (),
    meta: dict[str, Any] | None = None,
    image_format: str = "png",
) -> Path:
    """Write a whole panobench sequence: frames are (time in s, RGB, radial depth or None), times increasing.

    ``groundtruth`` holds camera-to-world poses at (some of) the frames' times. The folder appears
    complete or not at all. Raises UsageError if it exists, OutputError if it cannot be written.
    """
    writer = SequenceWriter(path, camera, image_format=image_format, restart=True)
    try:
        for index, (time, image, depth) in enumerate(frames):
            writer.add(index, time, image, depth)
        return writer.finish(groundtruth=groundtruth, imu=imu, novel=novel, meta=meta)
    except BaseException:
        shutil.rmtree(writer.partial, ignore_errors=True)
        raise
    finally:
        writer.close()
