"""`panobench env` prints what to paste into a bug report."""

from __future__ import annotations

import json
import os
import shutil
from typing import Annotated, Any

import typer

from panobench import kernel_cache

app = typer.Typer()


@app.command()
def env(as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False) -> None:
    """Print versions, machine, plugins and settings, for a bug report."""
    found = environment()
    if as_json:
        print(json.dumps(found, indent=2))
        return
    for key, value in found.items():
        if isinstance(value, dict):
            print(f"{key}:")
            for name, entry in value.items():
                print(f"  {name}: {_text(entry)}")
        else:
            print(f"{key}: {_text(value)}")


def environment() -> dict[str, Any]:
    """Everything about this installation, by heading. It works where torch, Numba or OpenCV cannot be imported."""
    import warnings

    from panobench.bench.records.provenance import provenance

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # broken plugins are listed below
        from panobench.plugins import registry

        known = registry()
    facts = provenance()
    return {
        "panobench": facts.panobench,
        "commit": facts.commit,
        "plugin contract": facts.contract,
        "python": facts.python,
        "platform": facts.platform,
        "machine": facts.machine.to_dict(),
        "packages": facts.packages,
        "plugins": facts.plugins,
        "plugins that failed": known.failures,
        "cannot run here": {f"{r.spec.kind} {r.spec.name}": why for r in known.all() if (why := _unavailable(r.spec))},
        "kernel cache": kernel_cache.location(),
        "settings": {k: v for k, v in sorted(os.environ.items()) if k.startswith("PANOBENCH_")},
        "programs": {name: bool(shutil.which(name)) for name in ("git", "ffmpeg", "docker", "apptainer", "nvidia-smi")},
    }


def _unavailable(spec: Any) -> str | None:
    try:
        reason: str | None = spec.unavailable()
    except Exception as error:  # a plugin's probe may raise anything
        return f"its probe failed: {type(error).__name__}: {error}"
    return reason


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k}={v}" for k, v in value.items()) or "none"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return "-" if value is None else str(value)
