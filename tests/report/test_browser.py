"""The page in a real browser: it runs without errors, loads nothing, and its controls work."""

from __future__ import annotations

import importlib.util
import json
import os
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from chromium_pipe import Page, find_chromium
from fake_runs import write_suite

from panobench.bench.records.study_record import StudyResult, write_study
from panobench.report.build import write_report
from panobench.studies.basin_figures import contour, shares, surface

CHROMIUM = find_chromium()
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (name it in CHROMIUM)"),
]


@pytest.fixture(scope="module")
def browser() -> Iterator[Page]:
    with Page(str(CHROMIUM), 800, 700) as page:
        yield page


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a small suite."""
    folder = tmp_path_factory.mktemp("browser")
    write_report([write_suite(folder / "runs")], folder / "report.html")
    return folder / "report.html"


@pytest.fixture
def opened(browser: Page, report: Path) -> Page:
    """The page with everything on its first tab drawn; tests leave it as they found it."""
    if browser.evaluate("location.href") != report.as_uri():
        browser.errors.clear()
        browser.requests.clear()
        browser.prefer("light")
        browser.open(report)
        see_all(browser)
    return browser


def see_all(page: Page) -> None:
    """Scroll through the page, so that everything drawn on demand is drawn, and wait for it."""
    page.evaluate(
        "new Promise(async done => { for (let y = 0; y < document.body.scrollHeight; y += 600) {"
        "scrollTo({top: y, behavior: 'instant'}); await new Promise(r => setTimeout(r, 60)); }"
        " scrollTo(0, 0); done(); })"
    )
    page.wait("PB.all('.place:not(.off) .plot').every(d => d.dataset.drawn)")
    page.wait("PB.all('.place:not(.off) .pano img.render').every(i => i.naturalWidth > 0)")


def axe_source() -> str | None:
    """axe-core's script: the file named by PANOBENCH_AXE, or that of the axe-core-python package."""
    named = os.environ.get("PANOBENCH_AXE")
    if named:
        return Path(named).read_text(encoding="utf-8")
    spec = importlib.util.find_spec("axe_core_python")
    if spec is None or not spec.origin:
        return None
    return (Path(spec.origin).parent / "axe.min.js").read_text(encoding="utf-8")


def test_page_draws_everything_without_errors_and_without_the_network(opened):
    assert opened.errors == []
    assert [u for u in opened.requests if not u.startswith(("file:", "data:", "blob:"))] == []
    assert len([u for u in opened.requests if u.startswith("file:")]) == 1
    assert opened.evaluate("PB.all('.place:not(.off) .plot .main-svg').length") > 5
    assert opened.evaluate("PB.all('.spatial canvas').length") >= 1


def test_sorting_by_a_column_is_announced_and_undone(opened):
    column = "document.querySelectorAll('[data-table=runs] thead th')[5]"
    values = "PB.all('[data-table=runs] tbody tr').map(r => r.cells[5].dataset.value)"
    before = opened.evaluate(values)
    opened.evaluate(f"{column}.querySelector('button').click()")
    assert opened.evaluate(f"{column}.getAttribute('aria-sort')") == "ascending"
    up = opened.evaluate(values)
    known = [float(v) for v in up if v is not None]
    assert known == sorted(known)
    assert up[len(known) :] == [None] * (len(up) - len(known))
    opened.evaluate(f"{column}.querySelector('button').click()")
    down = opened.evaluate(values)
    assert down[: len(known)] == up[: len(known)][::-1]
    assert down[len(known) :] == up[len(known) :]
    opened.evaluate(f"{column}.querySelector('button').click()")
    assert opened.evaluate(values) == before
    assert opened.evaluate(f"{column}.getAttribute('aria-sort')") is None


def test_filters_narrow_the_rows_and_say_so(opened):
    visible = "PB.all('[data-table=runs] tbody tr').filter(r => r.offsetParent).length"
    count = "document.querySelector('[data-table=runs] .count').textContent"
    enter = (
        "(name, value) => {{ const c = document.querySelector(`[data-table=runs] [data-filter=${{name}}]`);"
        "c.value = value; c.dispatchEvent(new Event('input', {{bubbles: true}})); }}"
    ).format()
    assert opened.evaluate(visible) == 8
    opened.evaluate(f"({enter})('method', 'panogs')")
    assert (opened.evaluate(visible), opened.evaluate(count)) == (4, "4 of 8 rows")
    opened.evaluate(f"({enter})('text', 'room2')")
    assert opened.evaluate(visible) == 1
    opened.evaluate(f"({enter})('method', '')")
    opened.evaluate(f"({enter})('status', 'failed')")
    assert opened.evaluate(visible) == 2
    box = "document.querySelector('[data-table=ate-rooms] [data-filter=published]')"
    rows = "PB.all('[data-table=ate-rooms] tr.published').filter(r => r.offsetParent).length"
    shown = opened.evaluate(rows)
    assert shown > 0
    opened.evaluate(f"{box}.click()")
    assert opened.evaluate(rows) == 0
    opened.evaluate(f"{box}.click()")
    opened.evaluate(f"({enter})('text', '')")
    opened.evaluate(f"({enter})('status', '')")
    assert opened.evaluate(visible) == 8


def test_a_run_is_toggled_in_all_plots_of_its_sequence(opened):
    hidden = "PB.all('#seq0 .plot').flatMap(d => d.data.filter(t => t.visible === false).map(t => t.meta.run))"
    assert opened.evaluate(hidden) == []
    opened.evaluate("document.querySelector('#seq0 .legend [data-run=\"0\"]').click()")
    opened.wait(f"{hidden}.length >= 4")
    assert set(opened.evaluate(hidden)) == {0}
    assert opened.evaluate("document.querySelector('#seq0 .legend [data-run=\"0\"]').ariaPressed") == "false"
    opened.evaluate("document.querySelector('#seq0 .legend [data-run=\"0\"]').click()")
    opened.wait(f"{hidden}.length === 0")


def test_repeats_are_told_apart_by_the_same_dashes_everywhere(opened):
    swatches = opened.evaluate("PB.all('#seq0 .legend [data-colour] > .swatch').map(s => s.style.backgroundImage)")
    assert len(set(swatches)) == len(swatches) > 4
    lines = opened.evaluate(
        "PB.all('#seq0 .plot').flatMap(d => d.data.filter(t => t.line && t.meta.run >= 0)"
        ".map(t => [t.meta.run, `${t.line.color} ${t.line.dash}`]))"
    )
    looks = {run: {look for number, look in lines if number == run} for run, _ in lines}
    assert all(len(look) == 1 for look in looks.values())
    assert len(set().union(*looks.values())) == len(looks) > 3


def test_a_table_that_goes_on_fades_out_until_it_is_scrolled(opened):
    more = "document.querySelector('[data-table=runs] .scroll').dataset.more"
    scroll = "document.querySelector('[data-table=runs] .scroll').scrollTo({{left: {}, behavior: 'instant'}})"
    opened.wait(f"{more} === 'right'")
    opened.evaluate(scroll.format(100000))
    opened.wait(f"{more} === undefined")
    opened.evaluate(scroll.format(0))
    opened.wait(f"{more} === 'right'")


def test_tabs_work_with_the_arrow_keys(opened):
    opened.evaluate("document.querySelector('[role=tab]').focus()")
    opened.key("ArrowRight", 39)
    assert opened.evaluate("document.activeElement.id") == "tab-seq1"
    assert opened.evaluate("PB.all('.place').map(p => p.classList.contains('off'))") == [True, False]
    opened.evaluate("document.querySelector('#seq1 .charts').scrollIntoView({behavior: 'instant'})")
    opened.wait("PB.all('#seq1 .plot').some(d => d.dataset.drawn)")
    opened.evaluate("document.getElementById('tab-seq0').click()")
    assert opened.evaluate("PB.all('.place').map(p => p.classList.contains('off'))") == [False, True]


def test_the_divider_moves_by_mouse_and_keyboard(opened):
    opened.evaluate("document.querySelector('.stage').scrollIntoView({block: 'center', behavior: 'instant'})")
    box = opened.evaluate(
        "(r => [r.left, r.top, r.width, r.height])(document.querySelector('.stage').getBoundingClientRect())"
    )
    y = box[1] + box[3] / 2
    opened.drag((box[0] + box[2] / 2, y), (box[0] + box[2] / 4, y))
    assert float(opened.evaluate("document.querySelector('.wipe').value")) == pytest.approx(25, abs=1)
    opened.key("ArrowRight", 39)
    assert float(opened.evaluate("document.querySelector('.wipe').value")) == pytest.approx(26, abs=1)
    assert opened.evaluate("document.querySelector('.stage').style.getPropertyValue('--share')").startswith("26")


def test_looking_around_turns_the_view_and_difference_is_dark_where_equal(opened):
    opened.evaluate("document.querySelector('[data-view=look]').click()")
    opened.evaluate("document.querySelector('canvas.look').focus()")
    mean = (
        "(c => { const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let s = 0;"
        "for (let i = 0; i < d.length; i += 4) s += d[i] + d[i + 1] + d[i + 2]; return 4 * s / d.length / 3; })"
        "(document.querySelector('canvas.look'))"
    )
    before = opened.evaluate(mean)
    assert before > 30
    opened.key("ArrowUp", 38)
    assert opened.evaluate(mean) != before
    opened.evaluate("document.querySelector('[data-mode=difference]').click()")
    assert opened.evaluate(mean) < before / 2
    opened.evaluate("document.querySelector('[data-mode=compare]').click()")
    opened.evaluate("document.querySelector('[data-view=flat]').click()")


def test_phone_width_has_no_sideways_scrolling(opened):
    opened.resize(390, 844, mobile=True)
    try:
        opened.wait("document.documentElement.scrollWidth <= 390")
    finally:
        opened.resize(800, 700)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing_serious(opened, scheme):
    opened.prefer(scheme)
    opened.wait(f"document.documentElement.dataset.theme === '{scheme}'")
    opened.evaluate("PB.all('details').forEach(d => { d.open = true; })")
    assert serious_problems(opened) == []


def serious_problems(page: Page) -> list[object]:
    """What axe-core finds serious on the page."""
    source = axe_source()
    if source is None:
        pytest.skip("needs axe-core-python, or axe.min.js named in PANOBENCH_AXE")
    page.evaluate(source + "; 0")
    result = json.loads(page.evaluate("axe.run().then(r => JSON.stringify(r.violations))"))
    return [
        (v["id"], v["help"], [(n["html"][:160], n["failureSummary"][:300]) for n in v["nodes"][:3]])
        for v in result
        if v["impact"] in ("serious", "critical")
    ]


def test_studies_are_drawn_and_usable_by_everybody(browser, tmp_path):
    offsets = [-0.5, 0.0, 0.5]
    start = {"distance": 0.1, "direction": 0.0, "error": 0.0, "rotation_deg": 0.0, "converged": True}
    about = {
        "offsets": offsets,
        "loss": [[3, 2, 3], [2, 1, 2], [3, 2, 3.5]],
        "starts": [start],
        "eigenvalues": [6, 5, 4],
    }
    measured = {"120°": about, "360°": about}
    rows = [{"FoV": name, "0.1 z [%] ↑": 100.0, "source": "measured"} for name in measured]
    figures = {"c": contour("120°", measured), "s": surface("360°", measured), "r": shares([0.1], rows)}
    write_study(tmp_path, StudyResult("basin", {"basin": rows}, figures, ["a note"], "Basin"), {"command": "panobench"})
    write_report([tmp_path], tmp_path / "study.html")
    browser.errors.clear()
    browser.prefer("dark")
    browser.open(tmp_path / "study.html", settle=0.2)
    browser.evaluate("scrollTo(0, document.body.scrollHeight)")
    browser.wait("PB.all('.plot').every(d => d.dataset.drawn)")
    assert browser.evaluate("PB.all('.plot .contourlayer path').length") > 0
    assert browser.evaluate("PB.all('.spatial canvas').length") >= 1
    assert browser.errors == []
    assert serious_problems(browser) == []


def test_printing_makes_a_document_of_every_sequence(opened, tmp_path):
    opened.wait("window.Plotly")
    opened.pdf(tmp_path / "report.pdf")
    assert (tmp_path / "report.pdf").read_bytes()[:5] == b"%PDF-"
    assert opened.evaluate("PB.all('#seq1 .plot').filter(d => d.dataset.drawn && !d.closest('.spatial')).length") >= 3
    assert opened.errors == []


def test_names_from_data_do_not_run(browser, make_run, tmp_path):
    evil = "</script><script>window.pwned=1</script><img src=x onerror=window.pwned=1><b>x</b>"
    runs = [make_run("a", method=evil, sequence=evil), make_run("b", method="b", sequence=evil)]
    write_report(runs, tmp_path / "evil.html", title=evil)
    browser.errors.clear()
    browser.open(tmp_path / "evil.html", settle=0.2)
    see_all(browser)
    assert browser.evaluate("window.pwned === undefined")
    assert browser.evaluate("document.querySelector('h1').textContent") == evil
    assert browser.errors == []


def test_no_row_is_hidden_in_a_box_and_runs_can_be_found(browser, make_run, tmp_path):
    for k in range(20):
        make_run(f"r{k}", method=f"method{k:02d}", pictures=0, depth=False)
    write_report([tmp_path / "runs"], tmp_path / "many.html")
    browser.open(tmp_path / "many.html")
    assert browser.evaluate("PB.all('.scroll').every(s => s.scrollHeight <= s.clientHeight + 1)")
    assert (
        browser.evaluate("getComputedStyle(document.documentElement).getPropertyValue('--palette').split(' ').length")
        >= 12
    )
    script = "(() => { const i = document.querySelector('[data-runs] input'); i.value = 'method07'; "
    browser.evaluate(script + "i.dispatchEvent(new Event('input', {bubbles: true})); })()")
    assert browser.evaluate("PB.all('#runs > .run').filter(r => !r.hidden).length") == 1
    assert browser.evaluate("document.querySelector('[data-runs] .count').textContent") == "1 of 20 runs"


def test_a_phone_shows_the_first_measurement_of_every_table(browser, report):
    browser.resize(390, 800, mobile=True)
    browser.open(report)
    left = "PB.all('.table').map(t => [...t.querySelectorAll('tbody tr:first-child td')].find(c => c.offsetWidth))"
    assert browser.evaluate(f"{left}.every(c => c.classList.contains('num') && c.getBoundingClientRect().right < 390)")
    browser.resize(1280, 900)


def test_what_a_mask_hides_is_black_in_the_difference(browser, make_run, tmp_path):
    folder = make_run("masked", pictures=1)
    mask = np.full((64, 128, 3), 255, np.uint8)
    mask[48:] = 0
    cv2.imwrite(str(folder / "mask.png"), mask)
    write_report([folder], tmp_path / "masked.html")
    browser.open(tmp_path / "masked.html")
    browser.evaluate("document.querySelector('.pano').scrollIntoView()")
    browser.wait("document.querySelector('.pano[data-started]')")
    browser.evaluate("document.querySelector('[data-mode=difference]').click()")
    browser.wait("document.querySelector('img.cover').naturalWidth > 0")
    assert browser.evaluate("!document.querySelector('img.cover').hidden")
    alpha = "(() => { const c = document.createElement('canvas'), i = document.querySelector('img.cover'); "
    alpha += "c.width = i.naturalWidth; c.height = i.naturalHeight; const x = c.getContext('2d'); "
    alpha += "x.drawImage(i, 0, 0); "
    alpha += "return [0.1, 0.9].map(y => x.getImageData(5, y * c.height, 1, 1).data[3]); })()"
    assert browser.evaluate(alpha) == [0, 255]


def test_what_was_left_out_of_a_frame_is_tinted_on_it_and_not_on_its_render(browser, make_run, tmp_path):
    folder = make_run("moving", pictures=1)
    seen = np.full((64, 128), 255, np.uint8)
    seen[:, 64:] = 0
    frame = next((folder / "renders").glob("??????.jpg")).stem
    (folder / "moving").mkdir()
    cv2.imwrite(str(folder / "moving" / f"{frame}.png"), seen)
    write_report([folder], tmp_path / "moving.html")
    browser.open(tmp_path / "moving.html")
    browser.evaluate("document.querySelector('.pano').scrollIntoView()")
    browser.wait("document.querySelector('.pano[data-started]')")
    browser.wait("document.querySelector('img.tint').naturalWidth > 0")
    for mode, shown in (("truth", True), ("render", False), ("difference", False), ("compare", True)):
        browser.evaluate(f"document.querySelector('[data-mode={mode}]').click()")
        assert browser.evaluate("!document.querySelector('img.tint').hidden") == shown
    pixel = "(() => { const c = document.createElement('canvas'), i = document.querySelector('img.tint'); "
    pixel += "c.width = i.naturalWidth; c.height = i.naturalHeight; const x = c.getContext('2d'); "
    pixel += "x.drawImage(i, 0, 0); "
    pixel += "return [0.1, 0.9].map(u => [...x.getImageData(u * c.width, 5, 1, 1).data]); })()"
    left, right = browser.evaluate(pixel)
    assert left[3] == 0
    assert right[0] > right[2] + 100
    assert right[3] > 100
