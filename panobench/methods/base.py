"""The method contract. A method sees frames and a camera, never ground truth; the framework times and scores it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.types import Estimate, Frame, Imu

if TYPE_CHECKING:
    from panobench.cameras.base import Camera
    from panobench.cameras.rig import Rig
    from panobench.datasets.base import FrameSequence
    from panobench.depth.base import DepthEstimator
    from panobench.gpu.device import Device
    from panobench.maps.saved import SavedMap


def _silent(_: str) -> None:
    return None


@dataclass
class MethodContext:
    """What the framework gives a method when it starts.

    seed:       all randomness must come from it.
    work:       an empty folder it may write to; nothing outside it.
    make_depth: makes a fresh depth estimator as chosen by --depth (None: the method was run without one).
    imu:        inertial samples, where its spec says that it needs or uses them (None: --imu off, or there are none).
    rig:        the lenses of ``Frame.lenses``, for methods that take rigs, where the data have one (contract 1.1).
                Poses are those of its axes, which are the camera's.
    poses:      camera-to-world poses by frame index, only for methods whose spec needs "poses".
    saved_map:  the map to start from, only for methods whose spec says ``maps``; poses are then in its frame.
    log:        one line for the run's log.txt.
    warn:       one line that the user should see at once; it is logged too (contract 1.1).
    device:     the GPU that maps are to be computed on, as ``splat.Renderer`` takes it, for methods that say that
                they use one; None: the CPU (contract 1.1).
    """

    seed: int = 0
    work: Path = field(default_factory=Path.cwd)
    make_depth: Callable[[], DepthEstimator] | None = None
    imu: Imu | None = None
    rig: Rig | None = None
    poses: dict[int, NDArray[np.float64]] | None = None
    saved_map: SavedMap | None = None
    log: Callable[[str], None] = _silent
    warn: Callable[[str], None] = _silent
    device: Device | None = None


@dataclass(frozen=True)
class LiveMap:
    """What a method's map looks like now, in the method's world: points (N, 3), their colours (N, 3) RGB in 0..1, and
    the poses (K, 4, 4) of its keyframes. Not to be written into.
    """

    points: NDArray[np.float32]
    colours: NDArray[np.float32]
    keyframes: NDArray[np.float64]


class OnlineMethod(ABC):
    """Takes frames one by one. The constructor gets the config object named in its spec (or nothing).

    uses_device: whether it computes on ``MethodContext.device``, where it is given one (contract 1.1).
    """

    uses_device = False

    def __init__(self, config: Any = None) -> None:
        self.config = config

    def warm_up(self, camera: Camera) -> None:
        """Called once before ``start``, and not timed: for what has nothing to do with the frames, such as compiling or
        loading code for the kind of ``camera``. Must not change any result.
        """
        return None

    @abstractmethod
    def start(self, camera: Camera, context: MethodContext) -> None:
        """Called once before the first frame; ``camera`` is one of the kinds its spec accepts."""

    @abstractmethod
    def track(self, frame: Frame) -> NDArray[np.float64] | None:
        """Camera-to-world pose (4, 4) of this frame, or None if not known yet or lost.

        Frames with ``mappable`` False must be tracked only. A None may still be filled in by ``finish``.
        """

    @abstractmethod
    def finish(self) -> Estimate:
        """The final answer. Also called after Ctrl-C, with what was tracked so far."""

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.float32] | None:
        """RGB (H, W, 3) in 0..1 seen from a pose in the method's own world; None if it has no such map."""
        return None

    def known_poses(self) -> Mapping[int, NDArray[np.float64]] | None:
        """Camera-to-world poses by frame index as they are known now, for a run that is stopped without ``finish``.

        None: those that ``track`` gave.
        """
        return None

    def live_map(self) -> LiveMap | None:
        """The map as it is between two frames, for viewers; None if there is none to show. Cheap."""
        return None

    def saved_map(self) -> SavedMap | None:
        """The map for another run to start from, asked for after ``finish``; None: there is none (contract 1.1)."""
        return None


class BatchMethod(ABC):
    """Takes a whole sequence at once (and sees neither its ground truth nor its depth).

    uses_device: as ``OnlineMethod.uses_device``.
    """

    uses_device = False

    def __init__(self, config: Any = None) -> None:
        self.config = config

    def warm_up(self, camera: Camera) -> None:
        """As ``OnlineMethod.warm_up``."""
        return None

    def set_up(self, sequence: FrameSequence, context: MethodContext) -> None:
        """Called once before ``run``, and timed apart: for what is made once and kept for later runs."""
        return None

    @abstractmethod
    def run(self, sequence: FrameSequence, context: MethodContext) -> Estimate:
        """Process the sequence; files go below ``context.work``."""

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> NDArray[np.float32] | None:
        """As ``OnlineMethod.render``."""
        return None
