"""What one pass over a bag finds: stamps of the images, inertial samples, true poses, the camera."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.bags.files import BagFile, Place
from panobench.datasets.bags.images import about_image, is_empty, most_bits
from panobench.datasets.bags.messages import (
    CAMERA_INFO,
    IMAGES,
    IMU,
    POSES,
    TRANSFORM_KINDS,
    FixedTransforms,
    body_frame,
    camera_values,
    imu_row,
    pose_row,
    stamp,
)
from panobench.errors import DatasetError

Array = NDArray[np.float64]

#: A stamp of 0 beside stamps this much later was not set, s.
_UNSET_S = 3600.0
#: Images looked at to find out how many bits a camera uses of 16.
_LOOKED_AT = 9
_STATIC = "tf_static"


@dataclass(frozen=True)
class Wanted:
    """The topics that are read; None: none. ``cameras``: those of CameraInfo."""

    image: str
    imu: str | None = None
    truth: str | None = None
    cameras: tuple[str, ...] = ()


@dataclass(frozen=True)
class Rows:
    """Rows of numbers whose first is the time, in s, strictly increasing; and which frame they are of.

    late, doubled: rows that came after later ones, and those left out because another has the same time.
    """

    values: Array
    frame: str = ""
    late: int = 0
    doubled: int = 0


@dataclass(frozen=True)
class Contents:
    """places: of the images, in the order of ``times``. size: (w, h). bits: used of 16, where pixels have 16.

    cameras: topic of a CameraInfo -> its values. left_out: images without pixels, or without a stamp beside others.
    by_receipt: no image has a stamp, so that the times are when they were received.
    """

    places: list[Place]
    times: Array
    size: tuple[int, int]
    frame: str
    bits: int = 16
    imu: Rows = field(default_factory=lambda: Rows(np.zeros((0, 7))))
    truth: Rows = field(default_factory=lambda: Rows(np.zeros((0, 8))))
    cameras: dict[str, dict[str, Any]] = field(default_factory=dict)
    fixed: FixedTransforms = field(default_factory=FixedTransforms)
    late: int = 0
    doubled: int = 0
    left_out: int = 0
    by_receipt: bool = False

    def remarks(self) -> list[str]:
        """What was unusual about the images' stamps."""
        said = []
        if self.by_receipt:
            said.append("the images have no stamps; the times at which the recorder received them are used")
        if self.late:
            said.append(f"{_images(self.late)} out of time order: all are sorted by their stamps")
        if self.doubled:
            said.append(f"{_images(self.doubled)} left out: another one has the same stamp")
        if self.left_out:
            said.append(f"{_images(self.left_out)} left out: no pixels or no stamp")
        if self.bits < 16:
            said.append(f"the images use {self.bits} of 16 bits; the brightest value of these is white")
        return said


def _images(count: int) -> str:
    return "1 image is" if count == 1 else f"{count} images are"


def read_contents(bag: BagFile, wanted: Wanted) -> Contents:
    """One pass over the bag, remembered: it takes seconds, and a bag is often opened at several widths.

    Raises DatasetError for topics that are missing or of another type, and for images that cannot be read.
    """
    versions = tuple((p.stat().st_size, p.stat().st_mtime_ns) for p in bag.files)
    return _contents(bag.path, versions, wanted)


@lru_cache(maxsize=2)
def _contents(path: Path, versions: tuple[tuple[int, int], ...], wanted: Wanted) -> Contents:
    """versions: size and time of change of each file, so that a bag that changed is read again."""
    bag = BagFile(path)
    images = _Images(path)
    rows: dict[str, list[tuple[float, ...]]] = {}
    frames: dict[str, str] = {}
    cameras: dict[str, dict[str, Any]] = {}
    fixed = FixedTransforms()
    for record in bag.records(_topics(bag, wanted)):
        topic, kind = record.topic, record.kind
        if topic == wanted.image:
            images.add(bag.parse(record, images.count), record.place)
        elif kind in TRANSFORM_KINDS:
            fixed.add(bag.parse(record, 0))
        elif kind == CAMERA_INFO:
            if topic not in cameras:
                camera = camera_values(bag.parse(record, 0))
                cameras |= {} if camera is None else {topic: camera}
        else:
            found = rows.setdefault(topic, [])
            message = bag.parse(record, len(found))
            if topic not in frames:
                frames[topic] = body_frame(message) if kind in POSES else str(message.header.frame_id).lstrip("/")
            time, *values = imu_row(message) if kind in IMU else pose_row(message)
            found.append((time or 1e-9 * record.place.received, *values))

    def table(topic: str | None, columns: int) -> Rows:
        return _checked_rows(rows.get(topic or "", []), columns, topic or "", frames.get(topic or "", ""), path)

    order, times, counts = images.in_order()
    return Contents(
        [images.places[k] for k in order],
        times,
        images.size,
        images.frame,
        _bits(bag, wanted.image, [images.places[k] for k in order], images.deep),
        table(wanted.imu, 7),
        table(wanted.truth, 8),
        cameras,
        fixed,
        **counts,
    )


def _topics(bag: BagFile, wanted: Wanted) -> set[str]:
    bag.need(wanted.image, IMAGES)
    topics = {wanted.image}
    for topic, kinds in ((wanted.imu, IMU), (wanted.truth, POSES)):
        if topic is not None:
            bag.need(topic, kinds)
            topics.add(topic)
    fixed = {name for name, t in bag.topics.items() if t.kind in TRANSFORM_KINDS and name.endswith(_STATIC)}
    return topics | fixed | {name for name in wanted.cameras if bag.topics[name].kind == CAMERA_INFO}


class _Images:
    """Stamps and sizes of images as they come."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.count = 0
        self.empty = 0
        self.stamps: list[float] = []
        self.places: list[Place] = []
        self.size = (0, 0)
        self.frame = ""
        self.deep = False

    def add(self, message: Any, place: Place) -> None:
        index = self.count
        self.count += 1
        if is_empty(message):
            self.empty += 1
            return
        about = about_image(message, self._path, index)
        if not self.places:
            self.size, self.frame, self.deep = about.size, str(message.header.frame_id).lstrip("/"), about.deep
        if about.size != self.size:
            raise DatasetError(
                f"the image is {about.size[0]}x{about.size[1]} pixels, the first one is {self.size[0]}x{self.size[1]}",
                self._path,
                frame=index,
            )
        self.stamps.append(stamp(message))
        self.places.append(place)

    def in_order(self) -> tuple[list[int], Array, dict[str, Any]]:
        """Indices by increasing time, these times, and what was counted. Raises DatasetError if there is no image."""
        if not self.places:
            raise DatasetError("the topic of images has no image", self._path)
        times = np.array(self.stamps)
        by_receipt = not times.any()
        if by_receipt:
            times = 1e-9 * np.array([place.received for place in self.places], dtype=np.float64)
        unset = (times == 0) & (np.median(times) > _UNSET_S)
        usable = np.flatnonzero(~unset)
        late = int((~_increasing(times[usable])[0]).sum())
        order = usable[np.argsort(times[usable], kind="stable")]
        new = np.concatenate([[True], np.diff(times[order]) > 0])
        doubled = int((~new).sum())
        counts = {
            "late": late - int(_increasing(times[usable])[1]),
            "doubled": doubled,
            "left_out": int(unset.sum()) + self.empty,
            "by_receipt": by_receipt,
        }
        return [int(k) for k in order[new]], times[order[new]], counts


def _increasing(times: Array) -> tuple[NDArray[np.bool_], int]:
    """Whether entries are later than all before them; and how many of the others equal the latest before them."""
    keep = np.ones(len(times), dtype=bool)
    if len(times) < 2:
        return keep, 0
    latest = np.maximum.accumulate(times)[:-1]
    keep[1:] = times[1:] > latest
    return keep, int((times[1:] == latest).sum())


def _checked_rows(rows: list[tuple[float, ...]], columns: int, topic: str, frame: str, path: Path) -> Rows:
    """Rows as a table in the order of time, one for each. A quaternion ends a row of 8 columns."""
    table = np.array(rows, dtype=np.float64).reshape(-1, columns)
    bad = ~np.isfinite(table).all(axis=1)
    if columns == 8:
        with np.errstate(over="ignore"):
            bad |= ~(np.abs(np.linalg.norm(table[:, 4:8], axis=1) - 1) <= 0.05)
    if bad.any():
        raise DatasetError(f"a message of '{topic}' holds NaN or no rotation", path, frame=int(np.argmax(bad)))
    if not len(table):
        return Rows(table, frame)
    keep, equal = _increasing(table[:, 0])
    order = np.argsort(table[:, 0], kind="stable")
    new = np.concatenate([[True], np.diff(table[order, 0]) > 0])
    return Rows(table[order[new]], frame, int((~keep).sum()) - equal, int((~new).sum()))


def _bits(bag: BagFile, topic: str, places: list[Place], deep: bool) -> int:
    """How many bits the images use of 16: sensors have 10, 12 or 14."""
    if not deep:
        return 16
    brightest = max(_brightest(bag, topic, places))
    return next((bits for bits in (8, 10, 12, 14) if brightest <= bits), 16)


def _brightest(bag: BagFile, topic: str, places: list[Place]) -> Iterator[int]:
    for index in np.unique(np.linspace(0, len(places) - 1, _LOOKED_AT).astype(int)):
        yield most_bits(bag.parse(bag.at(topic, places[index]), int(index)), bag.path, int(index))
