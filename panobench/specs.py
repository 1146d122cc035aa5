"""Specs describe what a plugin provides. They are cheap to build and name the implementation as "module:Name".

Nothing heavy is imported until ``Spec.load()``: `panobench list` works from specs alone.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass, field
from operator import attrgetter
from typing import Any, ClassVar

from panobench.errors import UnavailableError

#: Version of the plugin contract (hooks, specs, base classes); semantic: see docs/plugins.md.
CONTRACT_VERSION = "1.1"


@dataclass(frozen=True)
class Spec:
    """The common part of all specs.

    name:           what users type; lower case, digits, '-' and '_'.
    summary:        one line for `panobench list`.
    implementation: "package.module:Name", imported on first use.
    requires:       import names that must be importable for it to run (checked without importing).
    probe:          "package.module:function" returning None when it can run here, else one line why not.
    files:          "package.module:function" returning the files beside code and data that its results depend on,
                    weights say: suites run a cell again when their content changes. It is called with a method's
                    options, a depth estimator's argument, or None.
    """

    kind: ClassVar[str] = "spec"

    name: str
    summary: str
    implementation: str
    requires: tuple[str, ...] = ()
    probe: str | None = None
    files: str | None = None

    def load(self) -> Any:
        """The implementation object. Raises UnavailableError if an import it needs is missing."""
        return load_object(self.implementation, f"{self.kind} '{self.name}'")

    def unavailable(self) -> str | None:
        """None if it can run here, else one line that says what is missing."""
        missing = [m for m in self.requires if importlib.util.find_spec(m) is None]
        if missing:
            return f"needs the Python package(s) {', '.join(missing)}"
        if self.probe:
            reason = load_object(self.probe, f"probe of {self.kind} '{self.name}'")()
            return None if reason is None else str(reason)
        return None


def load_object(path: str, what: str) -> Any:
    """Import "module:Name" or "module:Class.name". Raises UnavailableError naming ``what`` when an import fails,
    or when its source does not compile.
    """
    module, _, attribute = path.partition(":")
    try:
        return attrgetter(attribute)(importlib.import_module(module))
    except ModuleNotFoundError as error:
        raise UnavailableError(f"{what} needs the Python package '{error.name}'") from error
    except SyntaxError as error:
        place = f"{error.filename}:{error.lineno}"
        raise UnavailableError(f"{what} cannot be loaded: {type(error).__name__} at {place}: {error.msg}") from error


@dataclass(frozen=True)
class CameraSpec(Spec):
    """A camera model; the implementation is a ``Camera`` subclass."""

    kind: ClassVar[str] = "camera"


@dataclass(frozen=True)
class DatasetSpec(Spec):
    """A dataset adapter; the implementation is a ``Dataset`` subclass.

    publisher and layout are shown when the data are not found: who publishes it, what is expected where. obtain: where
    to get it, in exact words. download: "module:NAME" of a ``panobench.datasets.download.Published``, for publishers
    with an address that stays.
    camera: the kind of camera of all its sequences, "" where it depends; with it a sequence that must be converted is
    opened once, at full resolution. needs_root: False for generators. recorded: False for rendered images, into which
    nobody who carries the camera can get.
    """

    kind: ClassVar[str] = "dataset"
    publisher: str = ""
    layout: str = ""
    obtain: str = ""
    download: str | None = None
    camera: str = ""
    needs_root: bool = True
    recorded: bool = True


@dataclass(frozen=True)
class MethodSpec(Spec):
    """A SLAM or reconstruction method; the implementation is an OnlineMethod or BatchMethod subclass.

    cameras: camera kinds it accepts, in order of preference. needs: of "rgb", "imu", "depth", "poses". uses: what it
    makes use of where a sequence has it, of "imu" (contract 1.1).
    config: "module:Dataclass" with its options; presets: name -> values that differ from the defaults.
    deterministic: the same seed on the same machine gives the same answer to the bit. frame_masks: it honours
    ``Frame.mask``; for other methods what is hidden in any frame is hidden in all of them. rigs: it takes the pictures
    of several lenses with a centre each (``Frame.lenses``); other methods get them stitched to a panorama. maps: it can
    start from a saved map and gives its own; needs_map: it cannot start without one.
    """

    kind: ClassVar[str] = "method"
    cameras: tuple[str, ...] = ("erp",)
    needs: tuple[str, ...] = ("rgb",)
    colour: bool = True
    metric: bool = False
    licence: str = ""
    citation: str = ""
    install: str = ""
    config: str | None = None
    presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    deterministic: bool = True
    frame_masks: bool = False
    rigs: bool = False
    maps: bool = False
    needs_map: bool = False
    uses: tuple[str, ...] = ()
    contract: str = CONTRACT_VERSION


@dataclass(frozen=True)
class DepthSpec(Spec):
    """A depth estimator for map initialisation; the implementation is a ``DepthEstimator`` subclass.

    needs_dataset_depth: it is an oracle, and every report says so.
    argument: what follows the colon in `--depth name:ARGUMENT`, "" if it takes none.
    """

    kind: ClassVar[str] = "depth"
    needs_dataset_depth: bool = False
    argument: str = ""


@dataclass(frozen=True)
class MaskSpec(Spec):
    """A mask estimator, which finds what moves with the camera; the implementation is a ``MaskEstimator`` subclass.

    argument: what follows the colon in `--mask name:ARGUMENT`, "" if it takes none.
    """

    kind: ClassVar[str] = "mask"
    argument: str = ""


@dataclass(frozen=True)
class MetricSpec(Spec):
    """A metric; the implementation is a function ``f(MetricInput) -> Mapping[str, float | None]``.

    keys: the names it writes under ``metrics`` in run.json. better: per key "lower", "higher" or "none".
    """

    kind: ClassVar[str] = "metric"
    keys: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class StudySpec(Spec):
    """A study; the implementation is a function ``f(StudyRequest) -> StudyResult``."""

    kind: ClassVar[str] = "study"
