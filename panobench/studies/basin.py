"""The convergence-basin study: the loss around a true pose, the starts from which tracking converges, and how well
conditioned the pose is, for several fields of view (the paper's figure, with the numbers it does not give).
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from panobench.bench.records.study_record import StudyResult
from panobench.bench.run.request import RunRequest
from panobench.bench.run.setup import open_input
from panobench.bench.suite.fingerprint import code_fingerprint, data_fingerprint, digest, environment_fingerprint
from panobench.datasets.base import FrameSequence
from panobench.errors import DatasetError, UsageError
from panobench.studies import basin_figures
from panobench.studies.base import StudyRequest
from panobench.studies.fov import FULL_TURN, pinhole_width
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.cameras.base import Camera
    from panobench.studies.landscape import Scene

#: Half the side of the plane, in median depths (the paper's factor).
REACH = 0.5
AXES = ("x", "y", "z", "pitch", "yaw", "roll")


@dataclass(frozen=True)
class BasinOptions:
    """frame: index of the frame to be found; the map is fitted to ``map_views`` others around it, ``map_every`` apart.

    grid: samples per axis of the plane. rings, directions: starts for tracking. error_limit (median depths) and
    rotation_limit_deg: what counts as converged.
    """

    dataset: str = "rooms"
    root: str | None = None
    sequence: str | None = "room1"
    width: int = 256
    fov: tuple[float, ...] = (120.0, 200.0, 280.0, 360.0)
    pinhole: bool = True
    frame: int = 10
    map_views: int = 4
    map_every: int = 6
    map_iterations: int = 120
    grid: int = 21
    rings: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
    directions: int = 12
    solver: str = "gauss-newton"
    tracking_iterations: int = 100
    loss: str = "cosine"
    error_limit: float = 0.02
    rotation_limit_deg: float = 1.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, low in (("grid", 3), ("directions", 1), ("map_views", 1), ("map_every", 1), ("frame", 0)):
            if getattr(self, name) < low:
                raise UsageError(f"study option {name}: must be at least {low}")
        if not self.rings or min(self.rings) <= 0:
            raise UsageError("study option rings: distances above 0, in median depths")


#: A map that the few frames of the smallest room allow.
QUICK_MAP: dict[str, Any] = {"map_views": 3, "map_every": 4, "map_iterations": 60, "frame": 6}
QUICK: dict[str, Any] = {
    "sequence": "tiny", "width": 256, "grid": 13, "rings": (0.1, 0.2, 0.3, 0.4, 0.5), "directions": 8,
    **QUICK_MAP,
}  # fmt: skip


def run(study: StudyRequest) -> StudyResult:
    """Loss surfaces, shares of starts that converge, and the Hessian's eigenvalues for every field of view."""
    options = study.choose(BasinOptions(), QUICK)
    return _result(options, measure(options, study))


def measure(options: BasinOptions, study: StudyRequest) -> dict[str, dict[str, Any]]:
    """What was measured for every field of view, kept in ``study.out`` and taken from there the next time.

    Raises DatasetError for a sequence without true poses and depths.
    """
    cameras = [("120° x 60° pinhole", RunRequest(**_camera(options, "pinhole:front")))] if options.pinhole else []
    for degrees in options.fov:
        text = None if degrees >= FULL_TURN else f"{degrees:g}"
        cameras.append((f"{degrees:g}°", RunRequest(**_camera(options, "erp", text))))
    sequences = {name: open_input(request) for name, request in cameras}
    panorama = open_input(RunRequest(**_camera(options, "erp")))
    # a measurement does not depend on where the data are
    about = {k: v for k, v in asdict(options).items() if k not in ("fov", "pinhole", "root")}
    shared = [
        about,
        code_fingerprint(
            ["panobench.methods.panogs.tracking.tracker:Tracker", "panobench.methods.panogs.mapping.mapper:Mapper"]
        ),
        # the code of a run leaves studies out, but here this module measures
        Path(__file__).with_name("landscape.py").read_text(encoding="utf-8"),
        environment_fingerprint(),
        data_fingerprint(panorama.provenance()),
    ]
    folder = study.out / "basin"
    paths = {
        name: folder / f"{digest([*shared, sequence.camera.to_dict()])[:16]}.json"
        for name, sequence in sequences.items()
    }
    measured: dict[str, dict[str, Any]] = {name: found for name, p in paths.items() if (found := _read(p)) is not None}
    if len(measured) < len(paths):
        fitted = _fit(options, panorama, study)
        for name, sequence in sequences.items():
            if name not in measured:
                study.say(f"[{len(measured) + 1}/{len(paths)}] field of view {name}")
                measured[name] = _measure(options, sequence, fitted)
                write_whole(paths[name], json.dumps(measured[name]))
    return {name: measured[name] for name in paths}


def _camera(options: BasinOptions, camera: str, fov: str | None = None) -> dict[str, Any]:
    width = options.width if camera == "erp" else pinhole_width(options.width)
    place = {"dataset": options.dataset, "root": options.root, "sequence": options.sequence}
    return {"method": "panogs", "camera": camera, "fov": fov, "width": width, **place}


def _read(path: Path) -> dict[str, Any] | None:
    """What an earlier call measured; None for a file that cannot be read, which is measured again."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) and "loss" in found else None


def map_frames(options: BasinOptions, length: int) -> list[int]:
    """Frames the map is fitted to: before and after the frame looked for, never that frame itself."""
    if options.frame >= length:
        raise UsageError(f"study option frame: {options.frame}, but the sequence has {length} frames")
    near = [options.frame + side * k * options.map_every for k in range(1, options.map_views + 1) for side in (1, -1)]
    chosen = [i for i in near if 0 <= i < length][: options.map_views]
    if not chosen:
        raise UsageError(f"no frame of the sequence lies {options.map_every} from frame {options.frame}")
    return chosen


def _fit(options: BasinOptions, panorama: FrameSequence, study: StudyRequest) -> tuple[Any, float]:
    from panobench.studies.landscape import fit_map

    truth = panorama.groundtruth
    if truth is None or len(truth) != len(panorama):
        raise DatasetError(f"the study needs the true pose of every frame; '{panorama.name}' does not have them")
    frames = map_frames(options, len(panorama))
    depths = [panorama.depth(i) for i in frames]
    known = [(i, d) for i, d in zip(frames, depths) if d is not None]
    if not known:
        raise DatasetError(f"the study needs true depth of frames {frames}; '{panorama.name}' has none there")
    study.say(f"fitting the map to frames {', '.join(str(i) for i, _ in known)}")
    poses = [truth.T_wc[i] for i, _ in known]
    images = [panorama.image(i) for i, _ in known]
    return fit_map(
        panorama.camera, images, [d for _, d in known], poses, _config(options), options.map_iterations, options.seed
    )


def _config(options: BasinOptions, **changes: Any) -> Any:
    from panobench.bench.run.config import override
    from panobench.methods.panogs.config import PanogsConfig

    own = {
        "tracking.solver": options.solver,
        "tracking.iterations": options.tracking_iterations,
        "rendering.weights": options.loss,
    }
    return override(PanogsConfig(), {**own, **changes}, "study option")


def _measure(options: BasinOptions, sequence: FrameSequence, fitted: tuple[Any, float]) -> dict[str, Any]:
    from panobench.studies.landscape import Scene, loss_surface, pose_hessian, track_from

    gaussians, depth = fitted
    truth = sequence.groundtruth
    assert truth is not None
    camera: Camera = sequence.camera
    scene: Scene = Scene(camera, gaussians, sequence.image(options.frame), truth.T_wc[options.frame], depth)
    config = _config(options)
    offsets = np.linspace(-REACH, REACH, options.grid)
    starts = track_from(
        scene, np.array(options.rings), options.directions, config, options.error_limit, options.rotation_limit_deg
    )
    hessian = pose_hessian(scene, _config(options, **{"tracking.solver": "gauss-newton"}))
    values, vectors = np.linalg.eigh(hessian)
    return {
        "median_depth_m": depth,
        "offsets": offsets.tolist(),
        "loss": loss_surface(scene, offsets, config).tolist(),
        "starts": [asdict(s) for s in starts],
        "eigenvalues": values[::-1].tolist(),
        "weakest": AXES[int(np.argmax(np.abs(vectors[:, 0])))],
    }


def _result(options: BasinOptions, measured: dict[str, dict[str, Any]]) -> StudyResult:
    shares, conditions = [], []
    for name, m in measured.items():
        starts = m["starts"]
        row: dict[str, Any] = {"FoV": name, "All starts [%] ↑": share(starts)}
        for ring in options.rings:
            row[f"{ring:g} z [%] ↑"] = share([s for s in starts if abs(s["distance"] - ring) < 1e-9])
        shares.append(row)
        values = m["eigenvalues"]
        row = {"FoV": name, "Condition number ↓": values[0] / values[-1] if values[-1] > 0 else None}
        row |= {"Weakest along": m["weakest"]} | {f"λ{k + 1}": f"{v:.3g}" for k, v in enumerate(values)}
        conditions.append(row)
    surfaces = {"loss-" + _word(name): basin_figures.contour(name, measured) for name in measured}
    first, last = next(iter(measured)), list(measured)[-1]
    for name in dict.fromkeys((first, last)):
        surfaces[f"surface-{_word(name)}"] = basin_figures.surface(name, measured)
    figures = {
        **surfaces,
        "converged": basin_figures.shares(options.rings, shares),
        "eigenvalues": basin_figures.eigenvalues(measured),
    }
    depth = next(iter(measured.values()))["median_depth_m"]
    captions = {
        "basin": f"Starts from which tracking converges. z is the median depth, {depth:.3g} m; starts lie on rings in "
        f"the X-Z plane, {options.directions} directions each; converged: within {options.error_limit:g} z and "
        f"{options.rotation_limit_deg:g}° of the true pose. Solver: {options.solver}.",
        "conditioning": "Conditioning of the pose. Eigenvalues of tracking's Gauss-Newton Hessian at the solution, "
        "translation in median depths, rotation in radians, per valid pixel. Weakest along: largest component of the "
        "last eigenvector.",
        "converged": "Starts that converge. Share over the distance of the start from the true pose.",
        "eigenvalues": "Eigenvalues of the pose Hessian. A flat curve is a well-conditioned pose.",
    }
    for name in measured:
        captions["loss-" + _word(name)] = (
            f"Loss, {name}. Photometric loss over the X-Z plane around the true pose. Circles: starts from which "
            "tracking finds it; crosses: those from which it does not."
        )
        captions["surface-" + _word(name)] = f"Loss surface, {name}. The same loss as height."
    place = f"{options.dataset}/{options.sequence}" if options.sequence else options.dataset
    notes = [
        f"Frame {options.frame} of {place}, {options.width} px. The map is fitted to other frames, with their true "
        "poses and depths, and is the same for all fields of view: only what the frame sees of it differs.",
        f"The plane reaches {REACH:g} median depths to each side. Losses are drawn over the same range of values.",
    ]
    tables = {"basin": shares, "conditioning": conditions}
    return StudyResult("basin", tables, figures, notes, "Convergence basin", captions)


def share(starts: list[dict[str, Any]]) -> float | None:
    """Percentage of the starts that converged; None without starts."""
    return 100.0 * sum(s["converged"] for s in starts) / len(starts) if starts else None


def _word(name: str) -> str:
    return "".join(c for c in name.replace("°", "") if c.isalnum() or c == " ").strip().replace(" ", "-")
