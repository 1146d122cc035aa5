"""What a frame costs panogs: against the number of frames before it, and against the width of the image.

    python benchmarks/cost.py                             # 500 frames, widths 256, 512, 1024; the machine must be quiet
    python benchmarks/cost.py --frames 60 --width-frames 20 --widths 128 256 --out /tmp/cost     # a trial

Writes cost.md and cost.svg into --out (reports/speed). The first run compiles and is thrown away.
"""

from __future__ import annotations

import argparse
import csv
import importlib.metadata
import itertools
import platform
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.provenance import available_cores, commit, cpu_model
from panobench.bench.records.record import RunRecord, read_record
from panobench.bench.records.tables import text_table
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.writing import write_whole

Array = NDArray[np.float64]
#: Frames at the start that bootstrap and the first window fill: shown, not fitted.
START = 50


@dataclass(frozen=True)
class Cost:
    """Per frame: index, seconds in the method, in tracking and in mapping, and Gaussians; and the run's run.json."""

    index: Array
    total: Array
    tracking: Array
    mapping: Array
    gaussians: Array
    run: RunRecord

    def mean_ms(self, values: Array, first: float = 0, last: float = np.inf) -> float:
        """Mean of seconds over frames first..last-1, in milliseconds."""
        chosen = values[(self.index >= first) & (self.index < last)]
        return 1e3 * float(np.nanmean(chosen)) if np.isfinite(chosen).any() else float("nan")


def run(sequence: str, width: int, frames: int, seed: int) -> Cost:
    """One run of panogs with its default options."""
    request = RunRequest(method="panogs", sequence=sequence, width=width, max_frames=frames, seed=seed)
    with tempfile.TemporaryDirectory() as folder:
        done = execute(request, Path(folder) / "run")
        record = read_record(done)
        with (done / "frames.csv").open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    print(f"{sequence} {width} wide: {record.status}, {record.number('fps') or 0.0:.2f} frames/s", flush=True)

    def column(name: str) -> Array:
        return np.array([float(row.get(name) or "nan") for row in rows])

    names = ("index", "latency_s", "tracking_s", "mapping_s", "gaussians")
    return Cost(*(column(name) for name in names), record)


def growth(cost: Cost) -> tuple[list[str], list[list[str]]]:
    """A row for every fifth of the run after its start."""
    header = ["frames", "ms/frame", "tracking ms", "mapping ms", "Gaussians", "ms/frame per 1000 Gaussians"]
    n = len(cost.index)
    edges = np.linspace(min(START, n // 2), n, 6).astype(int)
    rows = []
    for first, last in itertools.pairwise(edges):
        total = cost.mean_ms(cost.total, first, last)
        size = float(np.nanmean(cost.gaussians[first:last]))
        parts = [cost.mean_ms(values, first, last) for values in (cost.tracking, cost.mapping)]
        rows.append(
            [
                f"{first}-{last - 1}",
                f"{total:.1f}",
                *(f"{p:.1f}" for p in parts),
                f"{size:.0f}",
                f"{1e3 * total / size:.2f}",
            ]
        )
    return header, rows


def widths_table(costs: dict[int, Cost]) -> tuple[list[str], list[list[str]]]:
    header = ["image", "frames/s", "ms/frame after the start", "tracking ms", "mapping ms", "Gaussians", "ATE mm"]
    rows = []
    for width, c in costs.items():
        first = min(START, len(c.index) // 2)
        parts = [c.mean_ms(values, first) for values in (c.total, c.tracking, c.mapping)]
        ate = c.run.number("ate_rmse_m")
        rows.append(
            [f"{width}x{width // 2}", f"{c.run.number('fps') or 0.0:.2f}", *(f"{p:.1f}" for p in parts)]
            + [f"{np.nanmax(c.gaussians):.0f}", "/" if ate is None else f"{1e3 * ate:.2f}"]
        )
    return header, rows


def draw(growing: Cost, costs: dict[int, Cost], path: Path) -> None:
    """Both plots beside each other, as SVG."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "panobench"
    from matplotlib import pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
    span = 25 if len(growing.index) >= 200 else 5
    centres, lines = [], {"whole": [], "tracking": [], "mapping": []}
    for first in range(0, len(growing.index), span):
        centres.append(first + span / 2)
        for name, values in zip(lines, (growing.total, growing.tracking, growing.mapping)):
            lines[name].append(growing.mean_ms(values, first, first + span))
    for name, values in lines.items():
        left.plot(centres, values, marker=".", label=name)
    later = [v for c, v in zip(centres, lines["whole"]) if c > START] or lines["whole"]
    left.set(xlabel="frame", ylabel=f"ms per frame, mean of {span}", ylim=(0, 1.5 * np.nanmax(later)))
    other = left.twinx()
    other.plot(growing.index, growing.gaussians, color="0.6", lw=1, ls="--", label="Gaussians")
    other.set(ylabel="Gaussians", ylim=(0, None))
    left.legend(
        *(a + b for a, b in zip(left.get_legend_handles_labels(), other.get_legend_handles_labels())), fontsize=8
    )
    for k, name in enumerate(("whole", "tracking", "mapping")):
        values = [c.mean_ms((c.total, c.tracking, c.mapping)[k], min(START, len(c.index) // 2)) for c in costs.values()]
        right.plot(list(costs), values, marker="o", label=name)
    right.set(xlabel="image width, pixels", ylabel="ms per frame", xscale="log", yscale="log")
    right.set_xticks(list(costs), [str(w) for w in costs])
    right.minorticks_off()
    right.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def report(options: argparse.Namespace, growing: Cost, costs: dict[int, Cost]) -> str:
    packages = ", ".join(f"{name} {importlib.metadata.version(name)}" for name in ("numpy", "numba"))
    given = [*sys.argv[1:]]
    if "--out" in given:  # where somebody keeps their files is nobody's business
        del given[given.index("--out") : given.index("--out") + 2]
    command = " ".join(["python benchmarks/cost.py", *given])
    width, setting = options.growth_width, f"{packages}; default options, bootstrap depth, seed {options.seed}"
    return f"""# What a frame costs panogs

Written by `{command}`, panobench commit {commit() or "unknown"}.

Measured on {cpu_model()}, {available_cores()} cores; Python {platform.python_version()}, {setting}.

Reading images is not counted; mapping is, in the frames where it happened.

![Cost against frames and width](cost.svg)

## Against the number of frames

{options.sequence}, {len(growing.index)} frames, {width}x{width // 2}. The first {START} frames hold the bootstrap.

{text_table(*growth(growing), markdown=True)}

## Against the width

{options.width_sequence}, {options.width_frames} frames. Frames per second include the bootstrap.

{text_table(*widths_table(costs), markdown=True)}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sequence", default="room1+frames500", help="sequence of the long run")
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--growth-width", type=int, default=256)
    parser.add_argument("--width-sequence", default="room1")
    parser.add_argument("--width-frames", type=int, default=100)
    parser.add_argument("--widths", type=int, nargs="+", default=[256, 512, 1024])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("reports/speed"))
    options = parser.parse_args()
    run("tiny", 128, 20, options.seed)
    growing = run(options.sequence, options.growth_width, options.frames, options.seed)
    costs = {width: run(options.width_sequence, width, options.width_frames, options.seed) for width in options.widths}
    options.out.mkdir(parents=True, exist_ok=True)
    draw(growing, costs, options.out / "cost.svg")
    write_whole(options.out / "cost.md", report(options, growing, costs))
    print(f"written: {options.out / 'cost.md'}, {options.out / 'cost.svg'}")


if __name__ == "__main__":
    main()
