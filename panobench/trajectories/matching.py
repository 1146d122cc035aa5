"""Which frame each pose of a file belongs to, and what is wrong where most belong to none."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.base import FrameSequence
from panobench.datasets.files.trajectory_match import nearest
from panobench.errors import InputError
from panobench.trajectories.posed import PoseList
from panobench.trajectories.reading import UNITS
from panobench.types import Trajectory

Array = NDArray[np.float64]
#: Where fewer poses find a frame, and another reading of their times would place more, that reading is offered.
_FEW = 0.5


@dataclass(frozen=True)
class Placed:
    """The poses that belong to frames. index (M,): frames, increasing. poses: how many the file has.

    remarks: one line each on what was assumed, and on poses that belong to no frame.
    """

    trajectory: Trajectory
    index: NDArray[np.intp]
    poses: int
    remarks: tuple[str, ...] = ()

    @property
    def unplaced(self) -> int:
        return self.poses - len(self.index)

    def counts(self) -> str:
        """ "3 of 24 poses belong to no frame"."""
        return f"{self.unplaced} of {self.poses} poses belong to no frame"


@dataclass(frozen=True)
class Frames:
    """What poses are matched to: times (N,), names where frames are files, and numbers (N,) in the whole recording.

    whole: how many frames that has; the frames may be every second of them. start: seconds on the recorder's clock at
    which ``times`` is 0.
    """

    times: Array
    names: Sequence[str] | None = None
    numbers: NDArray[np.int64] | None = None
    whole: int | None = None
    start: float = 0.0

    def __len__(self) -> int:
        return len(self.times)

    @classmethod
    def of(cls, sequence: FrameSequence) -> Frames:
        """Of a sequence, or of frames chosen from one."""
        original = getattr(sequence, "original", lambda i: i)
        numbers = np.array([original(i) for i in range(len(sequence))], dtype=np.int64)
        names = [sequence.frame_name(i) for i in range(len(sequence))]
        counted = all(name == f"{number:06d}" for name, number in zip(names, numbers))
        whole = getattr(sequence, "whole", len(sequence))
        return cls(
            np.asarray(sequence.times, dtype=np.float64),
            None if counted else names,
            numbers,
            whole,
            sequence.start_time,
        )

    def clock_shift(self, stamps: Array) -> float:
        """Seconds to add to stamps (M,) of the recorder's clock to count them as ``times`` are; 0.0 for others.

        They are taken to be of that clock where only then they and the frames have times in common.
        """

        def meet(shift: float) -> bool:
            return bool(stamps[0] + shift <= self.times[-1] and stamps[-1] + shift >= self.times[0])

        return -self.start if meet(-self.start) and not meet(0.0) else 0.0

    def numbered(self, numbers: NDArray[np.int64]) -> tuple[NDArray[np.intp], int]:
        """The frame of each number, -1 for none, and whether numbers count from 0 or from 1.

        Numbers that are all within the frames count these, else the frames of the whole recording.
        """
        low, high, step = (
            int(numbers.min()),
            int(numbers.max()),
            int(np.gcd.reduce(np.diff(np.sort(numbers)), initial=0)),
        )
        own = high <= len(self) or self.numbers is None
        count = len(self) if own or self.whole is None else self.whole
        if low == 0 or high > count:
            first = 0
        elif high == count or low == 1 or step < 2:
            first = 1
        else:  # each sixth frame is 6, 12, ... counted from 0 and 7, 13, ... counted from 1
            first = 1 if low % step == 1 else 0
        table = np.arange(len(self)) if own or self.numbers is None else self.numbers
        place = np.clip(np.searchsorted(table, numbers - first), 0, len(table) - 1)
        return np.where(table[place] == numbers - first, place, -1).astype(np.intp), first


def place(
    found: PoseList, frames: Frames, path: Path, *, time_offset: float = 0.0, max_dt: float | None = None
) -> Placed:
    """Match poses to frames by what the file has: names, numbers or times.

    ``time_offset``: seconds added to its times. ``max_dt``: seconds between a pose and its frame at most; None: 40% of
    the smallest interval between frames. Raises InputError if none belongs to a frame, if two belong to one, or if so
    few do that the times must be meant otherwise.
    """
    remarks: list[str] = []
    if found.names is not None:
        index, remarks = _by_name(found.names, frames, path)
    elif found.numbers is not None:
        index = _by_number(found, frames, path)
    else:
        assert found.times is not None
        shift = time_offset + frames.clock_shift(found.times + time_offset)
        index = _by_time(found, frames, path, shift, max_dt)
    chosen = np.flatnonzero(index >= 0)
    order = chosen[np.argsort(index[chosen], kind="stable")]
    rows = index[order]
    twice = np.flatnonzero(np.diff(rows) == 0)
    if len(twice):
        a, b = (_called(found, int(order[k])) for k in (twice[0], twice[0] + 1))
        raise InputError(
            f"{a} and {b} belong to the same frame; keep one camera's poses", path, frame=int(rows[twice[0]])
        )
    placed = Placed(Trajectory(frames.times[rows].copy(), found.T_wc[order].copy()), rows, len(found))
    if placed.unplaced:
        remarks = [*remarks, placed.counts()]
    return Placed(placed.trajectory, rows, len(found), (*found.remarks, *remarks))


def _called(found: PoseList, k: int) -> str:
    if found.names is not None:
        return f"'{found.names[k]}'"
    return f"pose {k}" if found.numbers is None else f"number {found.numbers[k]}"


# -- times -----------------------------------------------------------------------------------------------------------


def tolerance(times: Array, max_dt: float | None) -> float:
    """Seconds that a pose may be away from its frame."""
    if max_dt is not None:
        return max_dt
    return 0.4 * float(np.diff(times).min()) if len(times) > 1 else 1.0


def _by_time(found: PoseList, frames: Frames, path: Path, offset: float, max_dt: float | None) -> NDArray[np.intp]:
    assert found.times is not None
    allowed = tolerance(frames.times, max_dt)
    index = _nearest_frames(found.times + offset, frames.times, allowed)
    matched = int((index >= 0).sum())
    if matched < max(_FEW * min(len(found), len(frames)), 1):
        reading = _other_reading(found.times, frames.times, matched, allowed)
        spans = f"its times are {_span(found.times + offset)}, the frames' {_span(frames.times)} s"
        if reading:
            count = f"{len(found) - matched} of {len(found)} poses belong to no frame"
            raise InputError(f"{count}: {spans}; {reading}", path)
        if not matched:
            raise InputError(
                f"none of its {len(found)} poses is within {allowed:.3g} s of a frame: {spans}; shift them with "
                "--time-offset, or say what they count with --time-unit",
                path,
            )
    return index


def _span(times: Array) -> str:
    return f"{times[0]:.9g} to {times[-1]:.9g}"


def _nearest_frames(stamps: Array, times: Array, allowed: float) -> NDArray[np.intp]:
    """The frame of each stamp, -1 for none; a frame has the stamp nearest to it alone."""
    index = nearest(times, stamps)
    distance = np.abs(times[index] - stamps)
    order = np.lexsort((distance, index))
    first = np.ones(len(order), dtype=bool)
    first[1:] = index[order][1:] != index[order][:-1]
    keep = np.zeros(len(stamps), dtype=bool)
    keep[order[first]] = True
    return np.where(keep & (distance <= allowed), index, -1)


def _other_reading(stamps: Array, times: Array, matched: int, allowed: float) -> str:
    """What the times look like if they are no seconds of the frames' clock, and what to do; "" for nothing better."""
    whole = bool((stamps == np.rint(stamps)).all()) and stamps[0] >= 0
    if whole and stamps[-1] <= len(times) and len(stamps) > 1:
        first = "" if stamps[0] == 0 else f" (from {stamps[0]:g})"
        return f"they look like frame numbers{first}: add --time-unit frames"
    best, said = max(2 * matched, 1), ""
    for unit, seconds in UNITS.items():
        if seconds is None:
            continue
        for shift in (0.0, float(times[0] - stamps[0] * seconds)):
            count = int((_nearest_frames(stamps * seconds + shift, times, allowed) >= 0).sum())
            if count > best and count >= 0.8 * min(len(stamps), len(times)):
                best = count
                words = f"add --time-unit {unit}" if seconds != 1.0 else ""
                if shift:
                    words += f"{' ' if words else 'add '}--time-offset {shift:.9g}"
                what = {"ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}.get(
                    unit, "seconds of another clock"
                )
                said = f"they look like {what}: {words}"
    return said


# -- numbers ---------------------------------------------------------------------------------------------------------


def _by_number(found: PoseList, frames: Frames, path: Path) -> NDArray[np.intp]:
    assert found.numbers is not None
    if found.counted and len(found) != len(frames):
        raise InputError(
            f"the file has {len(found)} poses for {len(frames)} frames, and no times: say which frames they are of "
            "with --every or --max-frames",
            path,
        )
    index, _ = frames.numbered(found.numbers)
    if (index < 0).all():
        raise InputError(
            f"none of its {len(found)} poses belongs to a frame: they are numbered {found.numbers.min()} to "
            f"{found.numbers.max()}, and there are {len(frames)} frames",
            path,
        )
    return index


# -- names -----------------------------------------------------------------------------------------------------------


def _by_name(names: Sequence[str], frames: Frames, path: Path) -> tuple[NDArray[np.intp], list[str]]:
    """Frames by their files' names; where frames are no files (a video), by the numbers in the names."""
    if frames.names is not None:
        for known in _spellings(frames.names):
            index = np.array([_look_up(name, known) for name in names])
            if (index >= 0).sum() >= max(_FEW * len(names), 1):
                return index, []
    index, remark = _by_number_in_name(names, frames, path)
    return index, [remark]


def _spellings(names: Sequence[str]) -> list[Mapping[str, int]]:
    """Frame by name as it is, by its last part, and by that without its ending; ambiguous ones are left out."""
    ways = ([_clean(n) for n in names], [PurePosixPath(n).name for n in names], [PurePosixPath(n).stem for n in names])
    tables: list[Mapping[str, int]] = []
    for way in ways:
        table = {name: i for i, name in enumerate(way)}
        tables.append(table if len(table) == len(way) else {})
    return tables


def _clean(name: str) -> str:
    return str(PurePosixPath(name.replace("\\", "/")))


def _look_up(name: str, known: Mapping[str, int]) -> int:
    """By the whole name, by its last part, and by that without its ending."""
    clean = PurePosixPath(_clean(name))
    return next((known[key] for key in (str(clean), clean.name, clean.stem) if key in known), -1)


def _by_number_in_name(names: Sequence[str], frames: Frames, path: Path) -> tuple[NDArray[np.intp], str]:
    """By the numbers that end names which differ in nothing else. Raises InputError where that would be a guess."""
    parts = [re.fullmatch(r"(.*?)([0-9]+)", PurePosixPath(_clean(name)).stem) for name in names]
    like_none = f"its images ('{names[0]}', ...) are called like none of the {len(frames)} frames"
    if not all(parts) or len({m[1] for m in parts if m}) != 1:
        raise InputError(like_none, path)
    numbers = np.array([int(m[2]) if len(m[2]) < 15 else 1 << 60 for m in parts if m], dtype=np.int64)
    low, high = int(numbers.min()), int(numbers.max())
    count = len(frames)
    if high <= count and len(numbers) < 0.9 * count and high - low + 1 < 1.2 * len(numbers):
        step = max(2, round(count / (high - low + 1)))
        raise InputError(
            f"its images are numbered {low} to {high} for {count} frames: say which frames they are with --every "
            f"(perhaps {step}) or --max-frames",
            path,
        )
    index, first = frames.numbered(numbers)
    if (index >= 0).sum() < max(_FEW * len(numbers), 1):
        raise InputError(f"{like_none}, and numbered {low} to {high}", path)
    return index, f"images are matched to frames by their numbers, counted from {first}"
