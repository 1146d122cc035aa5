"""Compare two sets of runs and judge rules such as "ate>5%": a gate against regressions."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from panobench.bench.records.record import RunRecord, read_record
from panobench.bench.records.runfolder import RUN_JSON, folders_with
from panobench.bench.records.statistics import Change, change
from panobench.bench.run.request import run_options, run_words
from panobench.errors import InputError, UnknownNameError, UsageError

#: Short name of a number in a rule -> its name in run.json.
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


@dataclass(frozen=True)
class Rule:
    """A rule such as "ate>5%": it is broken when the ATE grew by more than 5 per cent, or with "<", fell by more.

    Without % the amount is in the number's own unit. each: the rule is judged for every sequence, not for their mean.
    """

    text: str
    key: str
    falls: bool
    amount: float
    relative: bool
    each: bool

    @classmethod
    def parse(cls, text: str) -> Rule:
        """The rule that ``text`` states. Raises UsageError or UnknownNameError."""
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
        """Whether the change is larger than the rule allows, and larger than noise."""
        return (-found.value if self.falls else found.value) > self.amount and found.beyond_noise()


@dataclass
class Group:
    """The runs of one cell, with all its seeds and repeats."""

    label: str
    runs: list[RunRecord] = field(default_factory=list)

    @property
    def failed(self) -> list[RunRecord]:
        return [r for r in self.runs if not r.ok]

    def numbers(self, key: str) -> list[float]:
        """The number in each repeat that went well and measured it."""
        return [value for run in self.runs if run.ok and (value := run.number(key)) is not None]


@dataclass(frozen=True)
class Verdict:
    """One rule judged on one cell or on all (label ""). change is None when there was nothing to compare."""

    rule: Rule
    label: str
    change: Change | None
    broken: bool


@dataclass
class Comparison:
    """Verdicts, cells that fail more often than before, cells of one side only, and both groups of each other cell."""

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
        """The rules that no cell could be judged by: such a gate would pass whatever happens."""
        judged = {v.rule.text for v in self.verdicts if v.change is not None}
        return [text for text in dict.fromkeys(v.rule.text for v in self.verdicts) if text not in judged]


def load_runs(path: Path) -> list[RunRecord]:
    """The record of every run at or below ``path``. Raises InputError if one is damaged or there is none."""
    return [read_record(folder) for folder in run_folders(path)]


def run_folders(path: Path) -> list[Path]:
    """Run folders at or below ``path``, sorted. Raises InputError when there is none."""
    if not path.exists():
        raise InputError("no such file or folder", path)
    folders = folders_with(RUN_JSON, path) if path.is_dir() else []
    if not folders:
        raise InputError("no run.json here or below", path)
    return folders


def compare(base: list[RunRecord], new: list[RunRecord], rules: Iterable[Rule]) -> Comparison:
    """Judge ``new`` against ``base``. Raises InputError when they have no cell in common."""
    with_method = bool(_methods(base) & _methods(new)) or len(_methods(base)) > 1 or len(_methods(new)) > 1
    depths = _depths([*base, *new], with_method)
    left, right = _groups(base, with_method, depths), _groups(new, with_method, depths)
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


def _methods(runs: list[RunRecord]) -> set[str]:
    return {run.spec.method for run in runs}


def _cell(run: RunRecord, with_method: bool) -> dict[str, Any]:
    """The options that define a cell; runs that differ in others, such as the seed, are its repeats."""
    values = {option.name: run.spec.option(option.name) for option in run_options() if option.separates}
    values |= {"method": run.spec.method if with_method else "", "dataset": run.spec.dataset}
    return {**values, "sequence": run.spec.sequence}


def _key(values: Mapping[str, Any]) -> str:
    return json.dumps(values, sort_keys=True, default=str)


def _depths(runs: list[RunRecord], with_method: bool) -> dict[str, set[str]]:
    """The depth estimators that took effect, by the key of the other options."""
    found: dict[str, set[str]] = {}
    for run in runs:
        values = _cell(run, with_method)
        depth = values.pop("depth")
        if depth is not None:
            found.setdefault(_key(values), set()).add(str(depth))
    return found


def _groups(runs: list[RunRecord], with_method: bool, depths: Mapping[str, set[str]]) -> dict[str, Group]:
    """A run that failed before it chose a depth estimator belongs to the cell that is otherwise the same."""
    groups: dict[str, Group] = {}
    for run in runs:
        values = _cell(run, with_method)
        if values["depth"] is None and not run.ok:
            others = depths.get(_key({k: v for k, v in values.items() if k != "depth"}), set())
            values["depth"] = next(iter(others)) if len(others) == 1 else None
        label = " ".join(run_words({**values, "method": run.spec.method}))
        groups.setdefault(_key(values), Group(label)).runs.append(run)
    return groups
