from __future__ import annotations

import html
import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest

from panobench.cli.main import run as panobench
from panobench.errors import UnknownNameError, UsageError
from panobench.report import images
from panobench.report.build import choose_format, write_report
from panobench.report.html import safe_json, whole_options
from panobench.splat.ply import write_ply

EVIL = "<script>window.pwned=1</script>\"'><img src=x onerror=window.pwned=1>"


class Structure(HTMLParser):
    """Counts elements and collects ids, links and picture sources."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: dict[str, int] = {}
        self.ids: list[str] = []
        self.links: list[str] = []
        self.handlers: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] = self.tags.get(tag, 0) + 1
        for name, value in attrs:
            if name == "id":
                self.ids.append(str(value))
            if name in ("href", "src"):
                self.links.append(str(value))
            if name.startswith("on"):
                self.handlers.append(name)


def page(runs, tmp_path, **options) -> str:
    write_report(runs, tmp_path / "report.html", **options)
    return (tmp_path / "report.html").read_text(encoding="utf-8")


def data_of(text: str):
    return json.loads(re.search(r'id="report-data">(.*?)</script>', text, re.DOTALL).group(1))


def test_names_from_data_are_inert_everywhere(make_run, tmp_path):
    spec = {"preset": EVIL, "settings": {EVIL: EVIL}}
    folder = make_run(
        "a", method=EVIL, dataset=EVIL, sequence=EVIL, spec=spec, log=EVIL, status="crashed", message=EVIL
    )
    text = page([folder, make_run("b", method="other", dataset=EVIL, sequence=EVIL)], tmp_path, title=EVIL)
    found = Structure(text)
    plain = Structure(page([make_run("c"), make_run("d", method="other")], tmp_path))
    assert found.tags["script"] == plain.tags["script"]
    assert found.tags.get("img", 0) == plain.tags.get("img", 0)
    assert found.handlers == []
    assert "window.pwned=1</script>" not in text
    assert data_of(text)["viewers"]["seq0"]["runs"][0]["label"].startswith("<script>")


def test_json_in_a_script_element_cannot_end_it():
    text = str(safe_json({"a": "</script><!--<script>&\u2028"}))
    assert "<" not in text
    assert "\u2028" not in text
    assert json.loads(text) == {"a": "</script><!--<script>&\u2028"}


def test_page_is_self_contained_and_well_formed(suite, tmp_path):
    text = page([suite], tmp_path)
    found = Structure(text)
    assert all(link.startswith(("#", "data:")) for link in found.links)
    assert len(found.ids) == len(set(found.ids))
    assert all(link[1:] in found.ids for link in found.links if link.startswith("#"))
    assert not re.search(r"(?:src|href)=[\"']?(?:https?:)?//", text)
    assert "connect-src" in text or "default-src 'none'" in text
    assert len(text) < 10_000_000


def test_failures_and_unreadable_runs_are_shown(suite, tmp_path):
    (suite / "bad").mkdir()
    (suite / "bad" / "run.json").write_text("{")
    text = page([suite], tmp_path)
    assert "Segmentation fault" in text
    assert "unreadable" in text
    assert "not valid JSON" in text


def test_a_run_with_nothing_but_its_status_makes_a_page(tmp_path):
    folder = tmp_path / "bare"
    folder.mkdir()
    (folder / "run.json").write_text('{"schema": 1, "status": "crashed"}')
    text = page([folder], tmp_path)
    assert "crashed" in text
    assert data_of(text)["figures"] == {}


def test_single_run_lists_its_measurements_and_says_why_one_is_missing(make_run, edit, tmp_path):
    folder = make_run("a")
    edit(folder, lambda d: d.update(notes={"lpips": "n/a: no AlexNet weights"}))
    text = page([folder], tmp_path)
    assert "n/a: no AlexNet weights" in text
    assert 'panobench run <span class="option">--method</span> panogs' in text
    assert "21\u202f034 Gaussians" in text


def test_equal_pictures_are_stored_once(make_run, tmp_path):
    runs = [make_run("a"), make_run("b", method="other")]
    assert len(data_of(page(runs, tmp_path))["images"]) == 6  # 2 truths, 2 renders, depth, confidence


def test_full_size_pictures_go_beside_the_page(make_run, tmp_path):
    data = data_of(page([make_run("a")], tmp_path, assets=True))
    for link in data["links"].values():
        assert (tmp_path / link).is_file()
    assert len(data["links"]) == 6


def test_pictures_are_scaled_to_the_budget(tmp_path):
    rng = np.random.default_rng(0)
    path = tmp_path / "noise.jpg"
    cv2.imwrite(str(path), rng.integers(0, 255, (256, 512, 3), dtype=np.uint8))
    few, many = images.plan([[path] * 20]), images.plan([[path] * 20] * 60)
    assert few.frames > many.frames
    picture = images.encode_file(path, many.width, many.quality)
    assert 60 * 2 * many.frames * len(picture.uri) < images.BUDGET
    assert images.encode_file(tmp_path / "absent.jpg", 100) is None
    (tmp_path / "text.jpg").write_text("no picture")
    assert images.encode_file(tmp_path / "text.jpg", 100) is None


def test_depth_in_16_bits_is_coloured_with_unknown_in_grey():
    depth = np.zeros((4, 8), np.float32)
    depth[:, :4] = np.linspace(1000, 4000, 4)
    picture = images.colour_depth(depth)
    assert (picture[:, 4:] == 128).all()
    assert len(np.unique(picture[:, :4].reshape(-1, 3), axis=0)) == 4


def test_formats_are_told_by_suffix_or_name(tmp_path):
    assert choose_format(tmp_path / "a.tex", None) == "latex"
    assert choose_format(tmp_path / "a.bin", "csv") == "csv"
    with pytest.raises(UsageError, match="cannot tell"):
        choose_format(tmp_path / "a.bin", None)
    with pytest.raises(UnknownNameError, match="did you mean 'markdown'"):
        choose_format(tmp_path / "a.md", "markdwn")


def test_command_writes_every_format_and_reports_bad_input(suite, tmp_path, capsys):
    for suffix in ("html", "tex", "csv", "md", "json"):
        assert panobench(["report", str(suite), "-o", str(tmp_path / f"r.{suffix}")]) == 0
        assert (tmp_path / f"r.{suffix}").stat().st_size > 500
    assert "8 runs" in capsys.readouterr().out
    assert panobench(["report", str(suite), "-o", str(tmp_path / "x.csv"), "--table", "runz"]) == 2
    assert "did you mean 'runs'" in capsys.readouterr().err
    assert panobench(["report", str(tmp_path / "absent")]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert not list(tmp_path.glob(".*"))


def test_reports_need_neither_torch_nor_numba(make_run, tmp_path):
    code = (
        "import sys; from pathlib import Path; from panobench.report.build import write_report;"
        f"write_report([Path({str(make_run('a'))!r})], Path({str(tmp_path / 'r.html')!r}));"
        "assert not {'torch', 'numba'} & set(sys.modules), 'heavy import'"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=500)


def test_pictures_shrink_until_the_page_fits(make_run, tmp_path):
    folder = make_run("a", pictures=1)
    noise = np.random.default_rng(0).integers(0, 255, (512, 1024, 3), np.uint8)
    for path in (folder / "renders").glob("000*"):
        cv2.imwrite(str(path), noise)
    sizes = []
    for limit in (10.0, 2.6, 2.3):
        write_report([folder], tmp_path / "r.html", max_mb=limit)
        sizes.append((tmp_path / "r.html").stat().st_size)
        assert sizes[-1] <= limit * 1e6
    assert sizes == sorted(sizes, reverse=True)
    with pytest.raises(UsageError, match="--max-mb 1"):
        write_report([folder], tmp_path / "r.html", max_mb=1)


def test_a_published_page_does_not_say_where_files_lie(make_run, edit, tmp_path):
    folder = make_run("a", log="Traceback\n  File '/home/me/code/x.py', line 3\nread /mnt/data/walk.mp4: 3/4 frames")
    edit(
        folder, lambda d: d["provenance"].update(root="/mnt/data/rooms", command="panobench run --root /mnt/data/rooms")
    )
    edit(folder, lambda d: d.update(status="crashed", message="cannot read /mnt/data/rooms/a.png (https://x.org/a/b)"))
    write_report([folder], tmp_path / "r.html", hide_paths=True)
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert "/mnt/" not in text
    assert "/home/" not in text
    assert str(tmp_path) not in text
    for kept in ("…/rooms", "…/x.py", "…/a.png", "https://x.org/a/b", "3/4 frames"):
        assert kept in text, kept
    write_report([folder], tmp_path / "r.html")
    assert "/mnt/data/rooms" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_what_was_hidden_from_a_method_is_drawn_and_said(make_run, edit, tmp_path):
    folder = make_run("run", pictures=0, depth=False)
    (folder / "renders").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "renders" / "hidden.jpg"), np.full((32, 64, 3), 90, np.uint8))
    mask = {"source": "geometry", "message": "13.4% moves", "found": 0.134, "hidden": 0.2}
    edit(folder, lambda d: d.update(mask=mask))
    text = page([folder], tmp_path)
    assert "What was hidden from the method" in text
    assert "20.0% of the view is hidden (red), 13.4% by geometry. 13.4% moves." in text
    assert len(data_of(text)["images"]) == 1


def test_what_a_method_left_out_is_said_without_a_mask_too(make_run, edit, tmp_path):
    folder = make_run("run", pictures=0, depth=False)
    (folder / "renders").mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "renders" / "hidden.jpg"), np.full((32, 64, 3), 90, np.uint8))
    edit(folder, lambda d: d.update(moving={"frames": 7, "mean": 0.05, "most": 0.125}))
    text = page([folder], tmp_path)
    assert "left out what moves by itself (yellow) in 7 frames: 5.0% of the view on average, 12.5% at most." in text
    assert "of the view is hidden (red)" not in text


def test_frames_carry_a_tint_where_something_was_hidden_in_them(make_run, tmp_path):
    folder = make_run("run", pictures=2, depth=False)
    shown = sorted(int(p.stem) for p in (folder / "renders").glob("??????.jpg"))
    seen = np.full((64, 128), 255, np.uint8)
    seen[:, :32] = 0
    (folder / "moving").mkdir()
    cv2.imwrite(str(folder / "moving" / f"{shown[0]:06d}.png"), seen)
    [viewer] = data_of(page([folder], tmp_path))["viewers"].values()
    assert list(viewer["runs"][0]["tints"]) == [str(shown[0])]


def test_maps_and_pages_to_walk_through_them_go_beside_the_page(make_run, tmp_path):
    folder = make_run("a")
    rng = np.random.default_rng(0)
    write_ply(folder / "map.ply", *(rng.normal(size=s) for s in ((60, 3), (60, 3), (60, 4), (60,), (60, 3))))
    damaged = make_run("b", method="other")
    (damaged / "map.ply").write_text("ply\n")
    text = page([folder, damaged], tmp_path, assets=True)
    links = re.findall(r'href="([^"]+/walk-\d+\.html)"', text)
    assert len(links) == 1
    assert "panogs on room1" in (tmp_path / links[0]).read_text(encoding="utf-8")
    assert "walk-" not in page([folder], tmp_path), "without --assets there is one file"


def test_options_of_a_command_do_not_break_and_stay_as_they_are() -> None:
    command = "panobench run --max-frames 120 -o 'a b--c' --set x.y=<1>"
    made = str(whole_options(command))
    assert made.count('<span class="option">') == 3
    assert html.unescape(re.sub(r"</?span[^>]*>", "", made)) == command
