"""The request for one run: plain values, whether they come from the command line, a suite or a worker's file.

``RunRequest`` is the one list of run options. Each field says by ``run_option`` what the rest of panobench has to know
about it: the command line, suites, studies, caches, comparisons, labels and reports derive from ``run_options()``.
A new option is a new field here and the code that honours it.
"""

from __future__ import annotations

import typing
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, cast

from panobench.datasets.given import Given
from panobench.errors import UnknownNameError, UsageError

T = TypeVar("T")
DEFAULT_DATASET, DEFAULT_SEQUENCE = "rooms", "room1"
DEVICES = ("auto", "cpu", "cuda")


@dataclass(frozen=True)
class RunOption:
    """One run option. name, type and default are those of the field; the rest is what ``run_option`` was told.

    help:          one line for the command line.
    changes_input: the sequence given to a method (images, times, truth) depends on it.
    label:         how labels say a value that tells two runs apart, "{} px"; the words for a switch that is on; None
                   for what is no variant of a run: the method, where and on what it ran, the seed.
    separates:     runs that differ in it are never taken for repeats of each other, nor compared.
    suite_key:     suite files have a key of its own for it; the others stand under ``options``, and studies take them.
    minimum:       the least whole number allowed.
    always_said:   the command line of a stored run names it even where it is the default.
    flag:          its name on the command line.
    import_help:   what `panobench import` says about it, if not the same. It takes the options that change the input,
                   and those that have such a text.
    """

    name: str
    type: Any
    default: Any
    help: str
    changes_input: bool
    label: str | None
    separates: bool = True
    suite_key: bool = False
    minimum: int | None = None
    always_said: bool = False
    flag: str = ""
    import_help: str = ""

    def check(self, value: Any) -> None:
        """Raises UsageError for a number that is not allowed."""
        if self.minimum is None or value is None:
            return
        if isinstance(value, bool) or not isinstance(value, int) or value < self.minimum:
            raise UsageError(f"{self.flag} {value}: must be a whole number of at least {self.minimum}")

    def words(self, value: Any) -> str:
        """A value as labels say it: "256 px"."""
        return (self.label or "{}").format(value_text(value))


def run_option(default: T, help: str, *, changes_input: bool, label: str | None, **about: Any) -> T:
    """A field of RunRequest; ``about``: further fields of RunOption."""
    metadata = {"run_option": {"help": help, "changes_input": changes_input, "label": label, **about}}
    if isinstance(default, dict):
        return cast(T, field(default_factory=default.copy, metadata=metadata))
    return cast(T, field(default=default, metadata=metadata))


@dataclass(frozen=True)
class RunRequest:
    """One run. None means the default of the dataset or method. Labels name the options in this order.

    camera: "KIND" or "KIND:VARIANT" as `--camera` takes it; fov: degrees, as `--fov` takes it.
    every: use each n-th frame. holdout: each n-th frame used is tracked, never mapped (0: none).
    depth: "NAME" or "NAME:ARGUMENT" of a depth estimator. mask: see ``bench.masking``. check: see ``bench.checking``.
    settings: what `--set` changes in the method's options.
    """

    method: str = run_option(
        "panogs",
        "Method; see `panobench list methods`.",
        changes_input=False,
        label=None,
        suite_key=True,
        always_said=True,
    )
    preset: str | None = run_option(
        None, "Preset of the method's options.", changes_input=False, label="{}", suite_key=True
    )
    camera: str = run_option(
        "erp",
        "MODEL, MODEL:VIEW (pinhole:front) or a calibration file.",
        changes_input=True,
        label="{}",
        suite_key=True,
        always_said=True,
        import_help="Camera the method used: MODEL, MODEL:VIEW or a calibration file.",
    )
    dataset: str = run_option(
        DEFAULT_DATASET,
        "Dataset; see `panobench list datasets`.",
        changes_input=True,
        label=None,
        suite_key=True,
        always_said=True,
    )
    sequence: str | None = run_option(
        None, "Sequence; default: the first.", changes_input=True, label=None, suite_key=True
    )
    root: str | None = run_option(
        None,
        "Folder or file of the data.",
        changes_input=True,
        label=None,
        separates=False,
        suite_key=True,
    )
    rate: float | None = run_option(
        None, "Images a second, for images that do not say when they were taken.", changes_input=True, label=None
    )
    calibration: str | None = run_option(
        None,
        "What took images or a bag's topic: a calibration file, FILE#CAMERA for one of several.",
        changes_input=True,
        label=None,
    )
    topic: str | None = run_option(None, "Topic of a bag's images.", changes_input=True, label=None)
    imu_topic: str | None = run_option(None, "Topic of a bag's IMU.", changes_input=True, label=None)
    groundtruth_topic: str | None = run_option(
        None, "Topic of a bag's true poses, or none.", changes_input=True, label=None
    )
    layout: str | None = run_option(
        None,
        "How pictures hold the sphere: erp, top-bottom, vr180, eac, fisheyes:190, ...; default: look.",
        changes_input=True,
        label="{}",
    )
    groundtruth: str | None = run_option(
        None,
        "True poses: a trajectory's file (TUM, KITTI, COLMAP, transforms.json, ...) in place of the dataset's own.",
        changes_input=True,
        label=None,
    )
    groundtruth_scale: str | None = run_option(
        None,
        "Unit of --groundtruth: metres, or none; default: none for COLMAP and nerfstudio.",
        changes_input=True,
        label=None,
    )
    fov: str | None = run_option(None, "Field of view in degrees: 120 or 120x60.", changes_input=True, label="{}° fov")
    depth: str | None = run_option(
        None, "First depth: NAME or NAME:ARGUMENT; default: bootstrap.", changes_input=False, label="{}"
    )
    mask: str | None = run_option(
        None,
        "What hides part of the view: auto, none, an estimator or an image file; default: auto for recordings.",
        changes_input=False,
        label="mask {}",
    )
    width: int | None = run_option(
        512,
        "Width of the images given to the method, pixels.",
        changes_input=True,
        label="{} px",
        minimum=16,
        always_said=True,
        import_help="Width of the frames, and of the renders, pixels.",
    )
    every: int = run_option(
        1,
        "Use each n-th frame.",
        changes_input=True,
        label="every {}",
        minimum=1,
        import_help="The method used each n-th frame.",
    )
    max_frames: int | None = run_option(
        None,
        "Use at most this many frames.",
        changes_input=True,
        label="{} frames",
        minimum=1,
        import_help="The method used at most this many frames.",
    )
    holdout: int = run_option(
        0,
        "Track but never map each n-th frame; 0: none.",
        changes_input=False,
        label="holdout {}",
        minimum=0,
        import_help="The method did not map each n-th frame; 0: none.",
    )
    continue_map: str | None = run_option(
        None,
        "Start from the saved map in this folder; poses are in its frame.",
        changes_input=False,
        label="on {}",
        flag="--continue",
    )
    save_map: str | None = run_option(
        None,
        "Save the map to this folder, for --continue and `panobench localize`.",
        changes_input=False,
        label=None,
        separates=False,
    )
    imu: str = run_option(
        "auto",
        "Inertial samples: auto (where the sequence has them and the method uses them), or off.",
        changes_input=False,
        label="imu {}",
    )
    check: str = run_option(
        "auto",
        "Second opinion for the verdict: a METHOD, backwards, none, or auto (where there is no ground truth).",
        changes_input=False,
        label=None,
        separates=False,
    )
    seed: int = run_option(
        0,
        "Seed of all randomness.",
        changes_input=False,
        label=None,
        separates=False,
        suite_key=True,
        minimum=0,
        always_said=True,
    )
    align_time: bool = run_option(
        False,
        "Look for a constant offset between the clocks of ground truth and frames in the motion, and apply it.",
        changes_input=True,
        label="clocks aligned",
    )
    device: str = run_option(
        "auto",
        "Where maps are computed: auto, cpu or cuda; auto: on the GPU if there is one and the method uses it.",
        changes_input=False,
        label="on {}",
    )
    settings: Mapping[str, Any] = run_option(
        {}, "One option of the method; repeatable.", changes_input=False, label="{}", suite_key=True, flag="--set"
    )

    def __post_init__(self) -> None:
        self.given()  # its options are checked
        if self.imu not in ("auto", "off"):
            raise UsageError(f"--imu {self.imu}: must be auto or off")
        for option in run_options(type(self)):
            option.check(getattr(self, option.name))
        if self.device not in DEVICES:
            raise UnknownNameError("--device", self.device, DEVICES)
        if self.holdout == 1:
            raise UsageError("--holdout 1: every frame would be held out and nothing mapped; use 2 or more")
        if self.dataset == DEFAULT_DATASET and self.sequence is None:
            object.__setattr__(self, "sequence", DEFAULT_SEQUENCE)

    def resolved(self) -> tuple[RunRequest, str]:
        """The request with the dataset that reads its root, where it names no dataset, and what was found, in words.

        "" if there was nothing to find. Raises DatasetError for a root that no dataset reads.
        """
        if self.root is None or self.dataset != DEFAULT_DATASET:
            return self, ""
        from panobench.datasets.inspection.guess import guess

        found = guess(Path(self.root).expanduser())
        sequence = None if self.sequence == DEFAULT_SEQUENCE else self.sequence
        return replace(self, dataset=found.dataset, root=str(found.root), sequence=sequence), found.what

    def given(self) -> Given:
        """The options that go to the dataset. Raises UsageError for one that makes no sense."""
        return Given(self.rate, self.calibration, self.topic, self.imu_topic, self.groundtruth_topic, self.layout)

    def to_dict(self) -> dict[str, Any]:
        """Plain values by name."""
        values = {option.name: getattr(self, option.name) for option in run_options(type(self))}
        return {k: dict(v) if isinstance(v, Mapping) else v for k, v in values.items()}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> RunRequest:
        """Inverse of ``to_dict``. Raises UnknownNameError for a key it does not have."""
        known = [f.name for f in fields(cls)]
        for key in values:
            if key not in known:
                raise UnknownNameError("run option", key, known)
        return cls(**values)

    def command(self, out: str | None = None) -> list[str]:
        """The command line that makes this run again."""
        words = ["panobench", "run"]
        for option in run_options(type(self)):
            value = getattr(self, option.name)
            if value in (None, "") or (value == option.default and not option.always_said):
                continue
            if option.type is bool:
                words.append(option.flag)
                continue
            given = [f"{k}={_word(v)}" for k, v in value.items()] if isinstance(value, Mapping) else [str(value)]
            for text in given:
                words += [option.flag, text]
        return words + (["--out", out] if out else [])


def run_options(request: type | None = None) -> tuple[RunOption, ...]:
    """Every run option, in the order of labels and of the command line."""
    return _run_options(request or RunRequest)


@lru_cache(maxsize=4)
def _run_options(request: type) -> tuple[RunOption, ...]:
    hints = typing.get_type_hints(request)
    found = []
    for f in fields(request):
        default = f.default if f.default is not MISSING else cast(Any, f.default_factory)()
        about = {"flag": "--" + f.name.replace("_", "-"), **f.metadata["run_option"]}
        found.append(RunOption(f.name, hints[f.name], default, **about))
    return tuple(found)


def run_words(values: Mapping[str, Any]) -> list[str]:
    """A run's options in words, without defaults: method[preset, settings], camera, others, dataset/sequence."""
    settings = values.get("settings") or {}
    chosen = [values["preset"]] if values.get("preset") else []
    chosen += [f"{k}={v}" for k, v in settings.items()]
    method = f"{values['method']}[{', '.join(chosen)}]" if chosen else values["method"]
    others = [
        option.words(value)
        for option in run_options()
        if option.label is not None
        and option.name not in ("preset", "settings", "camera")
        and (value := values.get(option.name)) not in (None, "", option.default)
    ]
    place = f"{values['dataset']}/{values['sequence']}" if values.get("sequence") else values["dataset"]
    return [method, values["camera"], *others, place]


def value_text(value: Any) -> str:
    """A value as short text; of settings "a=1, b=2"."""
    if isinstance(value, Mapping):
        return ", ".join(f"{k}={value_text(v)}" for k, v in sorted(value.items()))
    if isinstance(value, (list, tuple)):
        return ", ".join(value_text(v) for v in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def _word(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
