"""What flows between datasets, methods, metrics and reports.

Conventions (tested, used everywhere): camera frame x right, y down, z forward; poses are
camera-to-world ``T_wc`` (4, 4) float64 in metres; time in seconds; images RGB uint8 (H, W, 3);
depth is radial distance in metres, float32, NaN where unknown; pixel centres at k + 0.5.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from panobench.geometry import distances_along

if TYPE_CHECKING:
    from panobench.cameras.base import Camera


class RunStatus(str, enum.Enum):
    """How a run ended. Every planned run ends with exactly one of these."""

    OK = "ok"
    LOST = "lost"  # it ran, but tracked too little to be scored
    TIMEOUT = "timeout"
    OUT_OF_MEMORY = "out-of-memory"
    CRASHED = "crashed"
    UNSUPPORTED = "unsupported"
    UNAVAILABLE = "unavailable"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class Frame:
    """One image as a method sees it. Ground truth is never part of it.

    ``mappable`` is False for held-out frames: they are tracked, and must not be mapped.
    ``depth`` is only filled for runs that declared the dataset's depth as an input (oracle).
    ``mask`` (H, W) is where this frame shows the scene, besides the camera's mask; None: wherever the camera sees. What
    it hides is black. Methods whose spec says ``frame_masks`` honour it.
    ``lenses`` has one picture (H, W, 3) for each lens of ``MethodContext.rig``, for methods that take rigs.
    """

    index: int
    time: float
    image: NDArray[np.uint8]
    mappable: bool = True
    depth: NDArray[np.float32] | None = None
    name: str = ""
    mask: NDArray[np.bool_] | None = None
    lenses: tuple[NDArray[np.uint8], ...] = ()


@dataclass(frozen=True)
class Trajectory:
    """Times (N,) in seconds, strictly increasing, and camera-to-world poses (N, 4, 4)."""

    times: NDArray[np.float64]
    T_wc: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.times)

    @property
    def positions(self) -> NDArray[np.float64]:
        """(N, 3) camera centres in the world, metres."""
        return self.T_wc[:, :3, 3]

    def path_length(self) -> float:
        """Sum of the distances between consecutive positions, metres."""
        return float(distances_along(self.positions)[-1])

    def select(self, index: NDArray[Any] | list[int]) -> Trajectory:
        """The poses at ``index`` (any numpy index)."""
        return Trajectory(self.times[index], self.T_wc[index])


@dataclass(frozen=True)
class Imu:
    """Inertial samples: times (N,), angular rate (N, 3) rad/s and specific force (N, 3) m/s^2, body axes.

    The times are on the camera's clock. T_body_cam: pose (4, 4) of the camera in the body's axes; None: the body's
    axes are the camera's. gravity: its magnitude where the data were recorded, m/s^2; None: not known.
    """

    times: NDArray[np.float64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    T_body_cam: NDArray[np.float64] | None = None
    gravity: float | None = None


@dataclass(frozen=True)
class NovelView:
    """A view apart from the trajectory, for judging the map: image, its camera and true pose."""

    name: str
    image: NDArray[np.uint8]
    camera: Camera
    T_wc: NDArray[np.float64]


class GaussianMapLike(Protocol):
    """What the runner needs of a map: its size and a way to store it."""

    def __len__(self) -> int: ...

    def write_ply(self, path: Path) -> None: ...


@dataclass
class Estimate:
    """A method's answer.

    trajectory: poses of the frames it tracked, at those frames' times (a subset of the input times).
    keyframes:  indices of input frames used as keyframes.
    metric:     True if the scale is meant to be metres (then ATE without scale alignment is measured too).
    gravity_aligned: True if the world's z axis is meant to point up (then its error is measured; contract 1.1).
    map:        the final map, if there is one to store.
    frames:     per-frame numbers keyed by frame index, written to frames.csv (loss, iterations, ...).
    depth:      the depth the map was started with, for the report (see ``DepthEstimate``).
    extra:      JSON-serialisable remarks for run.json.
    moving:     by frame index, masks (H, W) that are False where the method found that something moves by itself, and
                left it out (contract 1.1).
    """

    trajectory: Trajectory
    keyframes: list[int] = field(default_factory=list)
    metric: bool = False
    gravity_aligned: bool = False
    map: GaussianMapLike | None = None
    frames: dict[int, dict[str, float]] = field(default_factory=dict)
    depth: DepthEstimate | None = None
    extra: dict[str, Any] = field(default_factory=dict)
    moving: Mapping[int, NDArray[np.bool_]] = field(default_factory=dict)


@dataclass
class DepthEstimate:
    """Radial depth of frame ``frame_index``: (H, W) float32, NaN where unknown, in the method's own unit.

    confidence (H, W) in 0..1 or None. ``T_wc`` holds poses of the frames looked at (by frame index,
    first one the identity), when the estimator found them. ``ok`` False: the estimator detected its
    own failure and this is its fallback; ``message`` says so in one line.
    """

    depth: NDArray[np.float32]
    frame_index: int = 0
    confidence: NDArray[np.float32] | None = None
    T_wc: dict[int, NDArray[np.float64]] = field(default_factory=dict)
    metric: bool = False
    ok: bool = True
    message: str = ""
