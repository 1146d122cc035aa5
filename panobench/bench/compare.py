"""Compare two sets of runs and judge rules such as "ate>5%": a gate against regressions."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from panobench.bench.request import run_options
from panobench.bench.runfolder import RUN_JSON, read_run_json
from panobench.bench.statistics import Change, change
from panobench.errors import InputError, UnknownNameError, UsageError

#: Short names for rules -> where the number is in run.json, and its unit when shown.
NAMES = {
    "ate": "ate_rmse_m",
    "ate_keyframes": "ate_keyframes_rmse_m",
    "rpe": "rpe_trans_rmse_m",
    "tracked": "tracked",
    "psnr": "psnr_db",
    "ssim": "ssim",
    "lpips": "lpips",
    "pano_psnr": "pano_psnr_db",
    "ws_psnr": "ws_psnr_db",
    "holdout_psnr": "holdout_psnr_db",
    "novel_psnr": "novel_psnr_db",
    "fps": "fps",
    "tracking_fps": "tracking_fps",
    "latency": "latency_p95_s",
    "memory": "peak_rss_bytes",
}
_RULE = re.compile(r"\s*(any:)?\s*([a-z_0-9]+)\s*([<>])\s*([0-9.]+(?:e-?[0-9]+)?)\s*(%?)\s*$")
#: Beyond it sums and squares overflow; nothing that is measured comes near.
_LARGEST = 1e100


@dataclass(frozen=True)
class Rule:
    """ "ate>5%": it is broken when the number grew by more than 5 percent; "<": when it fell by more.

    Without % the amount is in the number's own unit. each: judged for every sequence, not for the mean over them.
    """

    text: str
    key: str
    falls: bool
    amount: float
    relative: bool
    each: bool

    @classmethod
    def parse(cls, text: str) -> Rule:
        """Raises UsageError or UnknownNameError."""
        match = _RULE.match(text)
        if match is None:
            raise UsageError(f"--fail-on '{text}': expected NAME>AMOUNT[%] or NAME<AMOUNT[%], such as 'ate>5%'")
        each, name, sign, amount, percent = match.groups()
        key = NAMES.get(name, name)
        if key not in NAMES.values():
            raise UnknownNameError("number for --fail-on", name, NAMES)
        try:
            value = float(amount)
        except ValueError:
            raise UsageError(f"--fail-on '{text}': '{amount}' is not a number") from None
        return cls(text.strip(), key, sign == "<", value / 100 if percent else value, bool(percent), bool(each))

    def exceeded(self, found: Change) -> bool:
        """More than allowed in the rule's direction, and beyond noise."""
        return (-found.value if self.falls else found.value) > self.amount and found.beyond_noise()


@dataclass
class Group:
    """Runs of one cell, seeds and repeats joined."""

    label: str
    runs: list[dict[str, Any]] = field(default_factory=list)

    @property
    def failed(self) -> list[dict[str, Any]]:
        return [r for r in self.runs if r["status"] != "ok"]

    def numbers(self, key: str) -> list[float]:
        """Of the repeats that went well and have the number."""
        found = []
        for run in self.runs:
            value = {**_mapping(run.get("metrics")), **_mapping(run.get("timing"))}.get(key)
            if run["status"] != "ok" or not isinstance(value, (int, float)) or isinstance(value, bool):
                continue
            if abs(value) <= _LARGEST:
                found.append(float(value))
        return found


@dataclass(frozen=True)
class Verdict:
    """One rule judged on one cell or on all (label ""). change is None when there was nothing to compare."""

    rule: Rule
    label: str
    change: Change | None
    broken: bool


@dataclass
class Comparison:
    """verdicts; cells that were ok and fail now; cells only one side has; numbers per cell for showing."""

    verdicts: list[Verdict]
    new_failures: list[str]
    only_base: list[str]
    only_new: list[str]
    cells: list[tuple[str, Group, Group]]

    @property
    def regression(self) -> bool:
        return bool(self.new_failures) or any(v.broken for v in self.verdicts)

    @property
    def unjudged(self) -> list[str]:
        """Rules that no cell could be judged by: a gate that stays open whatever happens."""
        judged = {v.rule.text for v in self.verdicts if v.change is not None}
        return [text for text in dict.fromkeys(v.rule.text for v in self.verdicts) if text not in judged]


def load_runs(path: Path) -> list[dict[str, Any]]:
    """Every run.json at or below ``path``, hidden and _folders left out. Raises InputError if damaged or none."""
    return [read_run_json(folder) for folder in run_folders(path)]


def run_folders(path: Path) -> list[Path]:
    """Run folders at or below ``path``, sorted. Raises InputError when there is none."""
    if not path.exists():
        raise InputError("no such file or folder", path)
    folders = sorted(_run_folders(path))
    if not folders:
        raise InputError("no run.json here or below", path)
    return folders


def _run_folders(path: Path) -> Iterable[Path]:
    if (path / RUN_JSON).is_file():
        yield path
    elif path.is_dir():
        for child in path.iterdir():
            if not child.name.startswith((".", "_")):
                yield from _run_folders(child)


def compare(base: list[dict[str, Any]], new: list[dict[str, Any]], rules: Iterable[Rule]) -> Comparison:
    """Raises InputError when no cell is on both sides."""
    with_method = _methods(base) & _methods(new) or len(_methods(base)) > 1 or len(_methods(new)) > 1
    left, right = _groups(base, bool(with_method)), _groups(new, bool(with_method))
    both = [key for key in left if key in right]
    if not both:
        raise InputError("the two sets of runs have no cell in common (same method, options and sequence)")
    cells = [(left[key].label, left[key], right[key]) for key in both]
    verdicts = [verdict for rule in rules for verdict in _judge(rule, cells)]
    return Comparison(
        verdicts,
        [label for label, b, n in cells if len(n.failed) / len(n.runs) > len(b.failed) / len(b.runs)],
        [left[key].label for key in left if key not in right],
        [right[key].label for key in right if key not in left],
        cells,
    )


def _judge(rule: Rule, cells: list[tuple[str, Group, Group]]) -> list[Verdict]:
    pairs = [(label, b.numbers(rule.key), n.numbers(rule.key)) for label, b, n in cells]
    if rule.each:
        found = [(label, change([b], [n], relative=rule.relative)) for label, b, n in pairs]
    else:
        found = [("", change([b for _, b, _ in pairs], [n for _, _, n in pairs], relative=rule.relative))]
    return [Verdict(rule, label, c, c is not None and rule.exceeded(c)) for label, c in found]


def _methods(runs: list[dict[str, Any]]) -> set[str]:
    return {str(_mapping(run.get("spec")).get("method")) for run in runs}


def _groups(runs: list[dict[str, Any]], with_method: bool) -> dict[str, Group]:
    """Runs by what makes two of them the same cell; seeds and repeats are joined."""
    options = [o for o in run_options() if o.separates and (with_method or o.name != "method")]
    groups: dict[str, Group] = {}
    for run in runs:
        spec = _mapping(run.get("spec"))
        key = json.dumps([spec.get(o.name, o.default) for o in options], sort_keys=True, default=str)
        label = " ".join(str(spec[n]) for n in ("method", "preset", "camera", "dataset", "sequence") if spec.get(n))
        groups.setdefault(key, Group(label)).runs.append(run)
    return groups


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
