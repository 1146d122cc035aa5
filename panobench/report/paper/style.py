"""How figures for papers look: their width, fonts and colours, and the formats they are saved in."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panobench.errors import UnavailableError, UnknownNameError, UsageError
from panobench.report.exports import latex_text
from panobench.writing import write_whole, writing

#: Colours that people with any common colour blindness tell apart (Okabe and Ito 2008), the yellow left out on white.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
#: With the colours' number they give 28 combinations, which print in grey too.
DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (5, 1, 1, 1)))
MARKERS = "osD^vPX*"
#: Even in lightness, and the same to every eye.
ERRORS = "cividis"
TRUTH = "#7a7a7a"
FORMATS = ("pdf", "svg", "pgf")
_UNITS = {"in": 1.0, "cm": 1 / 2.54, "mm": 1 / 25.4, "pt": 1 / 72.27}
_RC: dict[str, Any] = {
    "font.size": 8,
    "axes.titlesize": 8,
    "axes.labelsize": 8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "legend.fontsize": 7,
    "legend.frameon": False,
    "legend.labelspacing": 0.25,
    "legend.borderaxespad": 0.2,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.1,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "text.parse_math": False,  # names come from data
    "pdf.fonttype": 42,  # TrueType, embedded; publishers refuse type 3
    "ps.fonttype": 42,
    "svg.fonttype": "path",
    "svg.hashsalt": "panobench",
    "pgf.texsystem": "pdflatex",
    "pgf.rcfonts": False,
    "savefig.dpi": 300,
}


@dataclass(frozen=True)
class Style:
    """width: of every figure, inches. tex: texts go to TeX, which reads some characters as commands."""

    width: float
    tex: bool = False

    def text(self, words: str) -> str:
        """Words as the figure's format takes them."""
        if not self.tex:
            return words
        # pdflatex stops at letters that its fonts lack
        return "".join(c if ord(c) < 0x250 else "?" for c in latex_text(words))

    def colour(self, k: int) -> str:
        return PALETTE[k % len(PALETTE)]

    def dash(self, k: int) -> Any:
        return DASHES[(k // len(PALETTE)) % len(DASHES)]

    def marker(self, k: int) -> str:
        return MARKERS[k % len(MARKERS)]


def parse_width(text: str) -> float:
    """ "3.4in", "86mm", "8.6cm" or "245pt" (TeX's points) in inches. Raises UsageError."""
    found = re.fullmatch(r"\s*([0-9.]+)\s*(in|cm|mm|pt)?\s*", text)
    try:
        width = float(found[1]) * _UNITS[found[2] or "in"] if found else math.nan
    except ValueError:
        width = math.nan
    if not 1.0 <= width <= 40.0:
        raise UsageError(f"--width {text}: give 1 to 40 inches, as in 3.4in, 86mm, 8.6cm or 245pt")
    return width


def parse_formats(text: str) -> tuple[str, ...]:
    """ "pdf,svg" as names of ``FORMATS``. Raises UnknownNameError."""
    names = tuple(dict.fromkeys(word.strip().lower() for word in text.split(",") if word.strip()))
    for name in names:
        if name not in FORMATS:
            raise UnknownNameError("figure format", name, FORMATS)
    if not names:
        raise UsageError(f"--figure-format is empty; known: {', '.join(FORMATS)}")
    return names


@contextmanager
def drawing() -> Iterator[None]:
    """matplotlib's settings for these figures; without a display."""
    import matplotlib

    settings: Any = {"backend": "agg", **_RC}
    with matplotlib.rc_context(settings):
        yield


def save(draw: Callable[[Style], Any], stem: Path, width: float, formats: Sequence[str]) -> list[Path]:
    """Draw a figure for each format and write ``stem.FORMAT``; [] where ``draw`` has nothing to show.

    Raises UnavailableError for PGF without TeX, which measures the texts, and OutputError.
    """
    written = []
    for name in formats:
        figure = draw(Style(width, tex=name == "pgf"))
        if figure is None:
            return []
        target = stem.with_name(f"{stem.name}.{name}")
        if name == "pgf":
            _save_pgf(figure, target)
        else:
            content = io.BytesIO()
            dates = {"pdf": {"CreationDate": None, "Creator": None, "Producer": None}, "svg": {"Date": None}}
            figure.savefig(content, format=name, metadata=dates[name])
            write_whole(target, content.getvalue())
        written.append(target)
    return written


def _save_pgf(figure: Any, target: Path) -> None:
    """PGF names its pictures by the file, so it is written in place."""
    from matplotlib.backends.backend_pgf import LatexError

    try:
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            figure.savefig(target, format="pgf")
    except (FileNotFoundError, RuntimeError, LatexError) as error:
        target.unlink(missing_ok=True)
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise UnavailableError(f"PGF needs pdflatex with the package pgf, which measure the texts: {reason}") from error


def new_figure(style: Style, height: float, rows: int = 1, columns: int = 1, **options: Any) -> tuple[Any, Any]:
    """(figure, axes (rows, columns)) of the style's width; no window and no global state."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(style.width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **options)


def chart(style: Style, names: Sequence[str], ratio: float = 0.55) -> tuple[Any, Any]:
    """(figure, its axes), ``ratio`` times as high as wide, with room for a legend of these names below."""
    room = 0.15 * math.ceil(len(names) / _legend_columns(names, style)) + 0.08 if names else 0.0
    figure, axes = new_figure(style, ratio * style.width + room)
    return figure, axes[0, 0]


def legend_below(figure: Any, handles: Sequence[Any], names: Sequence[str], style: Style) -> None:
    """A legend under the axes, with as many columns as its texts leave room for."""
    if handles:
        texts = [style.text(name) for name in names]
        figure.legend(handles, texts, loc="outside lower center", ncols=_legend_columns(names, style))


def _legend_columns(names: Sequence[str], style: Style) -> int:
    longest = max(map(len, names))
    return max(1, min(len(names), int(style.width * 72 / (longest * 3.9 + 32))))
