"""Maps, stored runs, suites and studies."""

from __future__ import annotations

import json
import re
import tempfile
from pathlib import Path

import numpy as np
from mutate import Material
from target import Parse, Target, plain, text
from trajectory_targets import TUM

from panobench.errors import InputError


def _ply_material() -> Material:
    from panobench.splat.ply import write_ply

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.ply"
        rng = np.random.default_rng(0)
        write_ply(path, *(rng.normal(size=s) for s in ((3, 3), (3, 3), (3, 4), (3,), (3, 3))))
        binary = path.read_bytes()
    header, body = binary.split(b"end_header\n")
    rows = np.frombuffer(body, "<f4").reshape(3, -1)
    ascii_rows = "\n".join(" ".join(f"{v:.4f}" for v in row) for row in rows).encode() + b"\n"
    ascii_map = header.replace(b"binary_little_endian", b"ascii") + b"end_header\n" + ascii_rows
    big = header.replace(b"little", b"big") + b"end_header\n" + rows.astype(">f4").tobytes()
    words = "ply format ascii binary_big_endian element vertex face property list float double uchar int comment x"
    return Material((binary, ascii_map, big), tuple(w.encode() for w in (words + " end_header rot_0 1.0").split()))


def _parse_ply(path: Path) -> None:
    from panobench.splat.ply import read_ply

    assert all(np.isfinite(values).all() for values in read_ply(path)[:4])


_RUN: dict[str, object] = {
    "schema": 1, "status": "ok", "message": "", "origin": "measured", "protocol": "1.0", "metric": False,
    "spec": {"method": "panogs", "camera": "erp", "dataset": "rooms", "sequence": "room1", "seed": 0, "width": 512,
             "settings": {"a": 1}, "preset": None, "fov": None, "config": {"window": 8}},
    "method": {"name": "panogs", "licence": "GPL", "citation": "", "needs": ["rgb"]},
    "metrics": {"ate_rmse_m": 0.01, "tracked": 1.0, "psnr_db": 30.0, "ssim": 0.9, "lpips": None},
    "timing": {"fps": 4.0, "tracking_fps": 9.0, "latency_p50_s": 0.2, "wall_s": 3.0, "peak_rss_bytes": 1e9},
    "frames": {"given": 6, "planned": 6, "tracked": 6, "held_out": 0}, "keyframes": [0, 3],
    "map": {"file": "map.ply", "gaussians": 100, "bytes": 5000}, "notes": {"novel": "none"},
    "depth": {"source": "bootstrap", "oracle": False, "range": [0.8, 3.9]}, "extra": {"loops": 1},
    "provenance": {"panobench": "0.1.0", "machine": {"cpu": "x", "cores": 2}, "command": "panobench run", "seed": 0},
    "cell": {"key": "k", "identity": "i", "label": "l", "limits": {"timeout_s": 1}, "attempt": 1},
}  # fmt: skip


def _run_json(folder: Path) -> Parse:
    """Everything that reads stored runs: the reader, the report's collector and tables, the gate, scoring again."""
    from panobench.bench.records.compare import Rule, compare, load_runs
    from panobench.bench.records.rescore import Protocol, rescore
    from panobench.bench.suite.store import Store
    from panobench.cli.suite import _row
    from panobench.report.collect import collect
    from panobench.report.exports import FORMATS
    from panobench.report.tables import build_tables

    (folder / "runs" / "a" / "trajectory.tum").write_text(TUM)
    (folder / "runs" / "a" / "groundtruth.tum").write_text(TUM)
    rows = "".join(f"{i},{i / 15:.6f},1,0.2\n" for i in range(6))
    (folder / "runs" / "a" / "frames.csv").write_text("index,time,tracked,latency_s\n" + rows)
    rule = Rule.parse("ate>5%")

    def parse(path: Path) -> None:
        runs = load_runs(folder)
        compare(runs, runs, [rule])
        for stored in Store(folder).runs()[0]:
            _row("x", stored, "")
            assert stored.key is not None
            assert stored.limits is not None
        rescore(path.parent, Protocol())
        tables = build_tables(collect([folder]))
        for export in FORMATS.values():
            export(tables)

    return parse


def _report(folder: Path) -> Parse:
    from panobench.report.build import write_report

    (folder / "a" / "trajectory.tum").write_text(TUM)
    (folder / "a" / "groundtruth.tum").write_text(TUM)
    return lambda path: write_report([folder], folder / "report.html")


_SUITE = """name: demo
methods:
  - panogs
  - {name: sparse, set: {features: 5, levels: 3}, cameras: [erp, "pinhole:front"], options: {depth: constant}}
cameras: [erp]
datasets:
  - {name: rooms, sequences: [room1, room2]}
  - {name: synpano, root: /nowhere, sequences: all, options: {width: 64}}
seeds: [0, 1]
repeats: 2
options: {width: 128, max_frames: 5, timeout_s: 9, memory_gib: 2, holdout: 4}
"""


def _parse_suite(path: Path) -> None:
    from panobench.bench.suite.file import read_suite

    for cell in read_suite(path).cells[:50]:
        assert cell.label
        assert cell.slug
        assert re.fullmatch(r"[A-Za-z0-9_-]+", cell.slug)
        assert json.dumps(cell.to_dict(), default=str)


_STUDY = {
    "schema": 1, "name": "fov", "title": "Field of view", "notes": ["a note"], "captions": {"t": "A table. More."},
    "tables": {"t": [{"field of view": "360", "ATE [mm] \u2193": 1.5, "PSNR [dB] \u2191": "/", "source": "published"},
                     {"field of view": "90", "ATE [mm] \u2193": None, "PSNR [dB] \u2191": 30.0}]},
    "figures": {"f": {"data": [{"x": [0, 1], "y": [1, 2], "type": "scatter"}], "layout": {"title": {"text": "x"}}}},
    "provenance": {"command": "panobench study fov", "quick": True, "options": {"width": "64"}},
}  # fmt: skip


def _study(folder: Path) -> Parse:
    """The reader, and what a report makes of it: exported tables, figures."""
    from panobench.report.collect import collect
    from panobench.report.exports import FORMATS
    from panobench.report.studies import study_section
    from panobench.report.tables import build_tables

    def parse(path: Path) -> None:
        found = collect([folder])
        if found.problems:
            raise InputError(str(found.problems[0]))
        tables = build_tables(found)
        for export in FORMATS.values():
            export(tables)
        for study in found.studies:
            data: dict[str, dict[str, object]] = {"figures": {}}
            study_section(0, study, data)
            json.dumps(data, allow_nan=False)

    return parse


TARGETS = (
    Target("ply", "map.ply", _ply_material, plain(_parse_ply)),
    Target("run-json", "runs/a/run.json", text(json.dumps(_RUN, indent=1), json.dumps(_RUN), words="null true "
           '"lost" "crashed" "imported" [] {} [1] {"a":1} "<script>" Infinity NaN'), _run_json),
    Target("report-html", "a/run.json", text(json.dumps(_RUN)), _report),
    Target("suite", "suite.yaml", text(_SUITE, words="name methods cameras datasets seeds repeats options set preset "
           "root sequences width fov all panogs sparse rooms erp"), plain(_parse_suite)),
    Target("study-json", "fov/study.json", text(json.dumps(_STUDY, indent=1), json.dumps(_STUDY), words='null true '
           '"/" [] {} [1] {"a":1} "<script>" Infinity NaN 1e400'), _study),
)  # fmt: skip
