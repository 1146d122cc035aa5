"""`panobench doctor` says whether a method, anything else registered, or a GPU can be used here, and what is missing.

Exit codes: 0 it can run here, 1 it cannot, 2 no such name.
"""

from __future__ import annotations

import importlib.util
import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from panobench.errors import UnknownNameError
from panobench.plugins import Registered, Registry, registry
from panobench.specs import MethodSpec, Spec

if TYPE_CHECKING:
    from panobench.external.findings import Finding

app = typer.Typer()
#: Kinds in the order in which a name is looked up.
KINDS = ("method", "depth", "mask", "dataset", "metric", "camera", "study")
#: The name that stands for the GPU.
GPU = "gpu"


@app.command()
def doctor(
    name: Annotated[str | None, typer.Argument(help="A method, any other name of `panobench list`, or gpu.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Say what a method needs and what of it is missing here; without a name, one line per method."""
    known = registry()
    if name is None:
        _overview(known, as_json)
        return
    if name == GPU:
        _gpu(as_json)
        return
    entry = find_entry(known, name)
    findings = examine(entry.spec)
    ok = all(f.ok for f in findings)
    if as_json:
        answer = {"kind": entry.spec.kind, "name": name, "origin": entry.origin, "ok": ok}
        print(json.dumps({**answer, "findings": [asdict(f) for f in findings]}, indent=2))
    else:
        print(f"{entry.spec.kind} '{name}' ({entry.origin}): {entry.spec.summary}")
        _print(findings)
        if isinstance(entry.spec, MethodSpec) and not ok and entry.spec.install:
            print(f"  to install: {entry.spec.install}")
        print("it can run here" if ok else "it cannot run here")
    if not ok:
        raise typer.Exit(1)


def _gpu(as_json: bool) -> None:
    """Say what a GPU needs, and what of it is missing here."""
    from panobench.gpu.checks import findings as examined

    findings = list(examined())
    ok = all(f.ok for f in findings)
    if as_json:
        print(json.dumps({"kind": GPU, "name": GPU, "ok": ok, "findings": [asdict(f) for f in findings]}, indent=2))
    else:
        print(f"{GPU}: what `panobench run --device cuda` needs")
        _print(findings)
        print("it can be used here" if ok else "it cannot be used here: runs use the CPU")
    if not ok:
        raise typer.Exit(1)


def _print(findings: list[Finding]) -> None:
    for f in findings:
        print(f"  {'ok' if f.ok else 'MISSING':8}{f.what}: {f.detail}")
        if f.fix and not f.ok:
            print(f"  {'':8}-> {f.fix}")


def find_entry(known: Registry, name: str) -> Registered:
    """The entry of that name. Raises UnknownNameError; if a plugin of that name failed to import, it says why."""
    for kind in KINDS:
        found = known.entries.get(kind, {}).get(name)
        if found is not None:
            return found
    for plugin, reason in known.failures.items():
        if name in (plugin, plugin.removeprefix("panobench-")):
            raise UnknownNameError(f"name (plugin '{plugin}' failed to import: {reason}),", name, ())
    raise UnknownNameError("method", name, known.entries.get("method", {}))


def examine(spec: Spec) -> list[Finding]:
    """Check everything the spec asks for, in order, leaving out what depends on something that is missing."""
    from panobench.external.findings import Finding

    findings = []
    for module in spec.requires:
        there = _importable(module)
        findings.append(Finding(there, "Python package", module, f"pip install {module}"))
    if all(f.ok for f in findings):
        try:
            diagnose = getattr(spec.load(), "diagnose", None)
            findings.append(Finding(True, "implementation", spec.implementation))
            findings += diagnose() if diagnose is not None else []
        except Exception as error:  # a plugin's import may raise anything
            reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
            findings.append(Finding(False, "implementation", reason, "reinstall the package it comes from"))
    if all(f.ok for f in findings):
        try:
            reason = spec.unavailable() or ""
        except Exception as error:
            reason = f"its probe failed: {type(error).__name__}: {error}"
        if reason:
            findings.append(Finding(False, "probe", reason))
    return findings


def _importable(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # the parent of a dotted name
        return False


def _overview(known: Registry, as_json: bool) -> None:
    rows = {}
    for name, entry in known.entries.get("method", {}).items():
        try:
            rows[name] = entry.spec.unavailable()
        except Exception as error:
            rows[name] = f"its probe failed: {type(error).__name__}: {error}"
    if as_json:
        print(json.dumps({"methods": rows, "failed_plugins": known.failures}, indent=2))
        return
    width = max(map(len, rows), default=0)
    for name, reason in rows.items():
        print(f"{name:{width}}  {'can run here' if reason is None else f'cannot run here: {reason}'}")
    for plugin, reason in known.failures.items():
        print(f"plugin {plugin} is skipped: {reason}")
