"""Long and wide load: what grows, and what is left behind.

    python benchmarks/load.py frames --frames 5000 --width 256      # memory of one long run, with a plot
    python benchmarks/load.py suite --cells 500                     # a suite of that many tiny cells
    python benchmarks/load.py suites --suites 4 --cells 20          # several suites at once, on one machine
    python benchmarks/load.py leaks --runs 30                       # descriptors, threads, shared memory, memory

Each prints one JSON line and adds it to --out (default reports/robustness/load.jsonl). Frames are ray-cast while the
run goes on, so a long sequence takes no disk.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from panobench.bench.records.provenance import commit, cpu_model
from panobench.methods.base import MethodContext
from panobench.plugins import registry
from panobench.specs import DepthSpec, MethodSpec
from panobench.testing.sequences import TinySequence, erp_camera
from panobench.types import Frame


def rss_mib() -> float:
    return psutil.Process().memory_info().rss / 2**20


def long_run(options: argparse.Namespace) -> dict[str, Any]:
    """One method over many frames of an endless loop through a small room; memory and latency every few frames."""
    camera = erp_camera(options.width)
    sequence = TinySequence(camera, options.frames)
    depth = registry().get(DepthSpec, "bootstrap").load()
    method = registry().get(MethodSpec, options.method).load()()
    method.start(camera, MethodContext(make_depth=lambda: depth("")))
    rows, latency, tracked = [], [], 0
    step = max(1, options.frames // 200)
    for i, t in enumerate(sequence.times):
        frame = Frame(i, float(t), sequence.image(i))
        clock = time.perf_counter()
        tracked += method.track(frame) is not None
        latency.append(time.perf_counter() - clock)
        if i % step == 0 or i == options.frames - 1:
            rows.append((i, rss_mib(), float(np.median(latency[-step:])), len(psutil.Process().threads())))
    estimate = method.finish()
    table = np.array(rows)
    errors = position_errors(estimate, sequence)
    late = table[:, 0] >= options.frames / 2
    growth = np.polyfit(table[late, 0], table[late, 1], 1)[0] if late.sum() > 2 else 0.0
    plot(table, options)
    return {
        "what": "frames",
        "method": options.method,
        "width": options.width,
        "frames": options.frames,
        "tracked": len(estimate.trajectory) / options.frames,
        "tracked_live": tracked / options.frames,
        "rss_mib_at_start": round(table[0, 1], 1),
        "rss_mib_at_end": round(table[-1, 1], 1),
        "peak_rss_mib": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        "growth_kib_per_frame_second_half": round(1024 * float(growth), 2),
        "latency_ms_first_and_last_tenth": [
            round(1e3 * float(np.median(latency[k : k + len(latency) // 10 + 1])), 2)
            for k in (min(20, len(latency) - 1), len(latency) - len(latency) // 10 - 1)
        ],
        "ate_mm": errors,
        "keyframes": len(estimate.keyframes),
        "gaussians": None if estimate.map is None else len(estimate.map),
        "threads_at_end": int(table[-1, 3]),
    }


def position_errors(estimate: Any, sequence: TinySequence) -> float | None:
    """RMSE after alignment, millimetres."""
    from panobench.geometry import umeyama

    if len(estimate.trajectory) < 3:
        return None
    truth = np.stack([sequence.pose_at(float(t))[:3, 3] for t in estimate.trajectory.times])
    mine = estimate.trajectory.positions
    moved = umeyama(mine, truth).apply_points(mine)
    return round(1e3 * float(np.sqrt(((moved - truth) ** 2).sum(axis=1).mean())), 2)


def plot(table: np.ndarray, options: argparse.Namespace) -> None:
    """Memory and latency over frames, as an SVG beside --out."""
    path = options.out.with_name(f"memory-{options.method}-{options.width}-{options.frames}.svg")
    path.parent.mkdir(parents=True, exist_ok=True)
    w, h, pad = 720, 260, 50
    x = pad + (w - 2 * pad) * table[:, 0] / max(table[-1, 0], 1)
    lines = []
    for column, colour, unit in ((1, "#1f77b4", "MiB resident"), (2, "#d62728", "s per frame")):
        top = float(table[:, column].max()) * 1.05 or 1.0
        y = h - pad - (h - 2 * pad) * table[:, column] / top
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y))
        lines.append(f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="1.5"/>')
        where = 60 if column == 1 else 400
        lines.append(f'<text x="{where}" y="24" fill="{colour}">{unit}, up to {table[:, column].max():.4g}</text>')
    axis = f'<path d="M{pad} {pad}V{h - pad}H{w - pad}" fill="none" stroke="#555"/>'
    axis += f'<text x="{w - pad}" y="{h - 20}" text-anchor="end">frame {int(table[-1, 0])}</text>'
    style = "font-family:sans-serif;font-size:13px"
    body = axis + "".join(lines)
    path.write_text(f'<svg xmlns="http://www.w3.org/2000/svg" width="{w}" height="{h}" style="{style}">{body}</svg>\n')


def suite_text(cells: int, name: str) -> str:
    return (
        f"name: {name}\nmethods: [sparse]\ndatasets: [{{name: rooms, sequences: [tiny]}}]\n"
        f"seeds: {list(range(cells))}\noptions: {{width: 64, max_frames: 2, timeout_s: 600}}\n"
    )


def panobench(*words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "panobench.cli.main", *words]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run_suites(options: argparse.Namespace, count: int) -> dict[str, Any]:
    """``count`` suites at the same time in stores of their own; then each once more, which must do nothing."""
    with tempfile.TemporaryDirectory() as work:
        names = [f"suite{k}" for k in range(count)]
        for name in names:
            (Path(work) / f"{name}.yaml").write_text(suite_text(options.cells, name))
        seconds = []
        rows: list[dict[str, Any]] = []
        for _ in range(2):
            before, clock = shared_memory(), time.perf_counter()
            more = ("--json", "--jobs", str(options.jobs))
            started = [panobench("suite", "run", f"{work}/{n}.yaml", "--out", f"{work}/{n}", *more) for n in names]
            answers = [s.communicate() for s in started]
            seconds.append(round(time.perf_counter() - clock, 1))
            rows = [row for out, _ in answers for row in json.loads(out)]
        statuses = sorted({r["status"] for r in rows})
        left = [str(p) for n in names for p in (Path(work) / n / ".work").glob("*")]
        return {
            "what": "suites" if count > 1 else "suite",
            "suites": count,
            "cells": len(rows),
            "statuses": {s: sum(r["status"] == s for r in rows) for s in statuses},
            "seconds": seconds[0],
            "seconds_again": seconds[1],
            "left_in_work": left,
            "shared_memory_left": sorted(set(shared_memory()) - set(before)),
            "children_left": len(psutil.Process().children(recursive=True)),
        }


def shared_memory() -> list[str]:
    try:
        return os.listdir("/dev/shm")
    except OSError:
        return []


def leaks(options: argparse.Namespace) -> dict[str, Any]:
    """Runs one after another in this process; what is open after the first few and after all of them."""
    from panobench.bench.run.request import RunRequest
    from panobench.bench.run.runner import execute

    process, before = psutil.Process(), shared_memory()
    rows = []
    with tempfile.TemporaryDirectory() as work:
        for k in range(options.runs):
            request = RunRequest(
                method=options.method, sequence="tiny", width=128 if options.method == "sparse" else 64,
                max_frames=options.frames, depth="constant" if options.method != "sparse" else None, seed=k,
            )  # fmt: skip
            execute(request, Path(work) / f"run{k}")
            gc.collect()
            counts = (process.num_fds(), process.num_threads(), threading.active_count())
            rows.append((*counts, rss_mib(), len(gc.get_objects())))
    first = rows[min(4, len(rows) - 1)]
    return {
        "what": "leaks",
        "method": options.method,
        "runs": options.runs,
        "descriptors": [first[0], rows[-1][0]],
        "threads": [first[1], rows[-1][1]],
        "python_threads": [first[2], rows[-1][2]],
        "rss_mib": [round(first[3], 1), round(rows[-1][3], 1)],
        "rss_mib_each_fifth_run": [round(row[3], 1) for row in rows[4::5]],
        "python_objects": [first[4], rows[-1][4]],
        "shared_memory_left": sorted(set(shared_memory()) - set(before)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("frames", "suite", "suites", "leaks"))
    parser.add_argument("--method", default="panogs")
    parser.add_argument("--width", type=int, default=256)
    parser.add_argument("--frames", type=int, default=None, help="frames: 5000; leaks: 14 a run")
    parser.add_argument("--cells", type=int, default=500)
    parser.add_argument("--suites", type=int, default=4)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--out", type=Path, default=Path("reports/robustness/load.jsonl"))
    options = parser.parse_args()
    if options.frames is None:
        options.frames = 14 if options.what == "leaks" else 5000
    clock = time.perf_counter()
    if options.what == "frames":
        found = long_run(options)
    elif options.what == "leaks":
        found = leaks(options)
    else:
        found = run_suites(options, 1 if options.what == "suite" else options.suites)
    found |= {"total_s": round(time.perf_counter() - clock, 1), "cpu": cpu_model(), "commit": commit()}
    print(json.dumps(found))
    options.out.parent.mkdir(parents=True, exist_ok=True)
    with options.out.open("a", encoding="utf-8") as file:
        file.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
