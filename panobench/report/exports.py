"""Write tables as LaTeX (booktabs), CSV, Parquet, Markdown and JSON."""

from __future__ import annotations

import csv
import io
import json
import re
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from panobench.errors import UnavailableError
from panobench.report.table_model import Cell, Column, Row, Table

_LATEX = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "\u202f": r"\,",
    "\u2009": r"\,",
    "·": r"$\cdot$",
    "–": "--",
    "°": r"$^\circ$",
    "“": "``",
    "”": "''",
    "′": r"$'$",
    "†": r"$^\dagger$",
    "…": r"\dots{}",
    "×": r"$\times$",
    "±": r"$\pm$",
    "λ": r"$\lambda$",
    "σ": r"$\sigma$",
}


#: Widths in characters of tables that fit one column of a page as they are, and its whole width (345 pt, 10 pt type).
_COLUMN, _PAGE = 44, 78
#: A table is never scaled below this share of its size, but split; and no part has more rows than a page.
_SMALLEST, _ROWS = 0.62, 38
#: Letters of a line of a column's heading.
_HEADING = 11


def to_latex(tables: Sequence[Table]) -> str:
    """booktabs tables; the preamble needs booktabs and graphicx. Coverage under 100% stands in brackets.

    What is wider than a column spans the page (table*), scaled down to it if need be; what would become too small to
    read is split into parts that repeat the columns of text.
    """
    parts = [part for table in tables for part in _parts(table)]
    return "% needs \\usepackage{booktabs} and \\usepackage{graphicx}\n" + "\n".join(_latex_table(*p) for p in parts)


def _parts(table: Table) -> list[tuple[Table, int, int]]:
    """(part, its number from 1, number of parts): the table cut by columns, then by rows, so that each fits a page."""
    widths = [_width(table, j) for j in range(len(table.columns))]
    names = [j for j, column in enumerate(table.columns) if j == 0 or column.key in ("sequence", "seed")]
    blocks: list[list[int]] = [[]]
    for j in range(len(widths)):
        if sum(widths[k] for k in {*blocks[-1], j}) > _PAGE / _SMALLEST and len(blocks[-1]) > len(names):
            blocks.append([k for k in names if k < j])
        blocks[-1].append(j)
    parts = []
    for block in blocks:
        for first in range(0, max(len(table.rows), 1), _ROWS):
            rows = table.rows[first : first + _ROWS]
            rows = tuple(replace(row, cells=tuple(row.cells[j] for j in block)) for row in rows)
            parts.append(replace(table, columns=tuple(table.columns[j] for j in block), rows=rows))
    return [(part, k + 1, len(parts)) for k, part in enumerate(parts)]


def _width(table: Table, j: int) -> int:
    """The width of a column in characters, with the space beside it."""
    return 2 + max(*map(len, _heading_lines(table.columns[j])), *(_cell_width(row, j) for row in table.rows), 0)


def _heading_lines(column: Column) -> list[str]:
    """A heading broken between words, its unit last: long headings would make columns of short numbers wide."""
    lines: list[str] = []
    for word in [*column.label.split(), *([f"[{column.unit}]"] if column.unit else [])]:
        if lines and len(lines[-1]) + 1 + len(word) <= _HEADING:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines or [""]


def _latex_heading(column: Column) -> str:
    lines = [latex_text(line) for line in _heading_lines(column)]
    side = "r" if column.numeric else "l"
    # an empty group before a bracket, which would be an argument of the line break
    return lines[0] if len(lines) == 1 else rf"\shortstack[{side}]{{{(chr(92) * 2 + '{}').join(lines)}}}"


def _cell_width(row: Row, j: int) -> int:
    cell = row.cells[j]
    bracket = 4 if cell.coverage is not None and cell.coverage < 0.9995 else 0
    return len(cell.text) + bracket + (len(_marker(row)) if j == 0 else 0)


def _latex_table(table: Table, number: int = 1, count: int = 1) -> str:
    wide = sum(_width(table, j) for j in range(len(table.columns))) > _COLUMN
    environment = "table*" if wide else "table"
    partial = any(c.coverage is not None and c.coverage < 0.9995 for row in table.rows for c in row.cells)
    caption = f"{table.title}. {table.caption}" + (" In brackets, the share of frames tracked." if partial else "")
    if number > 1:
        caption = f"{table.title} (part {number} of {count})."
    label = "".join(c if c.isalnum() else "-" for c in table.name) + (f"-{number}" if number > 1 else "")
    lines = [
        rf"\begin{{{environment}}}",
        r"\centering",
        rf"\caption{{{latex_text(caption)}}}",
        rf"\label{{tab:{label}}}",
        r"\par\medskip",
        *([r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"] if wide else []),
        rf"\begin{{tabular}}{{{''.join('r' if c.numeric else 'l' for c in table.columns)}}}",
        r"\toprule",
        *_group_lines(table),
        " & ".join(_latex_heading(c) for c in table.columns) + r" \\",
        r"\midrule",
    ]
    before = None
    for row in table.rows:
        if row.origin == "published" and before not in (None, "published"):
            lines.append(r"\midrule")
        lines.append(" & ".join(_latex_cell(row, j) for j in range(len(row.cells))) + r" \\")
        before = row.origin
    lines += [r"\bottomrule", r"\end{tabular}" + ("}" if wide else "")]
    notes = table.notes if number == count else ()
    lines += [rf"\par\smallskip\parbox{{\linewidth}}{{\footnotesize {latex_text(note)}}}" for note in notes]
    return "\n".join([*lines, rf"\end{{{environment}}}", ""])


def _group_lines(table: Table) -> list[str]:
    """A line above the headings with what several columns have in common, and rules below it."""
    spans: list[tuple[str, int, int]] = []  # name, first column from 1, last
    for j, column in enumerate(table.columns, 1):
        if spans and spans[-1][0] == column.group:
            spans[-1] = (column.group, spans[-1][1], j)
        else:
            spans.append((column.group, j, j))
    if not any(name for name, _, _ in spans):
        return []
    words = [rf"\multicolumn{{{b - a + 1}}}{{c}}{{{latex_text(name)}}}" for name, a, b in spans]
    rules = [rf"\cmidrule(lr){{{a}-{b}}}" for name, a, b in spans if name]
    return [" & ".join(words) + r" \\", "".join(rules)]


def _latex_cell(row: Row, j: int) -> str:
    cell = row.cells[j]
    text = latex_text(cell.text)
    text = rf"\textbf{{{text}}}" if cell.rank == 1 else rf"\underline{{{text}}}" if cell.rank == 2 else text
    if cell.coverage is not None and cell.coverage < 0.9995:
        text += rf" {{\scriptsize({100 * cell.coverage:.0f}\%)}}"
    if row.origin == "published":
        text = rf"\textit{{{text}}}"
    return text + (_marker(row, latex=True) if j == 0 else "")


def latex_text(text: str) -> str:
    """Text with every character that means something to TeX escaped."""
    return "".join(_LATEX.get(c, c) for c in text)


def to_markdown(tables: Sequence[Table]) -> str:
    """GitHub-flavoured tables: best bold, second best underlined, coverage under 100% in brackets."""
    parts = []
    for table in tables:
        partial = any(c.coverage is not None and c.coverage < 0.9995 for row in table.rows for c in row.cells)
        caption = table.caption + (" In brackets, the share of frames tracked." if partial else "")
        lines = [f"### {markdown_text(table.title)}", "", markdown_text(caption), ""]
        lines.append("| " + " | ".join(markdown_text(_heading(c)) for c in table.columns) + " |")
        lines.append("|" + "|".join("---:" if c.numeric else "---" for c in table.columns) + "|")
        lines += ["| " + " | ".join(_markdown_cell(row, j) for j in range(len(row.cells))) + " |" for row in table.rows]
        parts.append("\n".join([*lines, *(f"\n{markdown_text(note)}" for note in table.notes), ""]))
    return "\n".join(parts)


def _markdown_cell(row: Row, j: int) -> str:
    cell = row.cells[j]
    text = markdown_text(cell.text)
    text = f"**{text}**" if cell.rank == 1 else f"<u>{text}</u>" if cell.rank == 2 else text
    if cell.coverage is not None and cell.coverage < 0.9995:
        text += f" ({100 * cell.coverage:.0f}%)"
    return text + (_marker(row) if j == 0 else "")


def markdown_text(text: str) -> str:
    """Text that Markdown shows as it is, on one line of a table."""
    for character in "\\`*_[]|":
        text = text.replace(character, "\\" + character)
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\n", " ").replace("\r", " ")


#: Columns of a CSV that are not run options.
_IDENTITY = ("table", "origin", "flags")
_MEASURE = ("quantity", "value", "unit", "failed", "tracked", "repeats")


def to_csv(tables: Sequence[Table]) -> str:
    """Long form, one measured value per line, so that any program reads it: pandas.read_csv(FILE).

    What was run stands in columns of its own (method, preset, camera, width and so on), then the quantity, its value
    at full precision and its unit. A failure has no value and failed = 1; what was not measured is left out.
    """
    names = list(dict.fromkeys(name for table in tables for row in table.rows for name in _about(table, row)))
    if any(column.sequence for table in tables for column in table.columns) and "sequence" not in names:
        names.append("sequence")
    if any(column.group for table in tables for column in table.columns) and "dataset" not in names:
        names.append("dataset")
    stream = io.StringIO()
    writer = csv.DictWriter(stream, [*_IDENTITY, *names, *_MEASURE], restval="", lineterminator="\n")
    writer.writeheader()
    for table in tables:
        for row in table.rows:
            words = {"table": table.name, "origin": row.origin, "flags": "; ".join(row.flags), **_about(table, row)}
            for column, cell in zip(table.columns, row.cells):
                if not _names(column) and (cell.failed or cell.value is not None):
                    line = {**words, **_measure(table, column, cell)}
                    writer.writerow({name: csv_text(word) for name, word in line.items()})
    return stream.getvalue()


def _names(column: Column) -> bool:
    """Whether the column says what was run, not what was measured."""
    return not column.numeric or column.key == "seed"


def _about(table: Table, row: Row) -> dict[str, str]:
    """What the row is about: its label, the texts in it, and its facts."""
    texts = {c.key: cell.text for c, cell in zip(table.columns[1:], row.cells[1:]) if _names(c)}
    return {"label": row.cells[0].text.removesuffix(" †"), **texts, **row.facts}


def _measure(table: Table, column: Column, cell: Cell) -> dict[str, str]:
    key = column.key.removeprefix(f"{column.group}/")
    sequence = {"sequence": key} if column.sequence else {}
    sequence |= {"dataset": column.group} if column.group else {}
    accuracy = table.name == "ate" or table.name.startswith("ate-")
    quantity = "ate_rmse" if column.sequence or (accuracy and key == "mean") else key
    if key == "mean":
        quantity += "_geometric_mean"
    return {
        **sequence,
        "quantity": machine_name(quantity),
        "value": "" if cell.value is None or cell.failed else f"{cell.value:.9g}",
        "unit": column.unit,
        "failed": str(int(cell.failed)),
        "tracked": "" if cell.coverage is None else f"{cell.coverage:.6g}",
        "repeats": str(cell.repeats),
    }


def machine_name(key: str) -> str:
    """A heading such as "ATE [mm] ↓" without its unit and arrow, in small letters: "ate"."""
    return re.sub(r"\W+", "_", re.sub(r"\[.*?\]|[↓↑]", "", key).strip().lower()).strip("_") or key


def csv_text(word: str) -> str:
    """A word that no spreadsheet takes for a formula: text that starts like one gets an apostrophe."""
    if word[:1] in ("=", "+", "-", "@", "\t", "\r"):
        try:
            float(word)
        except ValueError:
            return "'" + word
    return word


def to_parquet(tables: Sequence[Table]) -> bytes:
    """The long form of ``to_csv`` with numbers as numbers, by pandas and whichever Parquet engine it finds.

    Raises UnavailableError without pandas or an engine.
    """
    try:
        import pandas

        table = pandas.read_csv(io.StringIO(to_csv(tables)), keep_default_na=False, dtype=str)
        for name in ("value", "tracked", "repeats", "seed", "width"):
            if name in table:
                table[name] = pandas.to_numeric(table[name].replace("", None), errors="coerce")
        table["failed"] = table["failed"] == "1"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "table.parquet"
            table.to_parquet(path, index=False)
            return path.read_bytes()
    except ImportError as error:
        raise UnavailableError(
            "Parquet needs pandas and fastparquet or pyarrow: pip install 'panobench[parquet]'"
        ) from error


def to_json(tables: Sequence[Table]) -> str:
    """Everything in the tables, for programs; the schema has a version."""
    content = {"schema": "panobench-tables-1", "tables": [asdict(table) for table in tables]}
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _heading(column: Column) -> str:
    label = f"{column.group}, {column.label}" if column.group else column.label
    return f"{label} [{column.unit}]" if column.unit else label


def _marker(row: Row, *, latex: bool = False) -> str:
    words = [*([] if row.origin == "measured" else [row.origin]), *row.flags]
    text = ", ".join(words)
    return "" if not words else rf" \textit{{({text})}}" if latex else f" *({text})*"


FORMATS: dict[str, Callable[[Sequence[Table]], str | bytes]] = {
    "latex": to_latex,
    "csv": to_csv,
    "markdown": to_markdown,
    "json": to_json,
    "parquet": to_parquet,
}
SUFFIXES = {
    ".html": "html",
    ".htm": "html",
    ".tex": "latex",
    ".csv": "csv",
    ".md": "markdown",
    ".json": "json",
    ".parquet": "parquet",
}
