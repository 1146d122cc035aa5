"""`panobench compare BASE NEW --fail-on "ate>5%"`: a gate against regressions, for CI.

Exit codes: 0 no rule is broken, 1 a regression (a broken rule, or a cell that fails more often than before),
2 bad input, nothing to compare, or a rule whose number no cell has on both sides.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer()


@app.command()
def compare(
    base: Annotated[Path, typer.Argument(help="Runs to compare with: a run folder, or a store of a suite.")],
    new: Annotated[Path, typer.Argument(help="Runs to judge.")],
    fail_on: Annotated[
        list[str] | None,
        typer.Option(help="NAME>AMOUNT[%] or NAME<AMOUNT[%], such as 'ate>5%'; 'any:' before it: for each sequence."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Print Markdown, for a CI summary.")] = False,
) -> None:
    """Compare two sets of runs; exit code 1 on a regression."""
    from panobench.bench.records import compare as gate
    from panobench.errors import InputError

    rules = [gate.Rule.parse(text) for text in fail_on or ()]
    found = gate.compare(gate.load_runs(base), gate.load_runs(new), rules)
    if as_json:
        print(json.dumps(_document(found), indent=2))
    else:
        print(_text(found, rules, markdown))
    if found.regression:
        raise typer.Exit(1)
    if found.unjudged:
        rule = found.unjudged[0]
        raise InputError(
            f"--fail-on '{rule}' judges nothing: no cell has that number on both sides; leave the rule out"
        )


def _document(found: Any) -> dict[str, Any]:
    return {
        "regression": found.regression,
        "verdicts": [asdict(v) for v in found.verdicts],
        "new_failures": found.new_failures,
        "only_base": found.only_base,
        "only_new": found.only_new,
        "cells": [
            {"cell": label, **{k: {"base": b, "new": n} for k, b, n in _numbers(left, right)}}
            for label, left, right in found.cells
        ],
    }


def _numbers(left: Any, right: Any) -> list[tuple[str, float | None, float | None]]:
    """Medians over repeats of the numbers that are compared most, as (name, base, new)."""
    import numpy as np

    keys = ("ate_rmse_m", "tracked", "psnr_db", "pano_psnr_db", "fps")
    pairs = [(k, left.numbers(k), right.numbers(k)) for k in keys]
    return [(k, *(float(np.median(v)) if v else None for v in (b, n))) for k, b, n in pairs]  # type: ignore[misc]


def _text(found: Any, rules: list[Any], markdown: bool) -> str:
    from panobench.bench.records.tables import text_table

    header = ["cell", "runs", "ok", "ATE mm", "", "fps", "", "PSNR dB", ""]
    rows = []
    for label, left, right in found.cells:
        numbers = {k: (b, n) for k, b, n in _numbers(left, right)}
        row = [label, f"{len(left.runs)} / {len(right.runs)}"]
        row.append(f"{len(left.runs) - len(left.failed)} / {len(right.runs) - len(right.failed)}")
        for key, factor in (("ate_rmse_m", 1e3), ("fps", 1.0), ("pano_psnr_db", 1.0)):
            b, n = numbers[key]
            row.append(f"{_number(b, factor)} / {_number(n, factor)}")
            row.append(f"{n / b - 1:+.1%}" if b and n is not None else "")
        rows.append(row)
    lines = ["Pairs are base / new, medians over repeats.", "", text_table(header, rows, markdown=markdown), ""]
    for v in found.verdicts:
        where = f" {v.label}" if v.label else " over all sequences"
        lines.append(f"{_outcome(v):4}  {v.rule.text}{where}: {_change(v)}")
    lines += [f"FAIL  {label}: fails more often than before" for label in found.new_failures]
    lines += [f"note  only in base: {label}" for label in found.only_base]
    lines += [f"note  only in new: {label}" for label in found.only_new]
    if not rules:
        lines.append("note  no --fail-on rule: only new failures count")
    lines.append("regression" if found.regression else "no regression")
    return ("\n" if not markdown else "  \n").join(lines)


def _outcome(verdict: Any) -> str:
    if verdict.change is None:
        return "n/a"
    return "FAIL" if verdict.broken else "ok"


def _change(verdict: Any) -> str:
    found, rule = verdict.change, verdict.rule
    if found is None:
        return "not measured on both sides"
    form = "{:+.2%}" if rule.relative else "{:+.4g}"
    text = form.format(found.value)
    if found.interval:
        text += f", 95% interval {form.format(found.interval[0])} to {form.format(found.interval[1])}"
        worse = (-found.value if rule.falls else found.value) > rule.amount
        text += ", within noise" if worse and not verdict.broken else ""
    else:
        text += ", one run each: no interval"
    return text


def _number(value: float | None, factor: float) -> str:
    return "n/a" if value is None else f"{value * factor:.2f}"
