"""The robustness study: one disturbance of the stream at a time, and what is left of tracking and of the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from panobench.bench.cells import Cell
from panobench.bench.store import Stored
from panobench.errors import UsageError
from panobench.studies.base import StudyRequest, StudyResult
from panobench.studies.cells import FAILED, QUICK, RunOptions, median, reasons, run_cells

#: Row -> disturbance of the stream (``panobench.datasets.disturb``), "" for none, or "every=N": frames skipped.
DISTURBANCES = (
    "none",
    "noise=0.03",
    "blur=2",
    "rolling=0.3",
    "occluder=0.25",
    "black=20",
    "every=2",
    "every=5",
    "every=10",
    "yaw=6",
)
_WORDS = {
    "noise": "Gaussian noise, sigma {}",
    "blur": "motion blur, {} px",
    "rolling": "exposure swinging by ±{:.0%}",
    "occluder": "moving occluder over {:.0%} of the sphere",
    "black": "{} black frames in the middle",
    "every": "one frame in {}",
    "yaw": "turning by {}°/frame on top",
}


@dataclass(frozen=True)
class RobustnessOptions(RunOptions):
    """methods: each on every disturbance. sequences: SEQUENCE of ``dataset``, or DATASET/SEQUENCE.

    disturbances: NAME=NUMBER of ``panobench.datasets.disturb.Disturbances``, several joined by ":"; every=N; none.
    """

    methods: tuple[str, ...] = ("panogs", "sparse")
    sequences: tuple[str, ...] = ("room1",)
    width: int = 256
    disturbances: tuple[str, ...] = DISTURBANCES


def run(study: StudyRequest) -> StudyResult:
    """Share of frames tracked, ATE, and PSNR of undisturbed novel views, per method and disturbance."""
    quick = {**QUICK, "max_frames": None, "disturbances": ("none", "noise=0.03", "black=3", "every=5")}
    options = study.choose(RobustnessOptions(), quick)
    names = {text: describe(text) for text in options.disturbances}  # mistakes are said before anything runs
    rows = {
        (method, text): [[_cell(options, method, s, text, seed) for seed in options.seeds] for s in options.sequences]
        for method in options.methods
        for text in options.disturbances
    }
    flat = [cell for groups in rows.values() for group in groups for cell in group]
    results = run_cells(study, "robustness", flat)
    tables: dict[str, list[dict[str, Any]]] = {"robustness": []}
    for (method, text), groups in rows.items():
        row: dict[str, Any] = {"Method": method, "Disturbance": names[text]}
        for sequence, group in zip(options.sequences, groups):
            row[f"{sequence} tracked [%] ↑"] = coverage(results, group)
            row[f"{sequence} ATE [mm] ↓"] = median(results, group, "ate_rmse_m", 1e3)
            row[f"{sequence} PSNR [dB] ↑"] = median(results, group, "novel_psnr_db", higher_is_better=True)
        tables["robustness"].append({**row, "source": "measured"})
    captions = {
        "robustness": "Tracking under disturbances. Share of the frames with a pose (the least of the seeds), ATE, and "
        "PSNR of the map at novel views that are not disturbed; / is a run the protocol counts as lost, or a crash."
    }
    notes = [
        f"Images {options.width} pixels wide. Disturbances have a fixed seed: every method gets the same images.",
        *reasons(results, flat),
    ]
    return StudyResult("robustness", tables, {}, notes, "Robustness of tracking", captions)


def _cell(options: RobustnessOptions, method: str, sequence: str, text: str, seed: int) -> Cell:
    """One run; plain streams too come through the dataset that disturbs, so that only the disturbance differs."""
    place = sequence if "/" in sequence else f"{options.dataset}/{sequence}"
    changes: dict[str, Any] = {"method": method, "dataset": "disturbed"}
    if text.startswith("every="):
        changes["every"] = _whole(text)
    elif text != "none":
        place += f":{text}"
    if method != options.method:
        changes |= {"preset": None, "depth": None}
    return options.cell(place, seed, **changes)


def describe(text: str) -> str:
    """For people: "noise=0.03" -> "Gaussian noise, sigma 0.03". Raises UsageError for what is no disturbance."""
    if text == "none":
        return text
    words = []
    for part in text.split(":"):
        name, _, number = part.partition("=")
        try:
            value = float(number)
            words.append(_WORDS[name].format(int(value) if value.is_integer() else value))
        except (KeyError, ValueError, OverflowError):
            raise UsageError(f"study option disturbances: '{text}' is not NAME=NUMBER, e.g. noise=0.03") from None
    return ", ".join(words)


def _whole(text: str) -> int:
    number = text.partition("=")[2]
    if not number.isdigit():
        raise UsageError(f"study option disturbances: '{text}': give a whole number")
    return int(number)


def coverage(results: dict[str, Stored], cells: list[Cell]) -> float | str | None:
    """Least share of frames tracked over the cells, per cent; lost runs have one too, others that failed have not."""
    shares = []
    for cell in cells:
        stored = results.get(cell.identity)
        shares.append(stored.document.get("metrics", {}).get("tracked") if stored else None)
    known = [float(s) for s in shares if isinstance(s, (int, float))]
    return 100.0 * min(known) if known and len(known) == len(shares) else FAILED
