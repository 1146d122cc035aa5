"""The HTML report: one file, no network, everything from data escaped."""

from __future__ import annotations

import base64
import gzip
import importlib.util
import json
import re
from collections.abc import Mapping
from datetime import datetime, timezone
from functools import lru_cache
from pathlib import Path
from typing import Any

import jinja2
from markupsafe import Markup, escape

from panobench import __version__
from panobench.bench.records.cautions import CAUTIONS, WRONG
from panobench.bench.records.paper import Published
from panobench.errors import UnavailableError
from panobench.report.headline import default_title, facts, measurements, tiles
from panobench.report.images import BUDGET, SMALLEST
from panobench.report.mapview import MOST, MOST_IN_ALL, map_size
from panobench.report.model import Collection, Run
from panobench.report.panoramas import Gallery, copy_map, make_gallery, write_walk_page
from panobench.report.ranking import RANKING_RULE, failure
from panobench.report.sections import cost_charts, place_section
from panobench.report.studies import study_section
from panobench.report.table_model import Row, Table, natural
from panobench.report.tables import run_tables
from panobench.report.variants import variants
from panobench.writing import TEXT

_TEMPLATES = Path(__file__).parent / "templates"
#: Largest size of a page, bytes: mail servers and repositories accept it, and browsers open it at once.
MAX_BYTES = 10_000_000
#: How often the page is made again to fit its limit.
_ATTEMPTS = 4
_SCRIPTS = ("core.js", "tables.js", "plots.js", "pano.js", "main.js")


def build_html(
    collection: Collection,
    *,
    title: str | None = None,
    published: Published | None = None,
    assets: Path | None = None,
    now: datetime | None = None,
    max_bytes: int = MAX_BYTES,
) -> str:
    """The whole page as text. ``assets``: folder that receives full-size pictures, linked relatively.

    Pictures are shrunk until the page fits into ``max_bytes``, as far as shrinking them can achieve that.
    """
    budget = min(BUDGET, max_bytes)
    for _ in range(_ATTEMPTS):
        gallery = make_gallery(collection, assets, budget)
        text = _page(collection, gallery, title, published, now or datetime.now(timezone.utc))
        excess = len(text.encode(**TEXT)) - max_bytes
        if excess <= 0 or gallery.plan == SMALLEST:
            break
        budget = max(0, min(budget, sum(map(len, gallery.store.values()))) - round(1.05 * excess))
    return text


def _page(
    collection: Collection, gallery: Gallery, title: str | None, published: Published | None, now: datetime
) -> str:
    grouped = variants(collection)
    label_of = {id(run): variant.label for variant, runs in grouped.items() for run in runs}
    colour_of = {id(run): i for i, runs in enumerate(grouped.values()) for run in runs}
    data: dict[str, Any] = {"figures": {}, "viewers": {}}
    map_points = min(MOST, MOST_IN_ALL // max(1, len(collection.places())))
    works = {run.place for run in collection.runs if not failure(run)}
    order = sorted(collection.places(), key=lambda place: (place not in works, place[0], natural(place[1])))
    places = [
        place_section(i, collection.at(place), label_of, colour_of, gallery, data, map_points)
        for i, place in enumerate(order)
    ]
    data["images"], data["links"] = gallery.store, gallery.links
    tables = run_tables(collection, published)
    studies = [study_section(i, study, data) for i, study in enumerate(collection.studies)]
    context = {
        "title": title or default_title(collection, grouped),
        "facts": facts(collection, now),
        "tiles": tiles(collection, grouped),
        "tables": tables if len(collection.runs) > 1 else [],
        "measurements": measurements(collection.runs[0]) if len(collection.runs) == 1 else [],
        "studies": studies,
        "places": places,
        "cost_charts": cost_charts(grouped, data),
        "failures": [(run, failure(run), label_of[id(run)]) for run in collection.runs if failure(run)],
        "doubtful": [(i, run, label_of[id(run)]) for i, run in enumerate(collection.runs) if run.doubtful],
        "told": collection.runs[0].cautions if len(collection.runs) == 1 else (),
        "problems": collection.problems,
        "protocols": sorted({run.protocol for run in collection.runs if run.protocol}),
        "runs": [_run_details(i, run, label_of[id(run)], gallery) for i, run in enumerate(collection.runs)],
        "rule": RANKING_RULE,
        "version": __version__,
        "data": data,
        "scripts": [Markup((_TEMPLATES / name).read_text(encoding="utf-8")) for name in _SCRIPTS],
        "style": Markup((_TEMPLATES / "style.css").read_text(encoding="utf-8")),
        "plotly": Markup(_plotly_packed()) if data["figures"] else "",
    }
    return _environment().get_template("report.html").render(context)


def safe_json(value: Any) -> Markup:
    """JSON that cannot end the script element it stands in, nor start a comment there."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for character, code in (("<", "\\u003c"), (">", "\\u003e"), ("&", "\\u0026")):
        text = text.replace(character, code)
    return Markup(text.replace("\u2028", "\\u2028").replace("\u2029", "\\u2029"))


def _run_details(number: int, run: Run, label: str, gallery: Gallery) -> dict[str, Any]:
    about = run.record.to_dict()
    return {
        "anchor": f"run-{number}",
        "label": label,
        "run": run,
        "reason": failure(run),
        "map": map_size(run),
        "map_link": copy_map(run, gallery, number),
        "walk_link": write_walk_page(run, gallery, number),
        "configuration": flatten(about["spec"]),
        "provenance": flatten(about["provenance"]),
        "extra": flatten({k: about[k] for k in ("remarks", "extra", "depth", "notes", "map") if about.get(k)}),
    }


def flatten(value: Any, prefix: str = "") -> list[tuple[str, str]]:
    """Nested mappings as ("a.b", text) pairs, in the order given; long lists are cut."""
    if isinstance(value, Mapping):
        pairs: list[tuple[str, str]] = []
        for key, entry in value.items():
            pairs += flatten(entry, f"{prefix}.{key}" if prefix else str(key))
        return pairs
    if isinstance(value, (list, tuple)):
        words = ", ".join(str(v) for v in value[:40])
        return [(prefix, f"{words}, … ({len(value)} in all)" if len(value) > 40 else words)]
    return [(prefix, "–" if value is None else str(value))]


@lru_cache(maxsize=1)
def _plotly_packed() -> str:
    """Plotly.js, gzipped and in base64 (2 MB instead of 4.8), for the page to unpack on first use."""
    spec = importlib.util.find_spec("plotly")
    if spec is None or not spec.submodule_search_locations:
        raise UnavailableError("the HTML report needs the Python package 'plotly'")
    path = Path(next(iter(spec.submodule_search_locations))) / "package_data" / "plotly.min.js"
    return base64.b64encode(gzip.compress(path.read_bytes(), 9, mtime=0)).decode("ascii")


def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["safe_json"] = safe_json
    environment.filters["breakable"] = breakable
    environment.filters["whole_options"] = whole_options
    environment.globals["facet_values"] = facet_values
    environment.globals["flag_titles"] = {
        **CAUTIONS,
        "other data": "the figures are for other data; see below the table",
    }
    environment.globals["wrong_flags"] = WRONG
    environment.globals["asides"] = asides
    return environment


def breakable(text: str) -> Markup:
    """The text, escaped, with places where a narrow column may break long names of options."""
    return Markup(re.sub(r"([_=:/](?=\w)|(?<=[a-z])\.(?=[a-z]))", r"\1<wbr>", str(escape(text))))


def whole_options(command: str) -> Markup:
    """A command, escaped, whose options do not break at their hyphens."""
    return Markup(re.sub(r"(?<!\S)(--?[a-z][\w-]*)", r'<span class="option">\1</span>', str(escape(command))))


def asides(table: Table, row: Row) -> str:
    """The texts of a row besides its name: narrow screens show them below it instead of in columns of their own."""
    cells = zip(table.columns[1:], row.cells[1:])
    return ", ".join(cell.text for column, cell in cells if not column.numeric and cell.text)


def facet_values(table: Table) -> dict[str, list[str]]:
    """Per facet the values rows have, for facets that tell rows apart."""
    names = dict.fromkeys(name for row in table.rows for name in row.facets)
    values = {name: sorted({row.facets.get(name, "") for row in table.rows} - {""}) for name in names}
    return {name: found for name, found in values.items() if len(found) > 1}
