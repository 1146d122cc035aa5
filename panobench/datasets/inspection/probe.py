"""What a path holds, what panobench makes of it, and what a run on it costs: for `panobench probe`."""

from __future__ import annotations

import shlex
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from panobench.datasets.bags.dataset import Bag
from panobench.datasets.base import FrameSequence
from panobench.datasets.given import Given
from panobench.datasets.inspection.guess import Guess, guess
from panobench.datasets.open import open_dataset
from panobench.errors import CalibrationError, DatasetError, PanobenchError

#: Endings of files that may be a calibration or a trajectory.
_DESCRIPTIONS = (".yaml", ".yml", ".xml", ".json", ".txt", ".bin", ".csv", ".tum")


@dataclass(frozen=True)
class Cost:
    """A rough guess for one method on two cores, from measurements in reports/methods.md and reports/speed/cost.md."""

    method: str
    seconds: float
    memory_bytes: float


#: Method -> seconds a frame, and seconds and bytes more for each pixel given to it.
_COSTS = {"sparse": (0.006, 0.08e-6, 0.4e3), "panogs": (0.010, 0.56e-6, 1.7e3)}
_BASE_BYTES = 230e6


@dataclass
class Probe:
    """What was found.

    what: in words; dataset: its adapter, "" for a file that is no recording. sequence: the one described, of
    ``sequences``. size, given: (w, h) as stored and as methods get it. truth: frames that have a true pose.
    command: what to try. contents: a line for each topic of a bag. problem: why a run cannot read it as it is.
    """

    path: str
    what: str
    dataset: str = ""
    root: str = ""
    sequences: list[str] = field(default_factory=list)
    sequence: str = ""
    frames: int = 0
    duration_s: float = 0.0
    rate_hz: float | None = None
    camera: str = ""
    size: tuple[int, int] | None = None
    given: tuple[int, int] | None = None
    hidden: float = 0.0
    truth: int | None = None
    truth_scaled: bool = True
    imu_samples: int | None = None
    remarks: list[str] = field(default_factory=list)
    costs: list[Cost] = field(default_factory=list)
    command: str = ""
    contents: list[str] = field(default_factory=list)
    problem: str = ""


def probe(
    path: Path,
    *,
    dataset: str | None = None,
    sequence: str | None = None,
    width: int = 512,
    given: Given | None = None,
) -> Probe:
    """Open what is there as a run would, without decoding more than it has to. Raises PanobenchError as a run would."""
    if not path.exists():
        described = _description(path)  # calib.yaml#cam1
        if described is None:
            raise DatasetError("no such file or folder", path)
        return described
    try:
        found = Guess(dataset, path, "as named") if dataset is not None else guess(path)
    except DatasetError as error:
        described = _description(path)
        if described is None:
            raise _why_not(path, error) from None
        return described
    opened = open_dataset(found.dataset, found.root, given)
    report = Probe(str(path), found.what, found.dataset, str(found.root), opened.sequences())
    if isinstance(opened, Bag):
        report.contents = opened.contents(sequence)
    try:
        chosen = opened.open(sequence)
    except PanobenchError as error:
        if not report.contents:
            described = _description(path)  # transforms.json of a lens alone
            if described is None:
                raise
            return described
        report.problem = str(error)
    else:
        report.sequence = chosen.name
        _describe(report, chosen, width)
    report.command = _command(path, dataset, sequence, given or Given(), width)
    if report.problem and "--calibration" in report.problem and (given or Given()).calibration is None:
        report.command += " --calibration FILE"
    return report


def _describe(report: Probe, sequence: FrameSequence, width: int) -> None:
    times, camera = np.asarray(sequence.times), sequence.camera
    report.frames, report.duration_s = len(sequence), float(times[-1] - times[0]) if len(times) else 0.0
    report.rate_hz = float(1 / np.median(np.diff(times))) if len(times) > 1 else None
    report.camera, report.size = camera.kind, (camera.width, camera.height)
    # methods get panoramas unless told otherwise
    report.given = (width, width // 2) if camera.kind in ("erp", "cubemap", "fisheye", "pal") else report.size
    if camera.mask is not None:
        report.hidden = float(1 - camera.solid_angle().sum() / camera.with_mask(None).solid_angle().sum())
    truth = sequence.groundtruth
    report.truth = None if truth is None else len(truth)
    report.truth_scaled = sequence.groundtruth_scaled
    report.imu_samples = None if sequence.imu is None else len(sequence.imu.times)
    report.remarks = sequence.remarks()
    if camera.kind == "erp" and camera.width < width:
        report.remarks.append(f"the images are smaller than --width {width}; --width {camera.width} keeps their size")
    pixels = report.given[0] * report.given[1] if report.given else 0
    report.costs = [
        Cost(method, len(sequence) * (frame + pixel * pixels), _BASE_BYTES + bytes_each * pixels)
        for method, (frame, pixel, bytes_each) in _COSTS.items()
    ]


def _command(path: Path, dataset: str | None, sequence: str | None, given: Given, width: int) -> str:
    words = ["panobench", "run", "--method", "sparse", "--root", str(path)]
    words += ["--dataset", dataset] if dataset is not None else []
    words += ["--sequence", sequence] if sequence is not None else []
    for name, value in asdict(given).items():
        words += [f"--{name.replace('_', '-')}", f"{value:g}" if isinstance(value, float) else value] if value else []
    words += ["--width", str(width)] if width != 512 else []
    return shlex.join(words)


def _why_not(path: Path, error: DatasetError) -> PanobenchError:
    """Of a file that may be a calibration or a trajectory: what is wrong with it; else ``error``."""
    from panobench.cameras.calibration import inspect_calibration, is_calibration, split_choice
    from panobench.trajectories.reading import read_poses

    file, _ = split_choice(path)
    if not file.is_file() or file.suffix.lower() not in _DESCRIPTIONS:
        return error
    try:
        if is_calibration(file):
            inspect_calibration(path)
        else:
            read_poses(path)
    except PanobenchError as reason:
        return reason
    return error


def _description(path: Path) -> Probe | None:
    """A calibration or a trajectory; None for anything else."""
    from panobench.cameras.calibration import inspect_calibration, split_choice

    file, _ = split_choice(path)
    if not file.is_file() or file.suffix.lower() not in _DESCRIPTIONS:
        return None
    from panobench.trajectories.reading import read_poses

    try:
        found = inspect_calibration(path)
        camera = found.camera
        what = f"a calibration file ({found.format}): {camera.kind} {camera.width}x{camera.height}"
        command = f"panobench run --root FOLDER --calibration {shlex.quote(str(path))}"
        return Probe(str(path), what, remarks=[*found.notes], command=command)
    except CalibrationError:
        pass
    try:
        poses = read_poses(path)
    except PanobenchError:
        return None
    what = f"a trajectory ({poses.format}): {len(poses)} poses by {poses.key}"
    command = f"panobench import {shlex.quote(str(path))} --root RECORDING"
    remarks = [] if poses.scaled else ["its unit of length is arbitrary"]
    return Probe(str(path), what, remarks=remarks, command=command)
