"""When the images of a folder were taken: by a list beside them, by their names, by EXIF, or by a rate."""

from __future__ import annotations

import datetime
import re
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.trajectory_io import Row, check_times, is_number, parse_floats, read_named_rows, time_unit
from panobench.errors import DatasetError

Array = NDArray[np.float64]
#: Images a second where nothing says so.
ASSUMED_RATE_HZ = 10.0
#: Lists of times that people keep beside their images: one time a row, or a time and an image's name.
LISTS = ("times.txt", "timestamps.txt", "times.csv", "timestamps.csv", "rgb.txt", "data.csv")
#: Digits of a stamp since 1970 between 2001 and 2100: seconds, milliseconds, microseconds, nanoseconds.
_EPOCH = (10, 13, 16, 19)
_DATE = re.compile(
    r"(?<!\d)((?:19|20)\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])"
    r"[-_.T ]{0,3}([01]\d|2[0-3])[-_.:h]?([0-5]\d)[-_.:m]?([0-5]\d)(?:[-_.,s]?(\d{6}|\d{3}|\d{2}))?(?!\d)"
)
#: A number behind a date that is nowhere larger counts pictures of one second.
_BURST = 20
_DECIMAL = re.compile(r"(?<![\d.])(\d+\.\d+)$")
_NUMBER = re.compile(r"(.*?)(\d+)$")


@dataclass(frozen=True)
class ImageTimes:
    """The images in the order of time, their times (N,) in seconds, and what they come from, for people.

    assumed: nothing says when they were taken. start: seconds on the clock of the list or the names at which ``times``
    is 0.
    """

    images: list[Path]
    times: Array
    source: str
    assumed: bool = False
    inputs: tuple[Path, ...] = ()
    start: float = 0.0


def image_times(images: list[Path], rate: float | None = None) -> ImageTimes:
    """Times of images in natural order: ``rate`` if given, else the first of a list, names, EXIF that has one for all.

    Raises DatasetError for a list of times that does not fit the images.
    """
    if rate is not None:
        return _counted(images, rate, f"{rate:g} images a second")
    listed = _listed(images)
    if listed is not None:
        return listed
    for stamps, source in ((_stamps_in_names(images), "the images' names"), (_exif(images), "EXIF")):
        if stamps is not None:
            order = sorted(range(len(images)), key=stamps.__getitem__)
            times = np.array([(stamps[i] - stamps[order[0]]) * 1e-9 for i in order])
            return ImageTimes([images[i] for i in order], times, source, start=stamps[order[0]] * 1e-9)
    why = "EXIF has whole seconds, which several images share" if exif_time(images[0]) is not None else ""
    said = f"nothing says when the images were taken: {ASSUMED_RATE_HZ:g} a second are assumed; say --rate"
    said = f"{why}: {ASSUMED_RATE_HZ:g} images a second are assumed; say --rate" if why else said
    return _counted(images, ASSUMED_RATE_HZ, said, assumed=True)


def _counted(images: list[Path], rate: float, source: str, assumed: bool = False) -> ImageTimes:
    """By the numbers in the names, so that images left out leave a gap, else by place."""
    parts = [_NUMBER.fullmatch(path.stem) for path in images]
    numbers = np.array([int(m[2]) if m and len(m[2]) < 10 else -1 for m in parts], dtype=np.int64)
    heads = {m[1] if m else None for m in parts}
    steps = np.diff(numbers)
    if len(heads) == 1 and None not in heads and (numbers >= 0).all() and len(steps) and (steps > 0).all():
        step = int(np.gcd.reduce(steps))
        if steps.max() <= 100 * step:
            return ImageTimes(images, (numbers - numbers[0]) / step / rate, source, assumed)
    return ImageTimes(images, np.arange(len(images)) / rate, source, assumed)


# -- lists -----------------------------------------------------------------------------------------------------------


def _listed(images: list[Path]) -> ImageTimes | None:
    """A list in the images' folder or above it."""
    folder = images[0].parent
    for place in (folder, folder.parent):
        for name in LISTS:
            path = place / name
            if path.is_file():
                return _read_list(path, images)
    return None


def _read_list(path: Path, images: list[Path]) -> ImageTimes:
    """Rows `time`, as many as images, or of a time and an image in any order of columns and rows; a header helps."""
    table = read_named_rows(path)
    rows = table.rows
    if not rows:
        raise DatasetError("the list of times is empty", path)
    present = _by_name(images)
    names = _name_column(rows, present)
    width = len(rows[0].fields)
    column = table.columns.time
    if column is None or column == names or column >= width:
        column = next((k for k in range(width) if k != names and is_number(rows[0].fields[k])), 0)
    for row in rows:
        if len(row.fields) <= max(column, 0 if names is None else names):
            what = "a time without an image; other rows name theirs" if names is not None else "a row without a time"
            raise DatasetError(what, path, line=row.line)
    stamps = np.array(
        [parse_floats(row, [row.fields[column]], path, "a time, or a time and an image")[0] for row in rows]
    )
    stamps = stamps * (table.columns.unit_s or time_unit(stamps, 1.0))
    if names is None:
        if width > 1 and not is_number(rows[0].fields[1]):
            raise DatasetError(f"the list names none of the images in {images[0].parent}", path)
        if len(rows) != len(images):
            raise DatasetError(f"the list has {len(rows)} times for {len(images)} images", path)
        times = stamps - stamps[0]  # what is checked is what is used: huge stamps lose their differences
        check_times(times, path, [row.line for row in rows])
        return ImageTimes(images, times, path.name, inputs=(path,), start=float(stamps[0]))
    found = [(stamp, present.get(_plain(row.fields[names]))) for stamp, row in zip(stamps, rows)]
    kept = [(stamp, image) for stamp, image in found if image is not None]
    order = sorted(range(len(kept)), key=lambda k: kept[k][0])
    times = np.array([kept[k][0] for k in order])
    start = float(times[0])
    times = times - start
    check_times(times, path)
    return ImageTimes([kept[k][1] for k in order], times, path.name, inputs=(path,), start=start)


def _by_name(images: list[Path]) -> dict[str, Path]:
    """By the file's name, and by that without its ending."""
    return {**{image.stem: image for image in images}, **{image.name: image for image in images}}


def _plain(name: str) -> str:
    return PurePosixPath(name.replace("\\", "/")).name


def _name_column(rows: list[Row], present: dict[str, Path]) -> int | None:
    """The column that names images, the last of several; None where none does.

    Numbers name images only if all do: they may be times.
    """
    found = None
    for k, field in enumerate(rows[0].fields):
        hits = sum(_plain(row.fields[k]) in present for row in rows if k < len(row.fields))
        if hits == len(rows) or (hits and not is_number(field)):
            found = k
    return found if len(rows[0].fields) > 1 else None


# -- names -----------------------------------------------------------------------------------------------------------


def _stamps_in_names(images: list[Path]) -> list[int] | None:
    """Nanoseconds from names that have a date, a stamp since 1970 or a decimal fraction; None unless all have one."""
    stems = [path.stem for path in images]
    for reader in (_dates, _epochs, _decimals):
        stamps = reader(stems)
        if stamps is not None and len(set(stamps)) == len(stamps):
            return stamps
    return None


def _decimals(stems: list[str]) -> list[int] | None:
    """Numbers with a decimal fraction, alone or at the end."""
    found = [_DECIMAL.search(stem) for stem in stems]
    if not all(match and len(match[1]) < 40 for match in found):
        return None
    return [int(Decimal(match[1]).scaleb(9)) for match in found if match]


def _epochs(stems: list[str]) -> list[int] | None:
    """The one number of each name that counts from 1970 to a day between 2001 and 2100, with decimals or without."""
    stamps = []
    for stem in stems:
        texts = [m for m in re.finditer(r"(\d+)(\.\d+)?", stem) if len(m[1]) in _EPOCH]
        values = [int(Decimal(m[0] if len(m[1]) == 10 else m[1]).scaleb(19 - len(m[1]))) for m in texts]
        values = [value for value in values if 978_307_200 * 10**9 <= value < 4_102_444_800 * 10**9]
        if len(values) != 1:
            return None
        stamps.append(values[0])
    return stamps


def _dates(stems: list[str]) -> list[int] | None:
    """Dates and times: 20230412_153012, 2023-04-12T15-30-12.345, with a fraction of a second or without.

    Numbers behind the second that are all small count pictures of a burst, and are no fractions.
    """
    found = [_DATE.search(stem) for stem in stems]
    fractions = [match[7] for match in found if match and match[7]]
    if len(fractions) > 1 and max(int(text) for text in fractions) < _BURST:
        return None
    stamps = []
    for match in found:
        if not match:
            return None
        try:
            moment = datetime.datetime(*(int(match[k]) for k in range(1, 7)), tzinfo=datetime.timezone.utc)  # type: ignore[arg-type,misc]
        except ValueError:  # 31 February
            return None
        stamps.append(int(moment.timestamp()) * 10**9 + int((match[7] or "0").ljust(9, "0")))
    return stamps


# -- EXIF ------------------------------------------------------------------------------------------------------------

_EXIF_BLOCK, _TAKEN, _FRACTION = 0x8769, 0x9003, 0x9291


def _exif(images: list[Path]) -> list[int] | None:
    """Nanoseconds from DateTimeOriginal and its fraction; None unless all images have one of their own."""
    stamps: list[int] = []
    for path in images:
        stamp = exif_time(path)
        if stamp is None:
            return None
        stamps.append(stamp)
    return stamps if len(set(stamps)) == len(stamps) else None


def exif_time(path: Path) -> int | None:
    """When a photograph was taken, in nanoseconds of the camera's clock since 1970; None if it does not say."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            block = image.getexif().get_ifd(_EXIF_BLOCK)
        taken, fraction = str(block.get(_TAKEN, "")), str(block.get(_FRACTION, "")).strip()
        moment = datetime.datetime.strptime(taken[:19], "%Y:%m:%d %H:%M:%S").replace(tzinfo=datetime.timezone.utc)
        digits = fraction[:9] if fraction.isascii() and fraction.isdecimal() else "0"
        return int(moment.timestamp()) * 10**9 + int(digits.ljust(9, "0"))
    except Exception:  # Pillow lets out whatever a damaged file leads its parsers to; then there is no time
        return None
