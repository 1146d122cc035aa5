"""Do one run: set up, track, evaluate, write the folder. Only the method is timed, not reading, checking or scoring."""

from __future__ import annotations

import datetime
import random
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from panobench import kernel_cache
from panobench.bench.records.provenance import provenance
from panobench.bench.records.record import CellRecord, MaskRecord, RunRecord, VerdictRecord
from panobench.bench.records.results import run_record, save_map, timing_record, write_run
from panobench.bench.records.runfolder import LOG, RENDERS, PendingRun, check_free
from panobench.bench.run.blas import one_blas_thread
from panobench.bench.run.checking import check_estimate, chosen_check
from panobench.bench.run.evaluate import Scores, evaluate
from panobench.bench.run.interrupts import KeepWriting
from panobench.bench.run.masking import apply_mask
from panobench.bench.run.memory import Meter
from panobench.bench.run.observer import Observer
from panobench.bench.run.request import RunRequest
from panobench.bench.run.setup import RunSetup, oracle_depth, set_up_run, wants_imu
from panobench.bench.run.tracking import Pose, Tracked, track_batch, track_online
from panobench.bench.run.truth import align_clocks
from panobench.bench.run.views import held_out
from panobench.kernels.watch import CompileWatch
from panobench.masks.base import NOT_RIGID
from panobench.methods.base import BatchMethod, MethodContext
from panobench.metrics.base import MetricInput
from panobench.plugins import PluginWarning, registry
from panobench.types import Estimate, Frame, RunStatus
from panobench.verdict.assess import assess
from panobench.writing import TEXT


class RunLog:
    """log.txt: one line per event with the seconds since the run began."""

    def __init__(self, file: TextIO, heard: Callable[[str], None] | None = None) -> None:
        """heard: is called with each line as it is written."""
        self._file, self._heard, self._begin = file, heard, time.perf_counter()

    def __call__(self, line: str) -> None:
        for part in str(line).splitlines() or [""]:
            text = f"[{time.perf_counter() - self._begin:9.3f}] {part}"
            self._file.write(text + "\n")
            if self._heard is not None:
                self._heard(text)
        self._file.flush()


def default_folder(request: RunRequest, base: Path = Path("runs")) -> Path:
    """A free folder runs/METHOD-CAMERA-DATASET-SEQUENCE-TIME, with a number at its end where that is taken."""
    words = [request.method, request.camera, request.dataset, request.sequence or ""]
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S")
    name = "-".join("".join(c if c.isalnum() or c in "._" else "_" for c in w).strip(".") for w in words if w)
    folder = base / f"{name}-{stamp}"
    number = 2
    while folder.exists():
        folder = base / f"{name}-{stamp}-{number}"
        number += 1
    return folder


def execute(
    request: RunRequest,
    out: Path | None = None,
    *,
    force: bool = False,
    observer: Observer | None = None,
    cell: CellRecord | None = None,
) -> Path:
    """Run and return the run folder, whatever the method did. cell: the suite's cell that it is the result of.

    Raises PanobenchError for what the user can mend (names, options, data); nothing is written then.
    """
    observer = observer or Observer()
    request, found = request.resolved()
    if found:
        observer.found(request.dataset, found)
    target = out or default_folder(request)
    check_free(target, force)
    observer.stage("setting up")
    setup = set_up_run(request, observer.compiling)
    with KeepWriting() as keep, PendingRun(target, force) as pending:
        with (pending.path / LOG).open("w", **TEXT) as file:
            record = _run(request, setup, pending.path, RunLog(file, observer.log), observer, keep, cell)
        folder = pending.publish()
    _call_hooks("run_finished", None, folder=folder, run=record.to_dict())
    return folder


def _run(
    request: RunRequest,
    setup: RunSetup,
    folder: Path,
    log: RunLog,
    observer: Observer,
    keep: KeepWriting,
    cell: CellRecord | None,
) -> RunRecord:
    origin = provenance()
    spec = request.to_dict()
    _call_hooks("run_started", log, spec=spec, sequence=setup.sequence)
    log(f"{request.method} on {request.dataset}/{setup.sequence.name}, {len(setup.sequence)} frames")
    said = setup.sequence.remarks()
    for remark in said:
        log(f"note: {remark}")
    holdout = held_out(len(setup.sequence), request.holdout)
    observer.stage("looking for what moves with the camera" if setup.mask.spec else "reading the mask")
    mask = apply_mask(setup.mask, setup.sequence, request.seed, log, setup.spec.frame_masks)
    _seed(request.seed)
    if kernel_cache.note():
        log(str(kernel_cache.note()))
    kernels = setup.kernels
    log(f"{kernels.loaded} kernels loaded in {kernels.seconds:.1f} s, {kernels.compiled} of them compiled")
    keep.begin()
    with Meter() as meter, CompileWatch() as watch:
        tracked = _track(request, setup, folder, frozenset(holdout), log, observer)
        cpu_s = meter.cpu_s
    if tracked.failure:
        log(tracked.failure)
    offset = None
    if request.align_time:
        setup, offset = align_clocks(setup, tracked, log)
    with keep.interruptible():
        scores = _score(setup, tracked, holdout, folder / RENDERS, log, observer)
    log(f"{scores.status.value}: {scores.message}" if scores.message else scores.status.value)
    timing = timing_record(tracked, scores.evaluation_s)
    timing.peak_rss_bytes, timing.cpu_s = meter.peak_rss_bytes, cpu_s
    if setup.device is not None:
        timing.peak_gpu_bytes = setup.device.peak_memory_bytes()
    timing.prepare_s, timing.late_compile_s = kernels.seconds + tracked.warm_up_s, watch.seconds
    record = run_record(request, setup, tracked, holdout, scores, timing, origin, offset)
    record.cell = cell
    record.mask = mask
    record.gpu = setup.device.name if setup.device is not None else None
    if mask is not None and mask.source == "file" and mask.message:
        record.remarks.append(mask.message)
    if watch.note():
        record.remarks.append(str(watch.note()))
    record.verdict = _verdict(request, setup, tracked, scores, mask, folder, log, observer)
    log(f"verdict: {record.verdict.word} ({record.verdict.confidence:.2f})")
    for remark in record.remarks:
        if remark not in said:
            log(f"note: {remark}")
    observer.stage("writing")
    write_run(folder, record, setup, tracked, holdout)
    if request.save_map:
        log(save_map(Path(request.save_map).expanduser(), setup.method, tracked))
    return record


def _track(
    request: RunRequest,
    setup: RunSetup,
    folder: Path,
    holdout: frozenset[int],
    log: RunLog,
    observer: Observer,
) -> Tracked:
    """Give the method its frames; its work folder is gone afterwards."""
    import tempfile

    sequence, needs = setup.sequence, setup.spec.needs
    truth = sequence.groundtruth

    def warn(line: str) -> None:
        log(f"warning: {line}")
        observer.warn(line)

    with tempfile.TemporaryDirectory(prefix="work-", dir=folder, ignore_cleanup_errors=True) as work:
        context = MethodContext(
            seed=request.seed,
            work=Path(work),
            make_depth=setup.depth.make if setup.depth else None,
            imu=sequence.imu if wants_imu(request, setup.spec) else None,
            rig=sequence.rig if setup.spec.rigs else None,
            poses=_poses(sequence, truth) if "poses" in needs and truth is not None else None,
            saved_map=setup.saved_map,
            log=log,
            warn=warn,
            device=setup.device,
        )
        if setup.device_note:
            warn(setup.device_note)
        if setup.device is not None:
            log(f"maps are computed on the GPU: {setup.device.name}")
        observer.started(len(sequence), truth if sequence.groundtruth_scaled else None)
        observer.stage("tracking")
        method = setup.method

        def frame_done(frame: Frame, T_wc: Pose | None, latency: float) -> None:
            _call_hooks("frame_done", log, frame=frame, T_wc=T_wc, latency_s=latency, method=method)

        with one_blas_thread():
            if isinstance(method, BatchMethod):
                return track_batch(method, sequence, holdout, context, observer)
            return track_online(method, sequence, holdout, context, oracle_depth(setup), observer, frame_done)


def _poses(sequence: Any, truth: Any) -> dict[int, Any]:
    return {int(i): T for i, T in zip(np.searchsorted(sequence.times, truth.times), truth.T_wc)}


def _score(
    setup: RunSetup, tracked: Tracked, holdout: list[int], renders: Path, log: RunLog, observer: Observer
) -> Scores:
    assert tracked.estimate is not None
    observer.stage("evaluating")
    whole = tracked.status is RunStatus.OK
    data = MetricInput(
        sequence=setup.sequence,
        estimate=tracked.estimate,
        frames=list(range(tracked.given)),
        holdout=[i for i in holdout if i < tracked.given],
        latency=tracked.latency,
        render=setup.method.render if whole else None,
        renders=renders if whole else None,
    )
    return evaluate(data, tracked.status, tracked.message, log)


def _verdict(
    request: RunRequest,
    setup: RunSetup,
    tracked: Tracked,
    scores: Scores,
    mask: MaskRecord | None,
    folder: Path,
    log: RunLog,
    observer: Observer,
) -> VerdictRecord:
    """What can be said about the run without ground truth, with a second opinion where one is asked for."""
    estimate = tracked.estimate
    assert estimate is not None
    truth = setup.sequence.groundtruth is not None
    check = chosen_check(request, groundtruth=truth, batch=isinstance(setup.method, BatchMethod))
    others: dict[str, Estimate] = {}
    if check is not None and tracked.status is RunStatus.OK and len(estimate.trajectory):
        hidden = ~setup.sequence.camera.valid_mask()
        opinion = check_estimate(request, check, tracked.given, folder, log, observer, hidden)
        if opinion is not None:
            others[check] = opinion
    ended_badly = tracked.status not in (RunStatus.OK, RunStatus.INTERRUPTED)
    rejected = f"{tracked.status.value}: {tracked.message}" if ended_badly else ""
    not_rigid = ((mask and mask.details) or {}).get(NOT_RIGID, 0.0)
    enlargement = setup.sequence.enlargement
    found = assess(estimate, tracked.given, scores.metrics, others, rejected, not_rigid, enlargement)
    return VerdictRecord.of(found, check)


def _seed(seed: int) -> None:
    """Seed the global generators, for methods that use them in spite of the contract."""
    random.seed(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.manual_seed(seed)


def _call_hooks(name: str, log: RunLog | None, **arguments: Any) -> None:
    """Call a lifecycle hook of all plugins. One that fails is reported and does not end the run."""
    try:
        getattr(registry().manager.hook, name)(**arguments)
    except Exception as error:
        text = f"a plugin's {name} hook failed: {type(error).__name__}: {error}"
        if log is not None:
            log(text)
        warnings.warn(text, PluginWarning, stacklevel=2)
