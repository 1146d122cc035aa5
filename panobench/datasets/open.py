"""How the runner and the commands open datasets: by name, root and sequence."""

from __future__ import annotations

from pathlib import Path

from panobench.datasets.base import Dataset, FrameSequence
from panobench.datasets.given import Given
from panobench.datasets.locate import locate
from panobench.errors import UnavailableError, UsageError
from panobench.plugins import registry
from panobench.specs import DatasetSpec

#: Widths outside this range are refused before anything is read.
MIN_WIDTH, MAX_WIDTH = 16, 16384


def open_dataset(name: str, root: Path | str | None = None, given: Given | None = None) -> Dataset:
    """The dataset adapter ``name`` on ``root`` (None: ``$PANOBENCH_DATA/NAME``), with the options it was ``given``.

    Raises UnknownNameError for a name that is not registered, UnavailableError if a package is missing, DatasetError if
    the data are missing, UsageError for an option that the dataset has no use for.
    """
    spec = registry().get(DatasetSpec, name)
    missing = spec.unavailable()
    if missing:
        raise UnavailableError(f"dataset '{name}' {missing}")
    where = locate(spec, root)
    cls = spec.load()
    if given is not None:
        given.check(name, getattr(cls, "takes", ()))
    dataset: Dataset = cls(where)
    if given is not None:
        dataset.given = given
    return dataset


def open_sequence(
    dataset: str,
    sequence: str | None = None,
    root: Path | str | None = None,
    width: int | None = None,
    given: Given | None = None,
) -> FrameSequence:
    """Open one sequence of a dataset, frames resized to ``width`` (None: as stored).

    ``sequence`` None: the only one or the first. Raises what ``open_dataset`` and ``Dataset.open`` raise.
    """
    if width is not None and not MIN_WIDTH <= width <= MAX_WIDTH:
        raise UsageError(f"--width {width}: must be between {MIN_WIDTH} and {MAX_WIDTH} pixels")
    return open_dataset(dataset, root, given).open(sequence, width=width)
