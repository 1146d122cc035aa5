"""`panobench download NAME`: fetch sequences of a published dataset, or say where else to get it.

Exit codes: 0 they are there, 2 they are not, with one line that says what to do.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from panobench.errors import UnavailableError, UnknownNameError, UsageError

if TYPE_CHECKING:
    from panobench.datasets.download import Published
    from panobench.specs import DatasetSpec

app = typer.Typer()


@app.command()
def download(
    name: Annotated[str, typer.Argument(help="A dataset, as `panobench list datasets` names it.")],
    sequence: Annotated[list[str] | None, typer.Option(help="What of it; may be repeated. 'all' is all of it.")] = None,
    to: Annotated[Path | None, typer.Option(help="Folder; default: $PANOBENCH_DATA/NAME, else ./NAME.")] = None,
    mirror: Annotated[str | None, typer.Option(help="Address of a copy of what the publisher has.")] = None,
    keep: Annotated[bool, typer.Option("--keep", help="Keep the archives beside what was in them.")] = False,
) -> None:
    """Fetch sequences of a dataset whose publisher has a stable public address; else say where to get it.

    Checked against the publisher's checksums. Run again after a broken connection, it goes on where it stopped.
    """
    from panobench.datasets.download import obtain
    from panobench.plugins import registry
    from panobench.specs import DatasetSpec

    spec = registry().get(DatasetSpec, name)
    published = _published(spec)
    wanted = sequence or []
    if not wanted:
        raise UsageError(f"name what to fetch: --sequence {', '.join(published.sequences)}, or all")
    names = list(published.sequences) if "all" in wanted else wanted
    for one in names:
        if one not in published.sequences:
            raise UnknownNameError(f"sequence of {name}", one, [*published.sequences, "all"])
    folder = to or _default_folder(name)
    for one in names:
        for file in published.files(one, mirror):
            with _Bar(f"{name} {one}") as bar:
                new = obtain(file, folder, keep=keep, progress=bar.show)
            print(f"{one}: {'fetched' if new else 'already'} in {folder}")
    at_root = "" if to is None and os.environ.get("PANOBENCH_DATA") else f" --root {folder}"
    print(f"try: panobench run --dataset {name}{at_root}")


def _published(spec: DatasetSpec) -> Published:
    """What can be fetched of a dataset. Raises UnavailableError with where to get it otherwise."""
    from panobench.specs import load_object

    if spec.download is not None:
        published: Published = load_object(spec.download, f"download of dataset '{spec.name}'")
        return published
    if not spec.needs_root:
        raise UnavailableError(f"{spec.name} needs no download: try panobench run --dataset {spec.name}")
    if spec.publisher == "you":
        raise UnavailableError(f"{spec.name} is for data of your own: panobench run --dataset {spec.name} --root PATH")
    where = spec.obtain or f"ask its publisher ({spec.publisher})" if spec.publisher else "ask the plugin's author"
    raise UnavailableError(f"{spec.name} has no stable public address to fetch from; to get it: {where}")


def _default_folder(name: str) -> Path:
    base = os.environ.get("PANOBENCH_DATA")
    return Path(base).expanduser() / name if base else Path(name)


class _Bar:
    """Bytes on standard error; silent where that is no terminal."""

    def __init__(self, title: str) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, DownloadColumn, Progress, TextColumn, TimeRemainingColumn

        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TimeRemainingColumn())
        self._progress = Progress(*columns, console=console, disable=not console.is_terminal)
        self._task = self._progress.add_task(title, total=None)

    def show(self, done: int, total: int | None) -> None:
        """So many bytes are there, of so many if that is known."""
        self._progress.update(self._task, completed=done, total=total)

    def __enter__(self) -> _Bar:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()
