"""The documentation as a site: complete, without dead links, and its newcomer's tutorial works."""

from __future__ import annotations

import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import pytest
import yaml
from document_blocks import DOCS, blocks, make_environment, run_block

PAGES = sorted(DOCS.rglob("*.md"))
ROOT = DOCS.parent


def titles(nav: Any) -> list[str]:
    """The files a navigation names."""
    if isinstance(nav, str):
        return [nav]
    entries = nav.values() if isinstance(nav, dict) else nav
    return [name for entry in entries for name in titles(entry)]


def anchor(heading: str) -> str:
    words = re.sub(r"[^\w\s-]", "", re.sub(r"`|\*", "", heading)).strip().lower()
    return re.sub(r"[-\s]+", "-", words)


def prose(page: Path) -> str:
    """A page without its code."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    return re.sub(r"`[^`\n]*`", "", text)


def test_every_page_is_in_the_navigation_or_linked_from_one_that_is() -> None:
    named = titles(yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"])
    assert [name for name in named if not (DOCS / name).is_file()] == []
    linked = {(DOCS / name).parent / t.partition("#")[0] for name in named for t in links(DOCS / name)}
    known = {path.resolve() for path in linked} | {DOCS / name for name in named}
    assert [str(p.relative_to(DOCS)) for p in PAGES if p not in known] == []


def links(page: Path) -> list[str]:
    """Targets of a page's links to other pages."""
    return [t for t in re.findall(r"\]\(([^)\s]+)\)", prose(page)) if "://" not in t]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(DOCS)))
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    for target in links(page):
        name, _, place = target.partition("#")
        other = (page.parent / name).resolve() if name else page
        assert other.is_file(), target
        assert other.is_relative_to(DOCS), f"{target} is outside of the site"
        if place:
            headings = re.findall(r"^#+ (.+)$", other.read_text(encoding="utf-8"), re.MULTILINE)
            assert place in [anchor(h) for h in headings], target


def test_the_site_builds(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="needs the extra 'docs'")
    pytest.importorskip("material", reason="needs the extra 'docs'")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-f", str(ROOT / "mkdocs.yml")]
    done = subprocess.run([*command, "-d", str(tmp_path / "site")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "site" / "index.html").read_text(encoding="utf-8")
    assert not re.findall(r'(?:src|href)="https?://fonts', page)


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``walk.mp4``: the first frames of a built-in room."""
    from panobench.datasets.open import open_sequence

    folder = tmp_path_factory.mktemp("walk")
    room = open_sequence("rooms", "tiny+frames16", None, 256)
    video = cv2.VideoWriter(str(folder / "walk.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 10, (256, 128))
    if not video.isOpened():
        pytest.skip("this OpenCV cannot write videos")
    for i in range(len(room)):
        video.write(cv2.cvtColor(room.image(i), cv2.COLOR_RGB2BGR))
    video.release()
    return folder


#: Pages that are read in the repository, not in the site.
OUTSIDE = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "reports").rglob("*.md")),
    *sorted((ROOT / "plugins").glob("*/README.md")),
]


@pytest.mark.parametrize("page", OUTSIDE, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_outside_of_the_site_lead_somewhere(page: Path) -> None:
    for target in links(page):
        assert (page.parent / target.partition("#")[0]).exists(), target


@pytest.mark.parametrize("page", [*PAGES, *OUTSIDE], ids=lambda p: str(p.relative_to(ROOT)))
def test_tables_and_suites_that_pages_name_are_there(page: Path) -> None:
    named = re.findall(r"\breports/[\w./-]+\.(?:md|yaml|svg|jsonl)\b", page.read_text(encoding="utf-8"))
    assert [name for name in named if not (ROOT / name).is_file() and "paper-" not in name] == []


@pytest.mark.parametrize("page", [*PAGES, *OUTSIDE[:2]], ids=lambda p: str(p.relative_to(ROOT)))
def test_lines_fit_a_narrow_editor(page: Path) -> None:
    """Tables and code are exempt: their lines cannot always be broken."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
    assert [line for line in text.split("\n") if len(line) > 120 and not line.startswith(("|", "    "))] == []


def test_the_guide_to_the_code_names_files_that_exist() -> None:
    """Paths are below the repository, the package or a package that is described. NAME and * are placeholders."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("## What the layout was before")[0]
    named = {name for name in re.findall(r"`([\w./*-]+)`", text) if "/" in name or name.endswith((".py", ".md"))}
    known = {name for name in named if not re.search(r"NAME|\*", name)}
    assert len(known) > 20
    methods = ROOT / "panobench" / "methods"
    places = (ROOT, ROOT / "panobench", methods / "panogs", methods / "splatting")
    assert [name for name in sorted(known) if not any((place / name).exists() for place in places)] == []


def test_the_example_report_is_the_only_rendered_page_and_small() -> None:
    """Rendered pages weigh megabytes and change whole: `reports/README.md` says how to make them."""
    done = subprocess.run(["git", "ls-files", "*.html"], cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        pytest.skip("not a git checkout")
    templates = ("panobench/report/templates/", "panobench/datasets/", "panobench/viewer/walk/")
    assert [n for n in done.stdout.split() if not n.startswith(templates)] == ["docs/example-report.html"]
    assert (DOCS / "example-report.html").stat().st_size <= 2e6


@pytest.mark.slow
def test_the_video_tutorial_works_from_the_first_command_to_the_last(walk: Path) -> None:
    environment = make_environment(walk / "venv")
    for block in blocks(DOCS / "tutorial-video.md"):
        small = type(block)(block.language, block.text.replace("--width 512", "--width 256"), block.line)
        run_block(small, walk, environment)
    assert (walk / "walk.html").is_file()
    assert (walk / "runs" / "panogs" / "map.ply").stat().st_size > 1000
    assert "2 methods on walk" in (walk / "walk-report.html").read_text(encoding="utf-8")


#: Options whose value is a name that the registry knows, or, in capitals, the reader's own.
NAMED = {"--method": "MethodSpec", "--dataset": "DatasetSpec", "--camera": "CameraSpec", "--depth": "DepthSpec"}


def commands(text: str) -> list[list[str]]:
    """Words of every `panobench COMMAND ...` in text or blocks, comments and prose left out."""
    found = re.findall(r"panobench ((?:[a-z]+ ?)+[^\n`#|]*)", text.replace("\\\n", " "))
    return [re.split(r"  | - |; ", line)[0].split() for line in found]


@pytest.mark.parametrize("page", [*PAGES, *OUTSIDE], ids=lambda p: str(p.relative_to(ROOT)))
def test_commands_and_options_that_pages_name_exist(page: Path) -> None:
    """The command is there and has the options, and what they name is registered, by a plugin here or a built-in."""
    import typer

    from panobench import specs
    from panobench.cli.commands import COMMANDS
    from panobench.cli.lazy import load_command
    from panobench.plugins import registry

    registered = {option: set(registry().specs(getattr(specs, kind))) for option, kind in NAMED.items()}
    registered["--method"] |= set(re.findall(r'MethodSpec\(\s*"([a-z0-9-]+)"', plugin_sources())) | {
        "compass",
        "rotation",
    }
    for words in commands(page.read_text(encoding="utf-8")):
        if words[0] not in COMMANDS:
            continue
        command: Any = load_command(words[0])
        if hasattr(command, "commands"):
            if len(words) < 2 or words[1] not in command.commands:
                continue
            command = command.commands[words[1]]
        known = {o for p in command.get_params(typer.Context(command)) for o in (*p.opts, *p.secondary_opts)}
        used = {w.partition("=")[0] for w in words if re.fullmatch(r"--[a-z][a-z-]*(=.*)?", w)}
        assert used <= known | {"--help"}, words
        for option, value in pairwise(words):
            name = value.partition(":")[0].strip("\"',.")
            if option in registered and re.fullmatch(r"[a-z0-9-]+", name):
                assert name in registered[option], words


def plugin_sources() -> str:
    return "".join(p.read_text(encoding="utf-8") for p in sorted((ROOT / "plugins").glob("*/src/*/__init__.py")))
