"""A finished run as a recording for the Rerun viewer."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from panobench.errors import UnavailableError
from panobench.writing import writing

if TYPE_CHECKING:
    from panobench.api import Run


def write_recording(run: Run, target: Path) -> None:
    """Path, truth, map, and of each frame pose, pictures, error and latency, with a layout to open them in.

    The estimate keeps its world; the truth is moved onto it. Raises UnavailableError without Rerun, and OutputError.
    """
    if importlib.util.find_spec("rerun") is None:
        raise UnavailableError("a recording needs the Python package 'rerun-sdk': pip install 'panobench[viewer]'")
    import rerun as rr

    from panobench.viewer.layout import blueprint
    from panobench.viewer.scene import log_map, log_poses

    spec = run.record.spec
    part = target.with_name(f".{target.name}.part")
    with writing(target):
        target.parent.mkdir(parents=True, exist_ok=True)
        part.touch()
    stream = rr.RecordingStream("panobench")
    stream.save(str(part), default_blueprint=blueprint())
    stream.send_recording_name(f"{spec.method} on {spec.dataset}/{spec.sequence}")
    stream.log("world", rr.ViewCoordinates.RDF, static=True)
    if run.map is not None:
        log_map(stream, run.map)
    log_poses(stream, run.trajectory.T_wc, "trajectory", (60, 120, 255))
    keyframes = _keyframes(run)
    if len(keyframes):
        points = rr.Points3D(keyframes, colors=(255, 160, 0), radii=rr.Radius.ui_points(5.0))
        stream.log("world/keyframes", points, static=True)
    if run.groundtruth is not None:
        truth = run.groundtruth
        if run._stored.errors is not None:
            truth = type(truth)(truth.times, run._stored.errors.transform.inverse().apply_poses(truth.T_wc))
        log_poses(stream, truth.T_wc, "truth", (40, 170, 90))
    _log_frames(stream, run)
    stream.log("log", rr.TextLog(f"{run.status}: {run.folder.name}"))
    stream.disconnect()
    with writing(target):
        part.replace(target)


def _keyframes(run: Run) -> np.ndarray:
    """Positions (K, 3) of the keyframes that have a pose."""
    times = run.frames.get("time", np.zeros(0))
    chosen = [times[k] for k in run.record.keyframes or () if k < len(times)]
    own = run.trajectory.times
    index = [int(np.abs(own - t).argmin()) for t in chosen if len(own) and np.abs(own - t).min() < 1e-4]
    return run.trajectory.positions[index]


def _log_frames(stream, run: Run) -> None:  # type: ignore[no-untyped-def]
    """What belongs to one frame, on the timelines "frame" and "time"."""
    import rerun as rr

    from panobench.viewer.scene import log_camera

    frames, errors = run.frames, run._stored.errors
    times = frames.get("time", run.trajectory.times)
    pictures = {pair.frame: pair for pair in run._stored.pairs if not pair.novel}
    camera = run.camera if run.record.spec.camera_model is not None else None
    posed = {round(float(t), 6): k for k, t in enumerate(run.trajectory.times)}
    judged = {round(float(t), 6): e for t, e in zip(errors.times, errors.translation)} if errors is not None else {}
    latency = frames.get("latency_s")
    for k, time in enumerate(times):
        stream.set_time("frame", sequence=k)
        stream.set_time("time", duration=float(time - times[0]))
        key = round(float(time), 6)
        if key in posed:
            log_camera(stream, run.trajectory.T_wc[posed[key]], camera)
        if key in judged:
            stream.log("plots/error_mm", rr.Scalars(1e3 * float(judged[key])))
        if latency is not None and np.isfinite(latency[k]):
            stream.log("plots/latency_ms", rr.Scalars(1e3 * float(latency[k])))
        pair = pictures.get(k)
        if pair is not None:
            for name, path in (("render", pair.render), ("frame", pair.truth)):
                if path is not None:
                    stream.log(f"images/{name}", rr.EncodedImage(path=path))
