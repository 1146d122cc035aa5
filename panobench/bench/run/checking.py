"""A second opinion on a run: another method, or the same one backwards, on the same frames.

Its time is not the method's. What it finds goes to the verdict, nowhere else.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.bench.run.blas import one_blas_thread
from panobench.bench.run.observer import Observer
from panobench.bench.run.request import RunRequest
from panobench.bench.run.setup import oracle_depth, set_up_run
from panobench.bench.run.tracking import Tracked, track_batch, track_online
from panobench.cameras.rig import Rig
from panobench.datasets.base import FrameSequence
from panobench.errors import PanobenchError
from panobench.methods.base import BatchMethod, MethodContext
from panobench.types import Estimate, RunStatus, Trajectory
from panobench.verdict.assess import BACKWARDS

#: Values of the run option ``check`` that are no methods, beside ``BACKWARDS``: decide by the data; nothing.
AUTO, NONE = "auto", "none"
#: The method that checks others, cheap beside most of them; it checks itself backwards.
CHECKER = "sparse"


def chosen_check(request: RunRequest, *, groundtruth: bool, batch: bool = False) -> str | None:
    """The check that a run gets: a method's name, ``BACKWARDS`` or None.

    Ground truth, where there is any, is a better check.
    """
    if request.check == NONE or (request.check == AUTO and (groundtruth or batch)):
        return None
    chosen = CHECKER if request.check == AUTO else request.check
    return BACKWARDS if chosen == request.method else chosen


#: Of frames read ahead to go through them backwards.
BLOCK_BYTES = 64 << 20


class Backwards(FrameSequence):
    """The frames of a sequence in reverse order.

    They are read forwards in blocks: a video that is read frame by frame backwards is decoded from its last key frame
    for each of them.
    """

    def __init__(self, inner: FrameSequence, count: int) -> None:
        self._inner, self._count = inner, count
        self._block: dict[int, NDArray[np.uint8]] = {}
        self._size = max(1, BLOCK_BYTES // (3 * inner.camera.width * inner.camera.height))
        self.name, self.dataset, self.camera = inner.name, inner.dataset, inner.camera
        self.times = self.reversed_times(np.asarray(inner.times)[:count])

    @staticmethod
    def reversed_times(times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Times (N,) that increase while the frames go backwards."""
        return np.ascontiguousarray((times[-1] - times)[::-1])

    def image(self, index: int) -> NDArray[np.uint8]:
        last = self._count - 1 - index
        if last not in self._block:
            self._block = {k: self._inner.image(k) for k in range(max(last - self._size + 1, 0), last + 1)}
        return self._block[last]

    @property
    def rig(self) -> Rig | None:
        return self._inner.rig

    def lens_images(self, index: int) -> tuple[NDArray[np.uint8], ...]:
        return self._inner.lens_images(self._count - 1 - index)

    def frame_name(self, index: int) -> str:
        return self._inner.frame_name(self._count - 1 - index)

    def forwards(self, trajectory: Trajectory) -> Trajectory:
        """A trajectory of the reversed frames at the true times."""
        index = self._count - 1 - np.searchsorted(self.times, trajectory.times - 1e-9)
        order = np.argsort(index)
        return Trajectory(np.asarray(self._inner.times)[index[order]], trajectory.T_wc[order])


def check_estimate(
    request: RunRequest,
    check: str,
    given: int,
    folder: Path,
    log: Callable[[str], None],
    observer: Observer,
    hidden: NDArray[np.bool_] | None = None,
) -> Estimate | None:
    """The check's estimate of the first ``given`` frames, as far as it came; None if it cannot run here.

    It gets the run's input, without the pixels ``hidden`` (H, W), its own defaults and the run's seed.
    """
    observer.stage("checking")
    method = request.method if check == BACKWARDS else check
    asked = replace(request, method=method, max_frames=given, holdout=0, continue_map=None, save_map=None)
    if check != BACKWARDS:
        asked = replace(asked, preset=None, settings={}, depth=None)
    try:
        setup = set_up_run(asked)
        if hidden is not None:
            setup.sequence.hide(hidden)
        sequence: Any = Backwards(setup.sequence, given) if check == BACKWARDS else setup.sequence
        with tempfile.TemporaryDirectory(prefix="check-", dir=folder, ignore_cleanup_errors=True) as work:
            context = MethodContext(
                seed=request.seed,
                work=Path(work),
                make_depth=setup.depth.make if setup.depth else None,
                rig=sequence.rig if setup.spec.rigs else None,
            )
            with one_blas_thread():
                if isinstance(setup.method, BatchMethod):
                    tracked: Tracked = track_batch(setup.method, sequence, frozenset(), context, Observer())
                else:
                    tracked = track_online(
                        setup.method, sequence, frozenset(), context, oracle_depth(setup), observer, _nobody
                    )
    except PanobenchError as error:
        log(f"check by {check}: {error}")
        return None
    if tracked.status is not RunStatus.OK or tracked.estimate is None:
        log(f"check by {check}: {tracked.message}")
        return None
    found = tracked.estimate
    log(f"check by {check}: {len(found.trajectory)} of {given} frames")
    return replace(found, trajectory=sequence.forwards(found.trajectory)) if check == BACKWARDS else found


def _nobody(*_: object) -> None:
    return None
