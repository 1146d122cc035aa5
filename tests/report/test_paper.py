"""Figures and tables for papers."""

from __future__ import annotations

import io
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from fake_runs import write_run

import panobench
from panobench.bench.records.study_record import StudyResult, write_study
from panobench.cli.main import run as command
from panobench.errors import UnknownNameError, UsageError
from panobench.report.build import write_report
from panobench.report.collect import collect
from panobench.report.paper.style import PALETTE, Style, parse_formats, parse_width
from panobench.report.paper.write import figures_of, typical, write_figures
from panobench.studies.basin_figures import contour, surface


def drawn(folder: Path, name: str, names: dict[str, str] | None = None):
    """The figure of that name of the runs below a folder."""
    found = dict(figures_of(collect([folder]), names or {}))
    return found[name](Style(3.4))


@pytest.mark.parametrize(("text", "inches"), [("3.4in", 3.4), ("86mm", 86 / 25.4), ("245pt", 3.39), ("5", 5.0)])
def test_widths_have_units(text, inches):
    assert parse_width(text) == pytest.approx(inches, abs=1e-3)


@pytest.mark.parametrize("text", ["", "wide", "3.4.1in", "0.2in", "3km", "nan"])
def test_other_widths_are_refused(text):
    with pytest.raises(UsageError):
        parse_width(text)


def test_formats_are_checked():
    assert parse_formats("pdf, SVG,pdf") == ("pdf", "svg")
    with pytest.raises(UnknownNameError):
        parse_formats("png")


def test_files_have_the_width_asked_for_and_their_fonts(suite, tmp_path):
    written = write_figures(collect([suite]), tmp_path / "f", 3.4, ("pdf", "svg"))
    names = {path.name for path in written}
    assert {"rooms-room1-paths.pdf", "rooms-room1-error.svg", "rooms-room1-pictures.pdf"} <= names
    assert {"rooms-room2-paths.pdf", "accuracy-speed.svg"} <= names
    for path in written:
        data = path.read_bytes()
        if path.suffix == ".svg":
            assert float(re.search(rb'width="([\d.]+)pt"', data)[1]) == pytest.approx(3.4 * 72, abs=0.1)
            assert b"<text" not in data, "text would need the reader's fonts"
        else:
            assert float(re.search(rb"/MediaBox \[ 0 0 ([\d.]+)", data)[1]) == pytest.approx(3.4 * 72, abs=0.1)
            assert b"/FontFile2" in data
            assert b"/Type3" not in data
    again = write_figures(collect([suite]), tmp_path / "g", 3.4, ("pdf", "svg"))
    assert [p.read_bytes() for p in again] == [p.read_bytes() for p in written], "the same runs give the same files"


def test_a_path_is_coloured_by_its_error(tmp_path):
    write_run(tmp_path / "a", method="near", noise=0.001, pictures=0)
    write_run(tmp_path / "b", method="far", noise=0.02, pictures=0)
    figure = drawn(tmp_path, "rooms-room1-paths", {"far": "Far & away"})
    panels = [axis for axis in figure.axes if axis.collections and axis.lines]
    assert [axis.get_title().splitlines()[0] for axis in panels] == ["Far & away", "near"]
    errors = collect([tmp_path]).runs[0].errors.translation * 1e3
    shown = np.asarray(panels[0].collections[0].get_array())
    assert shown == pytest.approx((errors[:-1] + errors[1:]) / 2)
    limits = {axis.collections[0].get_clim() for axis in panels}
    assert len(limits) == 1, "one scale for all panels"


def test_a_lost_method_does_not_shrink_the_others(tmp_path):
    write_run(tmp_path / "a", pictures=0)
    write_run(tmp_path / "b", method="lost", noise=50.0, status="lost", pictures=0)
    for axis in drawn(tmp_path, "rooms-room1-paths").axes[:2]:
        low, high = axis.get_xlim()
        assert high - low < 3.0


def test_the_error_is_drawn_over_time_and_given_poses_have_none(tmp_path, edit):
    write_run(tmp_path / "a", method="one", noise=0.002, pictures=0)
    given = write_run(tmp_path / "b", method="two", noise=0.0, pictures=0)
    edit(given, lambda d: d["depth"].update(poses_given=True))
    axis = drawn(tmp_path, "rooms-room1-error").axes[0]
    assert len(axis.lines) == 1
    assert axis.get_ylabel() == "Position error [mm]"
    errors = collect([tmp_path]).runs[0].errors
    assert axis.lines[0].get_ydata() == pytest.approx(errors.translation * 1e3)


def test_accuracy_stands_against_speed(tmp_path):
    write_run(tmp_path / "a", noise=0.002, fps=4.0, pictures=0)
    write_run(tmp_path / "b", method="sparse", noise=0.004, fps=25.0, pictures=0)
    figure = drawn(tmp_path, "accuracy-speed")
    points = sorted(tuple(c.get_offsets()[0]) for c in figure.axes[0].collections)
    assert points == [pytest.approx((4.0, 2e-3 * 3**0.5 * 1e3)), pytest.approx((25.0, 4e-3 * 3**0.5 * 1e3))]
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["panogs", "sparse"]


def test_strips_show_frame_render_and_difference(tmp_path):
    write_run(tmp_path / "a", pictures=3)
    figure = drawn(tmp_path, "rooms-room1-pictures")
    rows = np.array(figure.axes).reshape(3, 3)
    frame, render, difference = (np.asarray(axis.images[0].get_array()) for axis in rows[1])
    assert frame.shape == render.shape == (64, 128, 3)
    assert difference == pytest.approx(np.clip(4 * np.abs(frame.astype(float) - render).mean(axis=2) / 255, 0, 1))
    write_run(tmp_path / "b", method="other", pictures=2)
    rows = np.array(drawn(tmp_path, "rooms-room1-pictures").axes).reshape(2, 3)
    assert [axis.get_ylabel() for axis in rows[:, 0]] == ["other", "panogs"]


def test_studies_charts_are_drawn_and_surfaces_are_not(tmp_path):
    grid = np.linspace(-0.5, 0.5, 9)
    starts = [{"distance": 0.1, "direction": 0.0, "converged": True}]
    measured = {"360°": {"offsets": grid.tolist(), "loss": np.add.outer(grid**2, grid**2).tolist(), "starts": starts}}
    lines = {"x": [120, 360], "y": [4.0, 0.5], "name": "room1", "mode": "lines+markers"}
    fov = {"data": [lines], "layout": {"xaxis": {"title": {"text": "FoV [°]"}, "tickvals": [120, 360]}}}
    figures = {"plane": contour("360°", measured), "height": surface("360°", measured), "fov": fov}
    write_study(tmp_path / "s", StudyResult("basin", {"basin": [{"a": 1.0}]}, figures), {})
    collection = collect([tmp_path])
    written = {p.name for p in write_figures(collection, tmp_path / "f", 3.0, ("pdf",))}
    assert written == {"basin-plane.pdf", "basin-fov.pdf"}
    axis = drawn(tmp_path, "basin-fov").axes[0]
    assert axis.get_xlabel() == "FoV [°]"
    assert list(axis.lines[0].get_ydata()) == [4.0, 0.5]


def test_of_repeats_the_median_is_drawn(tmp_path):
    for k, noise in enumerate((0.003, 0.001, 0.002)):
        write_run(tmp_path / f"r{k}", seed=k, noise=noise, pictures=0)
    assert typical(collect([tmp_path]).runs).folder.name == "r2"


def test_colours_stay_apart_for_colour_blind_eyes():
    """Deuteranopia by Viénot, Brettel and Mollon (1999), distances in linear light's cube roots."""
    blind = np.array([[0.293, 0.707, 0.0], [0.293, 0.707, 0.0], [-0.022, 0.022, 1.0]])
    rgb = np.array([[int(c[k : k + 2], 16) / 255 for k in (1, 3, 5)] for c in PALETTE])
    seen = np.cbrt(np.clip(rgb**2.2 @ blind.T, 0, 1))
    apart = [np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[:i]]
    assert min(apart) > 0.1


@pytest.mark.skipif(
    shutil.which("pdflatex") is None or subprocess.run(["kpsewhich", "pgf.sty"], capture_output=True).returncode != 0,
    reason="needs pdflatex and pgf",
)
def test_pgf_compiles_in_a_paper(tmp_path):
    write_run(tmp_path / "a", method="50%_odd & names", pictures=1)
    folder = tmp_path / "f"
    written = write_figures(collect([tmp_path]), folder, 3.0, ("pgf",))
    assert {p.name for p in written} == {f"rooms-room1-{n}.pgf" for n in ("paths", "error", "pictures")}
    body = "\n\n".join(rf"\input{{{path.name}}}" for path in written)
    preamble = r"\documentclass{article}\usepackage[T1]{fontenc}\usepackage{pgf}"
    (folder / "p.tex").write_text(rf"{preamble}\begin{{document}}{body}\end{{document}}")
    done = subprocess.run(
        ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "p.tex"], cwd=folder, capture_output=True
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert b"Overfull" not in done.stdout


def test_the_command_writes_figures(suite, tmp_path, capsys):
    arguments = ["report", str(suite), "--figures", str(tmp_path / "f"), "--width", "86mm", "--figure-format", "svg"]
    assert command(arguments) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines
    assert all(Path(line).is_file() for line in lines)
    assert command([*arguments[:-1], "png"]) == 2


def test_figures_from_python(suite, tmp_path):
    written = panobench.load(suite).figures(tmp_path / "f", width="86mm", formats="svg")
    assert {path.name for path in written} >= {"rooms-room1-paths.svg", "accuracy-speed.svg"}
    assert all(path.is_file() for path in written)


def two_datasets(folder: Path) -> Path:
    for dataset, sequences in {"rooms": ("room1", "room2"), "palvio": ("ID01",)}.items():
        for k, sequence in enumerate(sequences):
            for method, noise in (("panogs", 0.002), ("sparse", 0.004)):
                place = {"dataset": dataset, "sequence": sequence}
                write_run(folder / f"{dataset}{k}{method}", method=method, noise=noise, pictures=0, **place)
    return folder


def test_one_accuracy_table_spans_datasets(tmp_path):
    store = two_datasets(tmp_path / "s")
    target = tmp_path / "t.tex"
    write_report([store], target, tables=["ate"], rename={"panogs": "PanoGS-SLAM", "rooms": "Rooms"})
    text = target.read_text()
    assert text.count(r"\begin{table") == 1
    assert r"\multicolumn{1}{c}{palvio} & \multicolumn{4}{c}{Rooms}" in text
    assert r"\cmidrule(lr){2-2}\cmidrule(lr){3-6}" in text
    assert "PanoGS-SLAM & " in text
    row = next(line for line in text.splitlines() if line.startswith("PanoGS-SLAM"))
    assert row.count("&") == 5


def test_columns_are_chosen_ordered_and_renamed(tmp_path):
    store = two_datasets(tmp_path / "s")
    target = tmp_path / "t.md"
    write_report([store], target, tables=["ate"], columns=["mean", "room2"], rename={"room2": "Room 2"})
    heading = next(line for line in target.read_text().splitlines() if line.startswith("| Method"))
    assert heading == "| Method | rooms, Geom. mean \\[mm\\] | rooms, Room 2 \\[mm\\] |"
    with pytest.raises(UnknownNameError):
        write_report([store], target, tables=["ate"], columns=["room9"])
    with pytest.raises(UnknownNameError):
        write_report([store], target, tables=["rpe"])


def test_the_long_form_of_all_datasets_names_each(tmp_path):
    pandas = pytest.importorskip("pandas")
    store = two_datasets(tmp_path / "s")
    write_report([store], tmp_path / "t.csv", tables=["ate"])
    table = pandas.read_csv(tmp_path / "t.csv")
    rows = table[(table.quantity == "ate_rmse") & (table.label == "panogs")]
    assert sorted(zip(rows.dataset, rows.sequence)) == [("palvio", "ID01"), ("rooms", "room1"), ("rooms", "room2")]
    assert rows.value.tolist() == pytest.approx([2e-3 * 3**0.5 * 1e3] * 3)


def test_parquet_holds_what_the_csv_holds(tmp_path):
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("fastparquet")
    store = two_datasets(tmp_path / "s")
    command(["report", str(store), "-o", str(tmp_path / "t.parquet"), "--table", "runs"])
    command(["report", str(store), "-o", str(tmp_path / "t.csv"), "--table", "runs"])
    found = pandas.read_parquet(tmp_path / "t.parquet")
    text = pandas.read_csv(io.StringIO((tmp_path / "t.csv").read_text()))
    assert list(found.columns) == list(text.columns)
    assert len(found) == len(text) > 20
    assert found.value.to_numpy() == pytest.approx(text.value.to_numpy(), nan_ok=True)
    assert found.failed.dtype == bool
    assert found.method.tolist() == text.method.tolist()
