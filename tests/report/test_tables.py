from __future__ import annotations

import csv
import io
import json
import math
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from panobench.bench.records.paper import Published, load_published
from panobench.bench.records.study_record import StoredStudy, StudyResult
from panobench.report.build import write_report
from panobench.report.collect import collect
from panobench.report.exports import FORMATS, csv_text, latex_text
from panobench.report.headline import tiles
from panobench.report.model import Collection
from panobench.report.ranking import failure, ranks
from panobench.report.studies import study_tables
from panobench.report.table_model import format_number, length_text
from panobench.report.tables import build_tables
from panobench.report.variants import variants

PUBLISHED = Published(
    "A paper",
    "a machine",
    {
        "synpano_ate_rmse_m": {
            "sequences": ["room1", "room2"],
            "ORB-SLAM3": [0.015, None],
            "PanoGS-SLAM": [0.005, 0.018],
        }
    },
)


def table(collection: Collection, name: str, published: Published | None = None):
    return next(t for t in build_tables(collection, published) if t.name == name)


def by_label(found):
    return {row.cells[0].text: dict(zip([c.key for c in found.columns], row.cells)) for row in found.rows}


def test_accuracy_table_ranks_medians_and_shows_coverage_and_failures(suite):
    rows = by_label(table(collect([suite]), "ate-rooms"))
    assert next(iter(rows)) == "panogs"
    panogs, sparse, imported = rows["panogs"], rows["sparse"], rows["imported-slam"]
    assert panogs["room1"].text == "1.73"
    assert panogs["room1"].rank == 1
    assert panogs["room1"].repeats == 3
    assert "n = 3" in panogs["room1"].spread
    assert sparse["room1"].rank == 2
    assert sparse["room2"].text == "/"
    assert sparse["room2"].failed
    assert sparse["room2"].coverage == pytest.approx(0.6)
    assert imported["room2"].about == "crashed"
    assert panogs["succeeded"].text == "2/2"
    assert panogs["mean"].value == panogs["room1"].value  # only room1 is common to all
    assert panogs["mean"].rank == 1


def test_low_coverage_and_large_errors_fail_whatever_the_status_says(make_run):
    runs = [make_run("low", tracked=0.85), make_run("far", metrics={"ate_rmse_m": 3.2}), make_run("fine")]
    reasons = {r.folder.name: failure(r) for r in collect(runs).runs}
    assert reasons == {"low": "tracked 85%", "far": "ATE over 3 m", "fine": None}


def test_failed_repeats_count_as_worst(make_run):
    make_run("a", noise=0.001)
    make_run("b", seed=1, noise=0.003)
    make_run("c", seed=2, status="crashed")
    folder = make_run("d", method="other", noise=0.002).parent
    make_run("e", method="other", seed=1, status="timeout")
    rows = by_label(table(collect([folder]), "ate-rooms"))
    assert rows["panogs"]["room1"].value == pytest.approx(3 * math.sqrt(3))
    assert rows["panogs"]["room1"].about == "1 of 3 repeats failed"
    assert rows["other"]["room1"].failed


def test_another_protocol_has_judged_by_its_own_limits(make_run, edit):
    folder = make_run("a", tracked=0.6)
    assert failure(collect([folder]).runs[0]) == "tracked 60%"
    edit(folder, lambda d: d.update(protocol="1.0+min_tracked=0.5"))
    assert failure(collect([folder]).runs[0]) is None


def test_runs_with_true_depth_are_flagged(make_run, edit):
    folder = make_run("a")
    edit(folder, lambda d: d["depth"].update(oracle=True))
    found = table(collect([folder, make_run("b", method="other")]), "ate-rooms")
    assert {row.cells[0].text: row.flags for row in found.rows} == {"panogs": ("true depth",), "other": ()}
    assert "(true depth)" in FORMATS["markdown"]([found])


def test_given_poses_are_flagged_and_compete_with_nobody(make_run, edit):
    folder = make_run("a", method="reconstruct", noise=0.0)
    edit(folder, lambda d: d["depth"].update(poses_given=True))
    edit(folder, lambda d: d["metrics"].update(ate_rmse_m=1e-16, pano_psnr_db=60.0, psnr_db=60.0))
    others = [make_run("b", method="good", noise=0.001), make_run("c", method="worse", noise=0.01)]
    collection = collect([folder, *others])
    found = table(collection, "ate-rooms")
    assert [row.cells[0].text for row in found.rows] == ["good", "worse", "reconstruct"]
    assert [row.cells[1].rank for row in found.rows] == [1, 2, None]
    assert found.rows[-1].flags == ("given poses",)
    assert any("not ranked" in note for note in found.notes)
    rendering = {row.cells[0].text: row for row in table(collection, "rendering").rows}
    assert all(cell.rank is None for cell in rendering["reconstruct"].cells)
    assert any(cell.rank == 1 for cell in rendering["good"].cells)
    assert "reconstruct" not in " ".join(tile.note for tile in tiles(collection, variants(collection)))
    alone = collect([folder])
    assert [t.name for t in build_tables(alone)] == [t.name for t in build_tables(collection)]
    assert "ATE RMSE" not in [tile.name for tile in tiles(alone, variants(alone))]


def test_equal_printed_values_share_a_rank():
    assert ranks(["1.0", "1.0", "1.2", "3"], [1.0, 1.01, 1.2, 3.0], "lower") == [1, 1, 2, None]
    assert ranks(["1", "2"], [1.0, 2.0], "higher") == [2, 1]
    assert ranks(["1"], [1.0], "lower") == [None]
    assert ranks(["1", "2"], [1.0, 2.0], "none") == [None, None]


def test_published_rows_stand_apart_and_are_never_ranked(suite):
    found = table(collect([suite]), "ate-rooms", PUBLISHED)
    rows = by_label(found)
    assert [row.origin for row in found.rows][-2:] == ["published", "published"]
    assert rows["ORB-SLAM3"]["room1"].text == "15.0"
    assert rows["ORB-SLAM3"]["room2"].failed
    assert all(c.rank is None for row in found.rows if row.origin == "published" for c in row.cells)
    assert rows["panogs"]["room1"].rank == 1
    assert any("A paper" in note for note in found.notes)
    assert any("modelled after" in note for note in found.notes)


def test_means_are_geometric_over_the_sequences_all_succeed_on(make_run):
    make_run("a", noise=0.001)
    make_run("b", noise=0.004, sequence="room2")
    make_run("c", noise=0.001, method="other")
    folder = make_run("d", noise=0.009, sequence="room2", method="other").parent
    rows = by_label(table(collect([folder]), "ate-rooms", PUBLISHED))
    assert rows["panogs"]["mean"].value == pytest.approx(2 * math.sqrt(3))
    assert rows["other"]["mean"].value == pytest.approx(3 * math.sqrt(3))
    assert rows["PanoGS-SLAM"]["mean"].value == pytest.approx(math.sqrt(5 * 18))
    assert rows["ORB-SLAM3"]["mean"].text == "–"


def test_a_method_not_run_everywhere_is_listed_last_and_rules_nothing(make_run):
    make_run("a", noise=0.004)
    make_run("b", noise=0.004, sequence="room2")
    folder = make_run("c", noise=0.001, method="partial").parent
    rows = by_label(table(collect([folder]), "ate-rooms"))
    assert list(rows) == ["panogs", "partial"]
    assert rows["partial"]["succeeded"].text == "1/1"
    assert rows["partial"]["mean"].value is None
    assert rows["panogs"]["mean"].value == pytest.approx(4 * math.sqrt(3))
    assert rows["partial"]["room1"].rank == 1


def test_a_run_that_ended_well_on_a_sequence_without_truth_succeeded(make_run):
    make_run("a")
    make_run("b", sequence="walk", truth=False, metrics={"ate_rmse_m": None})
    make_run("c", method="other", sequence="walk", truth=False, metrics={"ate_rmse_m": None})
    lost = {"sequence": "walk", "truth": False, "metrics": {"ate_rmse_m": None}, "status": "lost", "tracked": 0.5}
    folder = make_run("d", method="unlucky", **lost).parent
    found = table(collect([folder]), "ate-rooms")
    rows = by_label(found)
    assert rows["panogs"]["walk"].text == "n/a"
    assert [rows[name]["succeeded"].text for name in ("panogs", "other", "unlucky")] == ["2/2", "1/1", "0/1"]
    assert {row.cells[0].text: row.facets["status"] for row in found.rows} == {
        **{"panogs": "ok", "other": "ok", "unlucky": "failed"}
    }


def test_errors_against_truth_without_scale_are_shares_of_the_path(make_run):
    folders = [make_run("a", noise=0.004), make_run("b"), make_run("c", method="other", noise=0.003)]
    for folder, sequence in zip(folders, ("room1", "walk", "walk")):
        path = folder / "run.json"
        record = json.loads(path.read_text())
        if sequence == "walk":
            record["groundtruth_scaled"], record["spec"]["sequence"] = False, sequence
            share = record["metrics"].pop("ate_rmse_m") * 10
            record["metrics"] |= {"ate_percent": share}
        path.write_text(json.dumps(record))
    collection = collect([folders[0].parent])
    found = table(collection, "ate-percent-rooms")
    assert found.title == "Trajectory accuracy, rooms, in percent of the path"
    assert "the ground truth has no scale" in found.caption
    assert [(c.key, c.unit) for c in found.columns] == [("method", ""), ("walk", "%")]
    rows = by_label(found)
    assert rows["panogs"]["walk"].text == "0.017"
    assert (rows["panogs"]["walk"].rank, rows["other"]["walk"].rank) == (1, 2)
    assert [c.key for c in table(collection, "ate-rooms").columns] == ["method", "room1"]
    alone = collect([folders[1]])
    assert [t.name for t in build_tables(alone) if t.name.startswith("ate")] == ["ate-percent-rooms"]
    assert ("ATE RMSE", "0.02", "% of the path") in [(t.name, t.value, t.unit) for t in tiles(alone, variants(alone))]


def test_published_rows_need_a_sequence_in_common(make_run):
    alone = make_run("a", sequence="attic")
    assert all(r.origin == "measured" for r in table(collect([alone]), "ate-rooms", PUBLISHED).rows)
    rows = by_label(table(collect([make_run("b").parent]), "ate-rooms", PUBLISHED))
    own = rows["PanoGS-SLAM"]
    assert (own["attic"].text, own["room1"].text, own["succeeded"].text, own["mean"].text) == ("–", "5.00", "1/1", "–")


def test_the_packages_published_figures_are_readable():
    published = load_published()
    assert published is not None
    assert "PanoGS-SLAM" in published.source
    assert published.tables["synpano_ate_rmse_m"]["PanoGS-SLAM"] == [0.005, 0.018, 0.003, 0.003, 0.010]


def test_variants_name_only_what_differs(make_run):
    make_run("a", spec={"preset": "paper", "width": 512})
    make_run("b", spec={"preset": "fast", "width": 512})
    make_run("c", method="sparse", sequence="room2", spec={"width": 256})
    labels = [v.label for v in variants(collect([make_run("d", seed=4, spec={"preset": "fast"}).parent]))]
    assert labels == ["panogs · fast", "panogs · paper", "sparse"]


def test_empty_columns_are_left_out(suite):
    keys = [c.key for c in table(collect([suite]), "rendering").columns]
    assert "lpips" not in keys
    assert "psnr_db" in keys


def test_numbers_print_with_fixed_digits():
    assert format_number(1234.567, 1) == "1\u202f234.6"
    assert [length_text(v, "mm") for v in (0.8123, 12.34, 123.4)] == ["0.81", "12.3", "123"]
    assert length_text(1.8271, "m") == "1.827"


def test_exports_hold_the_same_numbers(suite):
    tables = build_tables(collect([suite]), PUBLISHED)
    latex = FORMATS["latex"](tables)
    assert latex.count(r"\toprule") == latex.count(r"\bottomrule") == latex.count(r"\label") >= len(tables)
    assert "In brackets, the share of frames tracked." in latex
    assert "Below each" not in latex, "exports print nothing below a number"
    assert r"\textbf{1.73}" in latex
    assert r"/ {\scriptsize(60\%)}" in latex
    assert re.search(r"\\textit\{ORB-SLAM3\}.*published", latex)
    markdown = FORMATS["markdown"](tables)
    assert "| **1.73** |" in markdown
    document = json.loads(FORMATS["json"](tables))
    assert [t["name"] for t in document["tables"]] == [t.name for t in tables]
    rows = list(csv.DictReader(io.StringIO(FORMATS["csv"]([t for t in tables if t.name == "runs"]))))
    ate = [row for row in rows if row["quantity"] == "ate_rmse_m"]
    assert len(ate) == 8
    assert (float(ate[0]["value"]) > 0, ate[0]["unit"], ate[0]["width"], ate[0]["camera"]) == (True, "mm", "512", "erp")
    assert sum((row["failed"], row["value"]) == ("1", "") for row in ate) == 2


def test_pandas_reads_every_table_written_as_csv(suite, tmp_path):
    pandas = pytest.importorskip("pandas")
    written = write_report([suite], tmp_path / "all.csv").written
    assert [p.name for p in written] == ["all.csv", "all.ate-rooms.csv", "all.rendering.csv", "all.cost.csv"]
    for path in written:
        read = pandas.read_csv(path)
        assert {"method", "preset", "camera", "width", "quantity", "value", "unit"} <= set(read.columns)
        assert read["value"].dtype.kind == "f"
        assert not read.duplicated(
            ["label", "sequence", "seed", "quantity", "unit"] if path.stem == "all" else None
        ).any()
    ate = pandas.read_csv(written[1]).query("quantity == 'ate_rmse' and method == 'panogs'")
    assert set(ate["sequence"]) == {"room1", "room2"}


def test_latex_fits_the_page(suite, tmp_path):
    program = shutil.which("pdflatex")
    if program is None:
        pytest.skip("needs pdflatex")
    (tmp_path / "tables.tex").write_text(FORMATS["latex"](build_tables(collect([suite]), PUBLISHED)), encoding="utf-8")
    document = (
        r"\documentclass{article}\usepackage[T1]{fontenc}\usepackage{booktabs,graphicx}"
        r"\begin{document}\input{tables}\end{document}"
    )
    (tmp_path / "paper.tex").write_text(document, encoding="utf-8")
    command = [program, "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stdout[-2000:]
    log = (tmp_path / "paper.log").read_text(errors="replace")
    assert "Overfull" not in log
    assert "Float too large" not in log


def test_published_figures_of_whole_sequences_stand_beside_no_part_of_one(make_run, edit):
    folder = make_run("a", spec={"max_frames": 40})
    edit(folder, lambda d: d.update(frames={"given": 40, "planned": 40, "tracked": 40}))
    make_run("b", sequence="room2")
    found = table(collect([folder.parent]), "ate-rooms", PUBLISHED)
    rows = by_label(found)
    assert (rows["PanoGS-SLAM"]["room1"].text, rows["PanoGS-SLAM"]["room2"].text) == ("–", "18.0")
    assert any("room1" in note and "40 frames" in note for note in found.notes)
    assert {row.flags for row in found.rows if row.origin == "published"} == {("other data",)}
    assert all(r.origin == "measured" for r in table(collect([folder]), "ate-rooms", PUBLISHED).rows)


def test_only_what_was_measured_on_the_same_data_competes(make_run, edit):
    short = {"spec": {"max_frames": 20}}
    make_run("a", method="one", noise=0.001, **short)
    make_run("b", method="one", noise=0.002)
    store = make_run("c", method="two", noise=0.003).parent
    rows = by_label(table(collect([store]), "ate-rooms"))
    assert rows["one · 20 frames"]["room1"].rank is None
    assert (rows["one"]["room1"].rank, rows["two"]["room1"].rank) == (1, 2)


def test_a_study_marks_the_best_of_each_disturbance():
    rows = [
        {"Disturbance": what, "Method": name, "ATE [mm] ↓": value}
        for what, name, value in (("blur", "a", 1.0), ("blur", "b", 2.0), ("noise", "a", 5.0), ("noise", "b", 4.0))
    ]
    (found,) = study_tables([StoredStudy(Path("x"), StudyResult("r", {"r": rows}))])
    assert [row.cells[2].rank for row in found.rows] == [1, 2, 2, 1]


def test_a_start_from_constant_depth_is_flagged(make_run, edit):
    folder = make_run("a")
    edit(folder, lambda d: d["depth"].update(source="constant"))
    assert table(collect([folder]), "ate-rooms").rows[0].flags == ("constant depth",)


def test_every_latex_row_has_the_columns_its_head_announces(suite):
    for found in build_tables(collect([suite]), PUBLISHED):
        latex = FORMATS["latex"]([found])
        for line in latex.splitlines():
            if r"\begin{tabular}" in line:
                columns = len(line.split("{")[-1].rstrip("}"))
            if line.endswith(r"\\"):
                assert len(re.findall(r"(?<!\\)&", line)) == columns - 1


def test_names_from_data_cannot_break_an_export(make_run):
    evil = "a_b & <b> | 50% $x$ {\\}\n=1"
    runs = [make_run("a", method=evil), make_run("b")]
    tables = build_tables(collect(runs))
    assert latex_text("_&%$#{}~^\\") == (r"\_\&\%\$\#\{\}\textasciitilde{}\textasciicircum{}\textbackslash{}")
    line = next(x for x in FORMATS["markdown"](tables).splitlines() if "a\\_b" in x)
    assert "<b>" not in line
    assert len(re.findall(r"(?<!\\)\|", line)) == len(tables[0].columns) + 1
    assert csv_text("=HYPERLINK(1)") == "'=HYPERLINK(1)"
    assert csv_text("-1.5") == "-1.5"
    json.loads(FORMATS["json"](tables))


def test_the_best_render_is_named_only_among_pictures_of_one_size(make_run):
    make_run("a", method="one")
    store = make_run("b", method="two").parent
    found = collect([store])
    assert "Highest panorama PSNR" in [t.name for t in tiles(found, variants(found))]
    make_run("c", method="three", spec={"camera": "pinhole"})
    found = collect([store])
    assert "Highest panorama PSNR" not in [t.name for t in tiles(found, variants(found))]
