"""`panobench submit` writes what the organisers of challenges take."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(no_args_is_help=True)


@app.callback()
def submit() -> None:
    """Write and check what the organisers of a challenge take."""


@app.command("hilti-360")
def hilti(
    runs: Annotated[list[Path], typer.Argument(help="Run folders, one for each recording, or folders of them.")],
    out: Annotated[Path, typer.Option(help="Folder for the files.")] = Path("submission"),
) -> None:
    """Write one floor_X_YYYY-MM-DD_run_Z.txt for each run: cam0's poses at the recording's stamps.

    A run that would score 0 (another data set, a part of the frames, under 99% of them with a pose) gets no file and a
    line that says why; the exit code is 1 then.
    """
    from rich.console import Console

    from panobench.bench.records.runfolder import RUN_JSON, folders_with
    from panobench.bench.records.submission import write_submission
    from panobench.errors import InputError

    console = Console(highlight=False, soft_wrap=True)
    found = []
    for path in runs:
        folders = folders_with(RUN_JSON, path)
        if not folders:
            raise InputError("no run here", path)
        found += folders
    refused = False
    for each in write_submission(found, out):
        if each.file is None:
            refused = True
            console.print(f"{each.sequence or each.run}: not written: {'; '.join(each.problems)}", markup=False)
        else:
            console.print(f"{each.file}: {each.poses} poses", markup=False)
        for doubt in each.doubts:
            console.print(f"  note: {doubt}", markup=False)
    if refused:
        raise typer.Exit(1)
