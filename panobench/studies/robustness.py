"""The robustness study: how tracking and mapping fare under one disturbance of the images at a time."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

from panobench.bench.records.study_record import StudyResult
from panobench.bench.suite.cells import Cell
from panobench.bench.suite.store import Stored
from panobench.errors import DatasetError, UsageError
from panobench.metrics.base import FAILED_ATE_M, MIN_TRACKED
from panobench.studies import basin
from panobench.studies.base import StudyRequest
from panobench.studies.cells import FAILED, QUICK, RunOptions, middle, reasons, run_cells
from panobench.types import RunStatus

#: Row -> disturbance of the stream (``datasets.synthetic.disturb``), "" for none, or "every=N": frames skipped.
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
    "noise": "noise, sigma {}",
    "blur": "blur, {} px",
    "rolling": "exposure ±{:.0%}",
    "occluder": "occluder, {:.0%} of the view",
    "black": "{} black frames",
    "every": "one frame in {}",
    "yaw": "yaw, {}°/frame",
}


#: The whole path of the smallest room, at the size of the other quick runs.
QUICK_STREAMS: dict[str, Any] = {
    **QUICK,
    "max_frames": None,
    "disturbances": tuple("black=8" if text == "black=20" else text for text in DISTURBANCES),
}


@dataclass(frozen=True)
class RobustnessOptions(RunOptions):
    """methods: each on every disturbance. sequences: SEQUENCE of ``dataset``, or DATASET/SEQUENCE.

    disturbances: NAME=NUMBER of ``datasets.synthetic.disturb.Disturbances``, several joined by ":"; every=N; none.
    starts: also the share of perturbed start poses from which panogs finds a frame, in the first sequence.
    """

    methods: tuple[str, ...] = ("panogs", "sparse")
    sequences: tuple[str, ...] = ("room1",)
    disturbances: tuple[str, ...] = DISTURBANCES
    starts: bool = True


def run(study: StudyRequest) -> StudyResult:
    """Share of frames tracked, ATE, and PSNR of undisturbed novel views, per disturbance and method."""
    options = study.choose(RobustnessOptions(), QUICK_STREAMS)
    names = {text: describe(text) for text in options.disturbances}  # this refuses mistakes before anything runs
    rows = {
        (text, method): [[_cell(options, method, s, text, seed) for seed in options.seeds] for s in options.sequences]
        for text in options.disturbances
        for method in options.methods
    }
    flat = [cell for groups in rows.values() for group in groups for cell in group]
    results = run_cells(study, "robustness", flat)
    streams: list[dict[str, Any]] = []
    for (text, method), groups in rows.items():
        row: dict[str, Any] = {"Disturbance": names[text], "Method": method}
        for sequence, group in zip(options.sequences, groups):
            outcomes = [outcome(results.get(cell.identity), black_frames(text)) for cell in group]
            row[f"{sequence} tracked [%] ↑"] = _worst([o.tracked for o in outcomes])
            row[f"{sequence} ATE [mm] ↓"] = _median([o.ate_mm for o in outcomes])
            row[f"{sequence} PSNR [dB] ↑"] = _median([o.psnr_db for o in outcomes], higher_is_better=True)
        streams.append({**row, "source": "measured"})
    failed = [
        cell
        for (text, _), groups in rows.items()
        for group in groups
        for cell in group
        if outcome(results.get(cell.identity), black_frames(text)).ate_mm == FAILED
    ]
    captions = {
        "robustness": "Tracking under disturbances. Share of the frames that show something which have a pose (the "
        "least of the seeds), ATE over them, and PSNR of the map at novel views that are not disturbed; / where less "
        f"than {MIN_TRACKED:.0%} have one, or after a crash.",
        "errors": "Error under disturbances. ATE on a logarithmic axis; what is not there was lost.",
    }
    notes = [
        f"Images {options.width} pixels wide. Disturbances have a fixed seed: every method gets the same images. Noise "
        "is Gaussian, blur a streak along the rows, exposure swings with a period of 24 frames, the occluder is a "
        "chequered disc that moves by 3° a frame, black frames lie in the middle, and the yaw is on top of the "
        "camera's own motion.",
        "A black frame can have no pose and does not count in this table. The protocol counts it, so such runs are "
        "lost in the tables of the runs.",
        *reasons(results, failed),
    ]
    tables, figures = {"robustness": streams}, {"errors": _figure(streams, options)}
    if options.starts:
        tables["starts"], captions["starts"], missing = _starts(study, options)
        notes += missing
    return StudyResult("robustness", tables, figures, notes, "Robustness of tracking", captions)


def _cell(options: RobustnessOptions, method: str, sequence: str, text: str, seed: int) -> Cell:
    """One run. Undisturbed images come through the disturbing dataset too, so that only the disturbance differs."""
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
    """The disturbance in words: "noise=0.03" is "noise, sigma 0.03". Raises UsageError if it is none."""
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


@dataclass(frozen=True)
class Outcome:
    """tracked: per cent of the frames that show something, FAILED after a crash; ate_mm, psnr_db: FAILED if lost."""

    tracked: float | str
    ate_mm: float | str | None = FAILED
    psnr_db: float | str | None = FAILED


def black_frames(text: str) -> int:
    """Number of frames that a disturbance blackens: 20 for "noise=0.03:black=20"."""
    parts = dict(part.partition("=")[::2] for part in text.split(":"))
    return int(float(parts.get("black", 0)))


def outcome(stored: Stored | None, black: int) -> Outcome:
    """Judge a run of which ``black`` frames could have no pose: it is not lost if it tracked the others."""
    if stored is None or stored.status not in (RunStatus.OK.value, RunStatus.LOST.value):
        return Outcome(FAILED)
    record, given = stored.record, stored.record.frames.given
    tracked = record.number("tracked")
    if tracked is None:
        return Outcome(FAILED)
    share = min(tracked * given / (given - black), 1.0) if given > black else tracked
    ate, psnr = record.number("ate_rmse_m"), record.number("novel_psnr_db")
    if share < MIN_TRACKED or ate is None or ate > FAILED_ATE_M:
        return Outcome(100.0 * share)
    return Outcome(100.0 * share, 1e3 * ate, psnr)


def _worst(values: list[float | str]) -> float | str:
    numbers = [v for v in values if not isinstance(v, str)]
    return min(numbers) if len(numbers) == len(values) and numbers else FAILED


def _median(values: list[float | str | None], *, higher_is_better: bool = False) -> float | str | None:
    """The median over seeds, where a lost run is worse than any number; None if it was not measured."""
    if any(v is None for v in values):
        return None
    return middle([None if v == FAILED else float(v) for v in values], higher_is_better=higher_is_better)  # type: ignore[arg-type]


def _figure(rows: list[dict[str, Any]], options: RobustnessOptions) -> dict[str, Any]:
    """A marker per disturbance; a colour per method, a symbol per sequence."""
    data = []
    for k, method in enumerate(options.methods):
        for sequence, symbol in zip(options.sequences, itertools.cycle(("circle", "diamond", "square", "cross"))):
            known = [
                (row["Disturbance"], value)
                for row in rows
                if row["Method"] == method and isinstance(value := row[f"{sequence} ATE [mm] ↓"], float)
            ]
            data.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": f"{method}, {sequence}" if len(options.sequences) > 1 else method,
                    "meta": {"run": -2, "colour": k},
                    "x": [value for _, value in known],
                    "y": [name for name, _ in known],
                    "marker": {"size": 10, "symbol": symbol},
                }
            )
    names = list(dict.fromkeys(row["Disturbance"] for row in rows))
    layout = {
        "xaxis": {"title": {"text": "ATE RMSE [mm]"}, "type": "log"},
        # each disturbance has a row, even where every method was lost
        "yaxis": {"autorange": "reversed", "categoryorder": "array", "categoryarray": names, "automargin": True},
        "showlegend": True,
    }
    return {"data": data, "layout": layout}


def _starts(study: StudyRequest, options: RobustnessOptions) -> tuple[list[dict[str, Any]], str, list[str]]:
    """Rows, caption and notes of the perturbed start poses: the ``basin`` study's measurement, full panorama only."""
    dataset, _, sequence = (p := options.sequences[0]).rpartition("/")
    chosen = basin.BasinOptions(
        dataset=dataset or options.dataset, root=options.root, sequence=sequence, width=options.width,
        fov=(basin.FULL_TURN,), pinhole=False, **(basin.QUICK_MAP if study.quick else {}),
    )  # fmt: skip
    try:
        measured = next(iter(basin.measure(chosen, study).values()))
    except DatasetError as e:
        return [], "", [f"No perturbed starts: {e}"]
    rows = []
    for ring in chosen.rings:
        starts = [s for s in measured["starts"] if abs(s["distance"] - ring) < 1e-9]
        found = [s for s in starts if s["converged"]]
        error = max((1e3 * s["error"] * measured["median_depth_m"] for s in found), default=None)
        distance = 1e3 * ring * measured["median_depth_m"]
        row = {"Start off by": f"{ring:g} median depths ({distance:.0f} mm)", "Found [%] ↑": basin.share(starts)}
        rows.append({**row, "Worst found [mm] ↓": error, "source": "measured"})
    caption = (
        f"Perturbed start poses. Of {chosen.directions} directions in the X-Z plane around the true pose of a frame of "
        f"{p}, the share from which panogs's tracking finds it (within {chosen.error_limit:g} median depths and "
        f"{chosen.rotation_limit_deg:g}°), and the largest error among those. More of it: the study basin."
    )
    return rows, caption, []
