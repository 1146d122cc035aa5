"""What a method does with an IMU: it reports its frames, and gets a metric trajectory at the end, or a reason.

Without an IMU every call does nothing, so that a method's answers on images alone stay what they are.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import UnavailableError
from panobench.inertial.fusion import Fusion, Unit, fuse
from panobench.inertial.prediction import Predictor
from panobench.inertial.rotation_prior import RotationPrior
from panobench.inertial.samples import ContradictionError, InertialError, TooLittleMotionError, usable_samples
from panobench.inertial.visual import VisualPoses
from panobench.types import Imu

Array = NDArray[np.float64]

#: A loop that corrects the camera's rotation by more than this contradicts the gyroscope, which drifts by less.
LOOP_TURN_DEG = 3.0
#: One that corrects it by more than this is none without a gyroscope either: what is tracked from frame to frame drifts
#: by less, while a room that looks alike from its other end asks for half a turn.
DRIFT_TURN_DEG = 45.0


class InertialStage:
    """One per run. warn: one line for the user; log: one line for the run's log. pose_of: see ``Predictor``.

    seconds: spent here so far.
    """

    def __init__(
        self,
        imu: Imu | None,
        log: Callable[[str], None],
        warn: Callable[[str], None],
        pose_of: Callable[[int], Array | None],
    ) -> None:
        self.imu, self.log, self.warn = imu, log, warn
        self.times: dict[int, float] = {}
        self.numbers: dict[str, Any] = {}
        self.seconds = 0.0
        self.predictor: Predictor | None = None
        if imu is not None:
            with contextlib.suppress(InertialError):  # said at the end
                self.predictor = Predictor(usable_samples(imu), pose_of)

    @property
    def enabled(self) -> bool:
        """Whether the run has an IMU."""
        return self.imu is not None

    @property
    def knows_scale(self) -> bool:
        """Whether the IMU has told the map's scale by now."""
        return self.predictor is not None and self.predictor.initial is not None

    def refuses_turn(self, degrees: float) -> bool:
        """Whether a loop that turns the camera by so much cannot be one: the gyroscope knows which way it looks, and
        without one the frames so far know it roughly.
        """
        return degrees > (LOOP_TURN_DEG if self.knows_scale else DRIFT_TURN_DEG)

    def saw(self, index: int, time_s: float) -> None:
        """A frame was given, whether it gets a pose or not."""
        if self.enabled:
            self.times[index] = time_s

    def expect(self, time_s: float, *, lost: bool = False) -> Array | None:
        """T_wc (4, 4) at which the next frame is expected in the present map, None if nothing is known.

        lost: its ``heading`` will do where no more is known.
        """
        if self.predictor is None:
            return None
        began = time.perf_counter()
        T_wc = self.predictor.expect(time_s)
        if T_wc is None and lost:
            T_wc = self.predictor.heading(time_s)
        self.seconds += time.perf_counter() - began
        return T_wc

    def rotation_prior(self, T_wc: Array, time_s: float) -> RotationPrior:
        """Of the rotation of ``T_wc`` (4, 4), which ``expect`` said for this time."""
        assert self.predictor is not None
        return RotationPrior(T_wc[:3, :3], self.predictor.turn_sigma(time_s))

    def heading(self, time_s: float) -> Array | None:
        """T_wc (4, 4) of a lost camera: which way it looks, and roughly where; None if nothing is known."""
        if self.predictor is None:
            return None
        began = time.perf_counter()
        T_wc = self.predictor.heading(time_s)
        self.seconds += time.perf_counter() - began
        return T_wc

    def tracked(self, index: int, time_s: float) -> None:
        """The frame got a visual pose."""
        if self.predictor is None:
            return
        began = time.perf_counter()
        self.predictor.record(index, time_s)
        self.seconds += time.perf_counter() - began

    def finish(self, maps: Sequence[Mapping[int, Array]], unit: Unit | None = None) -> MetricPoses | None:
        """The trajectory in metres, z up. maps: of each map the poses T_wc (4, 4) by frame index. unit: see ``Unit``.

        None without an IMU, or if there is nothing to be said about metres; then the user is told why.
        """
        if self.imu is None or not any(maps):
            return None
        began = time.perf_counter() - self.seconds
        order = sorted(self.times)
        position = {index: n for n, index in enumerate(order)}
        T_wc, of_map = np.full((len(order), 4, 4), np.nan), np.full(len(order), -1, np.int64)
        for m, poses in enumerate(maps):
            for index, T in poses.items():
                T_wc[position[index]], of_map[position[index]] = T, m
        visual = VisualPoses(np.array([self.times[i] for i in order]), T_wc, of_map)
        try:
            found = fuse(visual, self.imu)
            by_imu = found.scale, found.scale_sigma
            found = found if unit is None else found.with_unit(unit)
        except (InertialError, UnavailableError) as error:
            used = "scale and gravity stay unknown" if isinstance(error, TooLittleMotionError) else "it is not used"
            self.warn(f"IMU: {error}; {used}")
            contradicted = isinstance(error, ContradictionError)
            self.numbers = {"initialised": False, "contradicted": contradicted, "reason": str(error)}
            return None
        for remark in found.remarks:
            self.warn(f"IMU: {remark}")
        self.log(
            f"IMU: a unit of the map is {found.scale:.4g} m (+- {found.scale_sigma:.2%}), its clock is "
            f"{1000 * found.offset_s:+.2f} ms off, {int(found.bridged.sum())} frames without a visual pose bridged"
        )
        self.numbers = {"initialised": True, **found.numbers(), "seconds": time.perf_counter() - began}
        if unit is not None:
            self.numbers |= {"scale_by_imu": by_imu[0], "scale_by_imu_sigma": by_imu[1]}
        return MetricPoses(found, visual, order)


class MetricPoses:
    """Poses by frame index, in metres and z up. scale: metres in a unit of the map with most frames."""

    def __init__(self, fusion: Fusion, visual: VisualPoses, order: list[int]) -> None:
        self.scale = fusion.scale
        T_wc = fusion.T_wc.copy()
        # Frames that the fit left out, such as those without samples around them, keep their place among the others.
        left = visual.known & ~np.isfinite(T_wc[:, 0, 0])
        if left.any():
            main = int(np.argmax(np.bincount(visual.maps[visual.known])))
            left &= visual.maps == main
            T_wc[left] = fusion.similarity(visual).apply_poses(visual.T_wc[left])
        self.poses = {index: T for index, T in zip(order, T_wc) if np.isfinite(T).all()}
