"""What one run is asked to do: plain values, the same from the command line, a suite cell or a worker's file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from panobench.errors import UnknownNameError, UsageError

DEFAULT_DATASET, DEFAULT_SEQUENCE = "rooms", "room1"


@dataclass(frozen=True)
class RunRequest:
    """One run. None means the default of the dataset or method.

    camera: "KIND" or "KIND:VARIANT" as `--camera` takes it; fov: degrees, as `--fov` takes it.
    every: use each n-th frame. holdout: each n-th frame used is tracked, never mapped (0: none).
    depth: "NAME" or "NAME:ARGUMENT" of a depth estimator. settings: what `--set` changes in the method's options.
    """

    method: str = "panogs"
    camera: str = "erp"
    dataset: str = DEFAULT_DATASET
    sequence: str | None = None
    root: str | None = None
    width: int | None = 512
    fov: str | None = None
    depth: str | None = None
    every: int = 1
    max_frames: int | None = None
    holdout: int = 0
    seed: int = 0
    preset: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, low in (("every", 1), ("max_frames", 1), ("holdout", 0), ("seed", 0), ("width", 16)):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < low):
                raise UsageError(f"{_option(name)} {value}: must be a whole number of at least {low}")
        if self.holdout == 1:
            raise UsageError("--holdout 1: every frame would be held out and nothing mapped; use 2 or more")
        if self.dataset == DEFAULT_DATASET and self.sequence is None:
            object.__setattr__(self, "sequence", DEFAULT_SEQUENCE)

    def to_dict(self) -> dict[str, Any]:
        return {**asdict(self), "settings": dict(self.settings)}

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
        for f in fields(self):
            value = getattr(self, f.name)
            if f.name in ("settings", "preset", "depth", "fov", "root", "sequence") and not value:
                continue
            if f.name == "settings":
                for key, setting in value.items():
                    words += ["--set", f"{key}={_word(setting)}"]
            elif value is not None and not (f.name in ("every", "holdout") and value == f.default):
                words += [_option(f.name), str(value)]
        return words + (["--out", out] if out else [])


def _option(name: str) -> str:
    return "--" + name.replace("_", "-")


def _word(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, (list, tuple)) else str(value)
