"""The commands of `panobench`: name -> (module, one line of help). The modules are imported when a command runs.

A module of this table has a ``typer.Typer`` named ``app``: with one command it is that command, with several a group.
"""

from __future__ import annotations

#: In the order `panobench --help` shows them.
COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("panobench.cli.run", "Run one method on one sequence and store the run."),
    "list": ("panobench.cli.list", "Show every camera, dataset, method, depth estimator, metric and study."),
}
