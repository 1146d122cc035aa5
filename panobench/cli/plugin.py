"""`panobench plugin new` and `panobench plugin check`: the author kit on the command line."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True, help="Write a plugin package, or check one against the contract.")


@app.command()
def new(
    name: Annotated[str, typer.Argument(help="Name of the plugin: the package becomes panobench-NAME.")],
    kind: Annotated[str, typer.Option(help="method, camera, dataset, metric or depth.")] = "method",
    directory: Annotated[Path, typer.Option("--in", help="Where to put the package's folder.")] = Path("."),
) -> None:
    """Write an installable package that passes its own tests at once."""
    from panobench.testing.scaffold import new_package

    package = new_package(name, kind, directory)
    print(f"wrote {package.folder}:")
    for path in package.files:
        print(f"  {path}")
    print(f'next: pip install -e "{package.folder}[test]" && pytest {package.folder}')


@app.command()
def check(
    package: Annotated[str, typer.Argument(help="Installed package, entry point, or folder with a pyproject.toml.")],
    root: Annotated[Path | None, typer.Option(help="Data for a dataset that needs some.")] = None,
    seed: Annotated[int, typer.Option(help="Seed given to methods and depth estimators.")] = 7,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Run the conformance suite. Exit code 1 when a check fails."""
    from panobench.errors import UsageError
    from panobench.testing.conformance import Options, check_spec
    from panobench.testing.packages import find_plugin

    plugin = find_plugin(package)
    if not plugin.specs:
        raise UsageError(f"plugin {plugin.name} registers nothing; implement a register_... hook (docs/plugins.md)")
    checks = [c for spec in plugin.specs for c in check_spec(spec, Options(root, seed))]
    failed = sum(c.outcome == "fail" for c in checks)
    if as_json:
        print(json.dumps({"plugin": plugin.name, "failed": failed, "checks": [asdict(c) for c in checks]}, indent=2))
    else:
        for label in dict.fromkeys(c.spec for c in checks):
            print(f"{label}:")
            for c in (c for c in checks if c.spec == label):
                print(f"  {c.outcome:4}  {c.name}{': ' if c.message else ''}{c.message}")
        passed = sum(c.outcome == "pass" for c in checks)
        print(f"{plugin.name}: {passed} passed, {failed} failed, {len(checks) - passed - failed} skipped")
    if failed:
        raise typer.Exit(1)
