"""Write tables as LaTeX (booktabs), CSV, Markdown and JSON."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict

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
}


def to_latex(tables: Sequence[Table]) -> str:
    """booktabs tables; the preamble needs \\usepackage{booktabs}. Coverage under 100% stands in brackets."""
    return "% needs \\usepackage{booktabs}\n" + "\n".join(_latex_table(t) for t in tables)


def _latex_table(table: Table) -> str:
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{latex_text(table.title)}. {latex_text(table.caption)}}}",
        rf"\label{{tab:{''.join(c if c.isalnum() else '-' for c in table.name)}}}",
        rf"\begin{{tabular}}{{{''.join('r' if c.numeric else 'l' for c in table.columns)}}}",
        r"\toprule",
        " & ".join(latex_text(_heading(c)) for c in table.columns) + r" \\",
        r"\midrule",
    ]
    before = None
    for row in table.rows:
        if row.origin == "published" and before not in (None, "published"):
            lines.append(r"\midrule")
        lines.append(" & ".join(_latex_cell(row, j) for j in range(len(row.cells))) + r" \\")
        before = row.origin
    lines += [r"\bottomrule", r"\end{tabular}"]
    lines += [rf"\par\smallskip\footnotesize {latex_text(note)}" for note in table.notes]
    return "\n".join([*lines, r"\end{table}", ""])


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
        lines = [f"### {markdown_text(table.title)}", "", markdown_text(table.caption), ""]
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


def to_csv(tables: Sequence[Table]) -> str:
    """One block per table, separated by an empty line; numbers at full precision, failures "/", unknown empty.

    Every table starts with its own heading row; first the table's name, the row's origin, its flags.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    for k, table in enumerate(tables):
        if k:
            stream.write("\n")
        heading = ["table", "origin", "flags"]
        for column in table.columns:
            heading.append(_machine_heading(column))
            if _has_coverage(table, column):
                heading.append(f"{_machine_heading(column)} tracked")
        writer.writerow(map(csv_text, heading))
        for row in table.rows:
            words = [table.name, row.origin, "; ".join(row.flags)]
            for column, cell in zip(table.columns, row.cells):
                words.append(_csv_value(column, cell))
                if _has_coverage(table, column):
                    words.append("" if cell.coverage is None else f"{cell.coverage:.6g}")
            writer.writerow(map(csv_text, words))
    return stream.getvalue()


def _csv_value(column: Column, cell: Cell) -> str:
    if not column.numeric or cell.failed:
        return cell.text
    return "" if cell.value is None else f"{cell.value:.9g}"


def csv_text(word: str) -> str:
    """A word that no spreadsheet takes for a formula: text that starts like one gets an apostrophe."""
    if word[:1] in ("=", "+", "-", "@", "\t", "\r"):
        try:
            float(word)
        except ValueError:
            return "'" + word
    return word


def to_json(tables: Sequence[Table]) -> str:
    """Everything in the tables, for programs; the schema has a version."""
    content = {"schema": "panobench-tables-1", "tables": [asdict(table) for table in tables]}
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _heading(column: Column) -> str:
    return f"{column.label} [{column.unit}]" if column.unit else column.label


def _machine_heading(column: Column) -> str:
    return f"{column.key} [{column.unit}]" if column.unit else column.key


def _has_coverage(table: Table, column: Column) -> bool:
    j = table.columns.index(column)
    return any(row.cells[j].coverage is not None for row in table.rows)


def _marker(row: Row, *, latex: bool = False) -> str:
    words = [*([] if row.origin == "measured" else [row.origin]), *row.flags]
    text = ", ".join(words)
    return "" if not words else rf" \textit{{({text})}}" if latex else f" *({text})*"


FORMATS: dict[str, Callable[[Sequence[Table]], str]] = {
    "latex": to_latex,
    "csv": to_csv,
    "markdown": to_markdown,
    "json": to_json,
}
SUFFIXES = {".html": "html", ".htm": "html", ".tex": "latex", ".csv": "csv", ".md": "markdown", ".json": "json"}
