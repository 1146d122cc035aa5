"""Run by test_run_options.py: panobench with one more run option, and where it is seen, as JSON.

RunRequest is replaced before any other module is imported: nothing but its fields is told about the new option.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import panobench.bench.run.request as request


@dataclass(frozen=True)
class Extended(request.RunRequest):
    shutter: str | None = request.run_option(
        None, "How the shutter works.", changes_input=True, label="{} shutter", import_help="How its shutter worked."
    )


request.RunRequest = Extended  # type: ignore[misc]


def main(folder: Path) -> dict[str, object]:
    import typer

    from panobench.bench.records.compare import compare
    from panobench.bench.records.record import RunRecord
    from panobench.bench.suite.cells import Cell, Planner
    from panobench.bench.suite.file import read_suite
    from panobench.cli import import_run, run
    from panobench.errors import InputError
    from panobench.report.model import Collection, Run
    from panobench.report.variants import variants
    from panobench.studies.cells import RunOptions

    plain, other = Extended(method="sparse"), Extended(method="sparse", shutter="rolling")
    planner = Planner()
    opened: list[object] = []
    planner._opened = lambda r: opened.append(r) or {"data": 0, "kind": "erp"}  # type: ignore[method-assign, func-returns-value]
    for r in (plain, other, plain):
        planner._data_of(r)
    records = [
        RunRecord.from_dict({"schema": 1, "status": "ok", "spec": r.to_dict(), "metrics": {"ate_rmse_m": 1.0}})
        for r in (plain, other)
    ]
    old = RunRecord.from_dict(
        {"schema": 1, "status": "ok", "spec": {k: v for k, v in plain.to_dict().items() if k != "shutter"}}
    )
    suite = folder / "suite.yaml"
    suite.write_text("methods: [sparse]\ndatasets: [rooms]\noptions: {shutter: rolling}\n")
    study = RunOptions(**{"shutter": "rolling"})

    def flags(app: typer.Typer) -> dict[str, str]:
        command = typer.main.get_command(app)
        return {p.opts[0]: getattr(p, "help", "") for p in command.params}

    try:
        compared = bool(compare(records[:1], records[1:], ()).cells)
    except InputError:
        compared = False

    def variant_labels(records: list[RunRecord]) -> list[str]:
        runs = tuple(Run(folder / str(k), record) for k, record in enumerate(records))
        return [variant.label for variant in variants(Collection(runs))]

    return {
        "identities": [Cell(r).identity for r in (plain, other)],
        "labels": [Cell(r).label for r in (plain, other)],
        "inputs opened": len(opened),
        "compared": compared,
        "old runs compared": len(compare([old], records[:1], ()).cells),
        "command": other.command(),
        "round trip": Extended.from_dict(json.loads(json.dumps(other.to_dict()))) == other,
        "suite": read_suite(suite).cells[0].request.to_dict(),
        "study": study.request("room1", 0).to_dict(),
        "study cell": study.cell("room1", 0, shutter="global").request.to_dict(),
        "run --help": flags(run.app),
        "import --help": flags(import_run.app),
        "variants": [r.spec.variants() for r in records],
        "variant labels": variant_labels(records),
    }


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
