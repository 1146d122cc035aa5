"""Plain-text and Markdown tables for the terminal and for CI summaries."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]], *, markdown: bool = False) -> str:
    """A table whose columns are as wide as their widest cell; the first is aligned left, the others right."""
    if markdown:
        lines = [_markdown_row(header), "|" + "|".join([" --- "] + [" ---: "] * (len(header) - 1)) + "|"]
        return "\n".join(lines + [_markdown_row(row) for row in rows])
    widths = [max(len(row[k]) for row in [header, *rows]) for k in range(len(header))]
    return "\n".join(
        "  ".join(cell.ljust(w) if k == 0 else cell.rjust(w) for k, (cell, w) in enumerate(zip(row, widths))).rstrip()
        for row in [header, *rows]
    )


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"
