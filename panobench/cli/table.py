"""Tables on a terminal, drawn by rich; elsewhere lines that grep and other programs read."""

from __future__ import annotations

import sys
from collections.abc import Sequence

#: Colours of run statuses; all others are red.
STYLES = {"ok": "green", "lost": "yellow", "interrupted": "yellow", "not run": "dim"}


def print_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[int] = (), status: int = -1
) -> bool:
    """Print the table where standard output is a terminal, and say whether it was.

    right: columns of numbers. status: the column of a run's status, which gets its colour. A cell's text is never
    read as markup, because names and messages come from data.
    """
    if sys.stdout is None or not sys.stdout.isatty():
        return False
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for k, name in enumerate(header):
        table.add_column(Text(name), justify="right" if k in right else "left", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell, STYLES.get(cell, "red") if k == status else "") for k, cell in enumerate(row)))
    Console().print(table)
    return True
