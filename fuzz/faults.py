"""Break a small sequence in every way recordings break, run the built-in methods on it, and tell what happened.

``python fuzz/faults.py --out reports/robustness/faults.md`` writes the table; the tests hold the methods to EXPECTED.
"""

from __future__ import annotations

import argparse
import shutil
import struct
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.record import read_record
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.datasets.files.trajectory_io import write_tum
from panobench.errors import PanobenchError
from panobench.testing.sequences import TinySequence, erp_camera, rotating_pose
from panobench.types import Trajectory

Image = NDArray[Any]
METHODS = ("panogs", "sparse")
#: Statuses a run may end with. "refused": a PanobenchError before or while reading, and nothing written.
FINE, LOST, REFUSED = ("ok",), ("lost",), ("refused",)


@dataclass
class Material:
    """A sequence in memory, to be damaged and written: images (RGB or grey), times (N,), poses (N, 4, 4)."""

    images: list[Image]
    times: NDArray[np.float64]
    T_wc: NDArray[np.float64]
    suffix: str = ".png"
    frame_rows: list[str] | None = None
    truth_rows: list[str] | None = None
    exif: bytes = b""

    def write(self, folder: Path) -> None:
        """panobench's own format; ``frame_rows`` and ``truth_rows`` replace what would be right."""
        (folder / "images").mkdir(parents=True)
        h, w = self.images[0].shape[:2]
        (folder / "camera.yaml").write_text(f"model: erp\nwidth: {w}\nheight: {h}\n")
        rows = []
        for i, image in enumerate(self.images):
            name = f"images/{i:06d}{self.suffix}"
            stored = image if image.ndim == 2 else image[..., [2, 1, 0, *range(3, image.shape[2])]]
            data = bytes(cv2.imencode(self.suffix, stored)[1])
            (folder / name).write_bytes(data[:2] + self.exif + data[2:] if self.exif else data)
            rows.append(f"{self.times[i]:.6f},{name}")
        text = "\n".join(self.frame_rows if self.frame_rows is not None else rows)
        (folder / "frames.csv").write_text("time,file\n" + text + "\n")
        if self.truth_rows is not None:
            (folder / "groundtruth.tum").write_text("\n".join(self.truth_rows) + "\n")
        else:
            write_tum(folder / "groundtruth.tum", Trajectory(np.sort(self.times), self.T_wc))


Damage = Callable[[Material], None]


@dataclass(frozen=True)
class Fault:
    """what: for the table. damage: changes the material. panogs, sparse: statuses the run may end with."""

    name: str
    what: str
    damage: Damage
    panogs: tuple[str, ...] = FINE
    sparse: tuple[str, ...] = FINE
    #: What the user reads, where the input is refused.
    says: str = ""


def _images(change: Callable[[Image], Image], where: slice = slice(None)) -> Damage:
    def damage(m: Material) -> None:
        for i in range(len(m.images))[where]:
            m.images[i] = change(m.images[i])

    return damage


def _level(value: int) -> Callable[[Image], Image]:
    return lambda image: np.full_like(image, value)


def _keep(wanted: Callable[[int], bool]) -> Damage:
    """Only the frames whose number is wanted, at their own times."""

    def damage(m: Material) -> None:
        index = [i for i in range(len(m.images)) if wanted(i)]
        m.images, m.T_wc, m.times = [m.images[i] for i in index], m.T_wc[index], m.times[index]

    return damage


def _duplicate(m: Material) -> None:
    k = _middle(m)
    for i in range(k + 1, k + 4):
        m.images[i], m.T_wc[i] = m.images[k], m.T_wc[k]


def _middle(m: Material) -> int:
    return 2 * len(m.images) // 3


def _other_room(m: Material) -> None:
    size = m.images[0].shape[1]
    other = TinySequence(erp_camera(size), len(m.images), seed=99)
    for i in range(_middle(m), len(m.images)):
        m.images[i] = other.image(i)


def _motion(pose: Callable[[float], Any]) -> Damage:
    def damage(m: Material) -> None:
        source = TinySequence(erp_camera(m.images[0].shape[1]), len(m.images), pose=pose)
        m.images = [source.image(i) for i in range(len(m.images))]
        m.T_wc = np.stack([source.pose_at(float(t)) for t in source.times])

    return damage


def _rows(edit: Callable[[list[str]], None]) -> Damage:
    def damage(m: Material) -> None:
        m.frame_rows = [f"{t:.6f},images/{i:06d}{m.suffix}" for i, t in enumerate(m.times)]
        edit(m.frame_rows)

    return damage


def _backwards(rows: list[str]) -> None:
    k = len(rows) // 2
    rows[k], rows[k + 1] = rows[k + 1], rows[k]


def _same_time(rows: list[str]) -> None:
    k = len(rows) // 2
    rows[k] = rows[k - 1].split(",")[0] + "," + rows[k].split(",")[1]


def _nan_time(rows: list[str]) -> None:
    rows[3] = "nan," + rows[3].split(",")[1]


def _truth(value: str) -> Damage:
    def damage(m: Material) -> None:
        m.truth_rows = [f"{t:.6f} {value if i == 2 else 0.1 * i} 0 0 0 0 0 1" for i, t in enumerate(m.times)]

    return damage


def _sized(m: Material) -> None:
    m.images[4] = cv2.resize(m.images[4], None, fx=0.5, fy=0.5)


def _exif(m: Material) -> None:
    """A JPEG that asks to be turned by 90 degrees (orientation 6): calibrations mean the pixels as stored."""
    tiff = b"II*\0\x08\0\0\0" + struct.pack("<H", 1) + struct.pack("<HHII", 0x0112, 3, 1, 6) + b"\0\0\0\0"
    m.suffix, m.exif = ".jpg", b"\xff\xe1" + struct.pack(">H", len(tiff) + 8) + b"Exif\0\0" + tiff


def _alpha(image: Image) -> Image:
    return np.dstack([image, np.full(image.shape[:2], 7, np.uint8)])


def _nothing(m: Material) -> None:
    pass


def _still(t: float) -> Any:
    return np.eye(4)


_MID = slice(14, 15)
FAULTS = (
    Fault("clean", "nothing is wrong", _nothing),
    Fault("black", "every frame black", _images(_level(0)), LOST, LOST),
    Fault("saturated", "every frame white", _images(_level(255)), LOST, LOST),
    Fault("no-texture", "every frame the same grey", _images(_level(128)), LOST, LOST),
    Fault("black-frame", "one black frame", _images(_level(0), _MID)),
    Fault("saturated-frame", "one white frame", _images(_level(255), _MID)),
    Fault("grey-frame", "one frame without texture", _images(_level(128), _MID)),
    Fault("black-start", "the first frame is black", _images(_level(0), slice(0, 1))),
    Fault("duplicated", "one frame four times, at four times", _duplicate),
    Fault("dropped", "every third frame is missing", _keep(lambda i: i % 3 != 2)),
    Fault("gap", "two frames in a row are missing", _keep(lambda i: i not in (14, 15))),
    Fault("camera-swap", "another room from two thirds on", _other_room, LOST, LOST),
    Fault("still", "the camera never moves", _motion(_still), FINE, LOST),
    Fault("rotation", "the camera turns on the spot", _motion(rotating_pose), FINE, LOST),
    Fault("one-frame", "a single frame", _keep(lambda i: i == 0), FINE, LOST),
    Fault("two-frames", "two frames", _keep(lambda i: i < 2), FINE, LOST),
    Fault("16-bit", "16-bit images", _images(lambda i: i.astype(np.uint16) * 257)),
    Fault("grey", "single-channel images", _images(lambda i: np.asarray(cv2.cvtColor(i, cv2.COLOR_RGB2GRAY)))),
    Fault("alpha", "images with an alpha channel", _images(_alpha)),
    Fault("exif", "JPEGs that ask to be turned", _exif),
    Fault("backwards", "time goes backwards once", _rows(_backwards), REFUSED, REFUSED, "is not later than"),
    Fault("same-time", "two frames at one time", _rows(_same_time), REFUSED, REFUSED, "is not later than"),
    Fault("nan-time", "a time is NaN", _rows(_nan_time), REFUSED, REFUSED, "not a finite number"),
    Fault("nan-pose", "a true pose is NaN", _truth("nan"), REFUSED, REFUSED, "not a finite number"),
    Fault("inf-pose", "a true pose is infinite", _truth("inf"), REFUSED, REFUSED, "not a finite number"),
    Fault("resized", "one frame has another size", _sized, REFUSED, REFUSED, "the camera is"),
)  # fmt: skip
BY_NAME = {f.name: f for f in FAULTS}


def material(width: int = 128, frames: int = 21) -> Material:
    """The sound sequence: a textured box, a gentle loop."""
    source = TinySequence(erp_camera(width), frames)
    poses = np.stack([source.pose_at(float(t)) for t in source.times])
    return Material([source.image(i) for i in range(frames)], source.times.copy(), poses)


@dataclass(frozen=True)
class Outcome:
    """status: of the run, or "refused". message: of the run or the error. tracked 0..1, ate_m: None without."""

    status: str
    message: str
    tracked: float | None = None
    ate_m: float | None = None


def inflict(fault: Fault, method: str, width: int = 128, frames: int = 21, depth: str | None = None) -> Outcome:
    """Run ``method`` on the damaged sequence. Anything but a PanobenchError is raised."""
    work = Path(tempfile.mkdtemp(prefix="fault-"))
    try:
        broken = material(width, frames)
        fault.damage(broken)
        broken.write(work / "sequence")
        request = RunRequest(
            method=method, dataset="folder", root=str(work / "sequence"), width=width,
            depth=depth if method == "panogs" else None,
        )  # fmt: skip
        try:
            run = read_record(execute(request, work / "run"))
        except PanobenchError as error:
            assert not (work / "run").exists()
            return Outcome("refused", str(error).replace(str(work), ""))
        return Outcome(run.status, run.message, run.number("tracked"), run.number("ate_rmse_m"))
    finally:
        shutil.rmtree(work)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("faults", nargs="*", help="default: all")
    parser.add_argument("--out", type=Path, help="Markdown file; default: standard output")
    parser.add_argument("--width", type=int, default=128)
    options = parser.parse_args()
    lines = ["| fault | " + " | ".join(f"{m}: outcome | tracked | ATE" for m in METHODS) + " |"]
    lines.append("|---" * (1 + 3 * len(METHODS)) + "|")
    messages = []
    for fault in FAULTS:
        if options.faults and fault.name not in options.faults:
            continue
        cells = [fault.what]
        for method in METHODS:
            found = inflict(fault, method, options.width)
            expected = getattr(fault, method)
            cells.append(found.status if found.status in expected else f"**{found.status}** (expected {expected})")
            cells.append("" if found.tracked is None else f"{found.tracked:.0%}")
            cells.append("" if found.ate_m is None else f"{1e3 * found.ate_m:.1f} mm")
            if found.message:
                messages.append(f"- {fault.what}, `{method}`: {found.message}")
            print(f"{fault.name} {method}: {found}", file=sys.stderr, flush=True)
        lines.append("| " + " | ".join(cells) + " |")
    text = _HEAD.format(width=options.width, height=options.width // 2) + "\n".join(lines)
    text += "\n\nWhat the user reads:\n\n" + "\n".join(dict.fromkeys(messages)) + "\n"
    if options.out:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(text, encoding="utf-8")
    else:
        print(text)


_HEAD = """# Faulty sequences

Made by `python fuzz/faults.py`: a textured box seen in {width}x{height} over 21 frames at 10 Hz, damaged, written in
panobench's own format and run by the whole pipeline. The tests hold both methods to these outcomes. "refused": one line
says what is wrong with which file and row, and nothing is written.

"""

if __name__ == "__main__":
    main()
