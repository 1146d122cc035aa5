"""One planned run of a suite: what it is, and the hash of everything that could change its result."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

from panobench.bench.run.config import config_values, method_config
from panobench.bench.run.masking import choose_mask
from panobench.bench.run.request import RunRequest, run_options, run_words
from panobench.bench.run.setup import DEFAULT_DEPTH, check_kind, method_spec, open_input
from panobench.bench.suite.artifacts import artifact_checksums
from panobench.bench.suite.fingerprint import code_fingerprint, data_fingerprint, digest, environment_fingerprint
from panobench.errors import DatasetError, InputError, OutputError, PanobenchError, UnknownNameError, UsageError
from panobench.metrics.base import PROTOCOL_VERSION
from panobench.plugins import registry
from panobench.specs import CameraSpec, DatasetSpec, DepthSpec, MethodSpec, MetricSpec, Spec
from panobench.types import RunStatus


@dataclass(frozen=True)
class Limits:
    """What one run may use: wall-clock seconds, resident memory of its process tree, and number of processes."""

    timeout_s: float = 3600.0
    memory_gib: float = 8.0
    processes: int = 128

    def __post_init__(self) -> None:
        for name in ("timeout_s", "memory_gib", "processes"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 < value < math.inf:
                raise UsageError(f"option {name}: '{value}' is not a positive number")

    @property
    def memory_bytes(self) -> int:
        return int(self.memory_gib * 2**30)


@dataclass(frozen=True)
class Cell:
    """A run request with its limits; ``repeat`` tells apart runs that are asked for several times."""

    request: RunRequest
    repeat: int = 0
    limits: Limits = field(default_factory=Limits)

    @cached_property
    def identity(self) -> str:
        """Hash of what was asked for; the same for results of different versions of code or data."""
        return digest([self.request.to_dict(), self.repeat])

    @property
    def label(self) -> str:
        """The cell in words: what ``run_words`` says, and the seed."""
        repeat = [f"repeat {self.repeat}"] if self.repeat else []
        return " ".join([*run_words(self.request.to_dict()), f"seed {self.request.seed}", *repeat])

    @property
    def slug(self) -> str:
        """A folder name: readable, harmless, and unique by the identity's first digits."""
        r = self.request
        words = [r.method, r.preset or "", r.camera, r.dataset, r.sequence or "", f"s{r.seed}"]
        text = "-".join(re.sub(r"[^A-Za-z0-9_]+", "_", w) for w in words if w)
        return f"{text[:80]}-{self.identity[:8]}"

    def to_dict(self) -> dict[str, Any]:
        return {"request": self.request.to_dict(), "repeat": self.repeat, "limits": asdict(self.limits)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Cell:
        return cls(RunRequest.from_dict(values["request"]), values["repeat"], Limits(**values["limits"]))


@dataclass(frozen=True)
class Planned:
    """A cell with its key. status and message are set when it cannot run here at all."""

    cell: Cell
    key: str
    status: RunStatus | None = None
    message: str = ""


class Planner:
    """Computes the keys of cells. It remembers hashes of code and data, as most cells of a suite share them."""

    def __init__(self) -> None:
        self._data: dict[str, Any] = {}
        self._code: dict[tuple[str, ...], str] = {}

    def plan(self, cell: Cell) -> Planned:
        """The cell with its key. Raises UsageError for a mistake in the suite, which is no result, and OutputError."""
        try:
            spec = method_spec(cell.request)
            config = method_config(spec, cell.request.preset, cell.request.settings)
            data, kind = self._data_of(cell.request)
            check_kind(kind, spec)
            files = artifact_checksums(cell.request, spec, config)
        except (UsageError, OutputError):  # a mistake in the suite, or a cache that cannot be written
            raise
        except PanobenchError as error:
            return self._impossible(cell, error)
        code = self._code_of(cell.request, spec)
        parts = {
            "cell": cell.identity,
            "config": config_values(config),
            "code": code,
            "environment": environment_fingerprint(),
            "data": data,
            "protocol": PROTOCOL_VERSION,
        }
        if files:
            parts["files"] = files
        return Planned(cell, digest(parts))

    def _impossible(self, cell: Cell, error: PanobenchError) -> Planned:
        """A cell that cannot run here and now. Its key holds the reason, and changes with it."""
        # missing or broken data prevent a run as a missing package does
        status = RunStatus.UNAVAILABLE if isinstance(error, InputError) else RunStatus(error.run_status)
        return Planned(cell, digest([cell.identity, status.value, str(error)]), status, str(error))

    def _data_of(self, request: RunRequest) -> tuple[Any, str]:
        """The sequence that any method would be given (files' checksums, camera, length), and its camera's kind."""
        key = digest([getattr(request, option.name) for option in run_options() if option.changes_input])
        if key not in self._data:
            try:
                self._data[key] = self._opened(request)
            except (UsageError, OutputError):
                raise
            except PanobenchError as error:
                self._data[key] = error
        found = self._data[key]
        if isinstance(found, PanobenchError):
            raise found
        return found["data"], found["kind"]

    def _opened(self, request: RunRequest) -> dict[str, Any]:
        try:
            sequence = open_input(request)
        except UnknownNameError as error:
            # downloaded data may be incomplete, which is a result; a wrong name of built-in data is a mistake
            if "sequence" in error.kind and registry().get(DatasetSpec, request.dataset).needs_root:
                raise DatasetError(str(error)) from error
            raise
        data = {
            "provenance": data_fingerprint(sequence.provenance()),
            "camera": sequence.camera.to_dict(),
            "frames": len(sequence),
        }
        return {"data": data, "kind": sequence.camera.kind}

    def _code_of(self, request: RunRequest, spec: MethodSpec) -> str:
        known = registry()
        depth = (request.depth or DEFAULT_DEPTH).partition(":")[0]
        used: list[Spec] = [spec, known.get(DatasetSpec, request.dataset), *known.specs(MetricSpec).values()]
        used += [s for s in known.specs(CameraSpec).values() if s.name in (*spec.cameras, request.camera)]
        mask = choose_mask(request.mask, request.dataset).spec
        used += [mask] if mask is not None else []
        used += [s for s in known.specs(DepthSpec).values() if s.name == depth]
        paths = tuple(sorted({s.implementation for s in used} | ({spec.config} if spec.config else set())))
        if paths not in self._code:
            self._code[paths] = code_fingerprint(paths)
        return self._code[paths]
