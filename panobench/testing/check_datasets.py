"""Conformance of dataset adapters."""

from __future__ import annotations

import json
import tempfile
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from panobench.datasets.base import Dataset, FrameSequence
from panobench.errors import DatasetError, UnknownNameError
from panobench.specs import DatasetSpec
from panobench.testing.conformance import Checks, Options, Skipped, require, same_clean_error


class _Subject:
    def __init__(self, spec: DatasetSpec, options: Options) -> None:
        self.spec, self.options, self.cls = spec, options, spec.load()

    @cached_property
    def dataset(self) -> Dataset:
        if self.spec.needs_root and self.options.root is None:
            raise Skipped("it needs data: name a folder with --root (in tests: Options(root=...))")
        dataset: Dataset = self.cls(self.options.root)
        return dataset

    @cached_property
    def sequence(self) -> FrameSequence:
        return self.dataset.open()


def dataset_checks(spec: DatasetSpec, options: Options) -> Checks:
    """The checks of one dataset adapter."""
    s = _Subject(spec, options)
    return [
        ("implementation", lambda: _implementation(s.cls, spec)),
        ("sequence", lambda: _sequence(s.dataset, s.sequence)),
        ("images", lambda: _images(s.sequence)),
        ("truth", lambda: _truth(s.sequence)),
        ("resized", lambda: _resized(s.dataset, s.sequence)),
        ("unknown sequence", lambda: _unknown(s.dataset)),
        ("empty folder", lambda: _empty(s)),
    ]


def _implementation(cls: Any, spec: DatasetSpec) -> None:
    require(isinstance(cls, type) and issubclass(cls, Dataset), f"{spec.implementation} is not a Dataset")
    require(cls.name == spec.name, f"its name is '{cls.name}', its spec's '{spec.name}'")
    require(not spec.needs_root or spec.layout, "layout is empty: say which files are expected where")


def _sequence(dataset: Dataset, sequence: FrameSequence) -> str:
    names = dataset.sequences()
    require(names and all(isinstance(n, str) for n in names), "sequences() returns no names")
    times = np.asarray(sequence.times)
    require(times.dtype == np.float64 and times.ndim == 1 and len(times), "times is not a (N,) float64 array")
    require(np.isfinite(times).all() and (np.diff(times) > 0).all(), "times are not strictly increasing")
    json.dumps(sequence.provenance(), allow_nan=False)
    return f"{len(names)} sequence(s), the first has {len(times)} frames"


def _images(sequence: FrameSequence) -> None:
    shape = (sequence.camera.height, sequence.camera.width, 3)
    for index in sorted({0, len(sequence) // 2, len(sequence) - 1}):
        image = sequence.image(index)
        require(image.shape == shape, f"image {index} has shape {image.shape}, its camera {shape}")
        require(image.dtype == np.uint8, f"image {index} is {image.dtype}, must be uint8")
        require(np.array_equal(image, sequence.image(index)), f"image {index} differs when read again")


def _truth(sequence: FrameSequence) -> str:
    truth, depth = sequence.groundtruth, sequence.depth(0)
    if truth is not None:
        require(np.isin(truth.times, sequence.times).all(), "ground truth has times that are no frame's time")
        require(truth.T_wc.shape == (len(truth), 4, 4), f"ground truth poses have shape {truth.T_wc.shape}")
        R = truth.T_wc[:, :3, :3]
        require(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-6, "a true pose's 3x3 part is no rotation")
    if depth is not None:
        require(depth.shape == (sequence.camera.height, sequence.camera.width), f"depth has shape {depth.shape}")
        require(depth.dtype == np.float32, f"depth is {depth.dtype}, must be float32")
        require(not (depth <= 0).any(), "depth has values <= 0; unknown is NaN")
    for view in sequence.novel_views()[:2]:
        require(
            view.image.shape == (view.camera.height, view.camera.width, 3), f"novel view '{view.name}' has a bad size"
        )
    return f"ground truth: {'yes' if truth is not None else 'no'}, depth: {'yes' if depth is not None else 'no'}"


def _resized(dataset: Dataset, sequence: FrameSequence) -> None:
    width = max(8, sequence.camera.width // 2)
    small = dataset.open(dataset.sequences()[0], width=width)
    require(small.camera.width == width, f"open(width={width}) has a camera {small.camera.width} px wide")
    require(small.image(0).shape[:2] == (small.camera.height, width), "the resized image is not its camera's size")


def _unknown(dataset: Dataset) -> None:
    same_clean_error(lambda: dataset.open("no-such-sequence-here"), UnknownNameError, "opening an unknown sequence")


def _empty(s: _Subject) -> None:
    if not s.spec.needs_root:
        raise Skipped("it needs no folder")
    with tempfile.TemporaryDirectory() as folder:
        same_clean_error(lambda: s.cls(Path(folder)).sequences(), DatasetError, "sequences() of an empty folder")
        missing = Path(folder) / "missing"
        same_clean_error(lambda: s.cls(missing).sequences(), DatasetError, "sequences() of a missing folder")
