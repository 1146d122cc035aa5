"""Initial poses of the first frames: by alignment to a sphere of constant depth, or from feature tracks.

For wide views constant depth is enough: rotation and translation move a panorama in different ways, however wrong the
depth. In a narrow view of constant depth, sideways translation looks like rotation; such views start from the
essential matrix of the ``sparse`` method's tracks, which needs no depth.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from panobench.cameras.base import Camera
from panobench.depth.bootstrap_solve import HUBER, MEDIAN_DEPTH, Pose, Solver
from panobench.geometry import invert_pose, renormalise
from panobench.photometric.align import Alignment, align, mean_cost
from panobench.photometric.overlap import ViewShare
from panobench.photometric.pyramid import F32
from panobench.photometric.reference import Reference
from panobench.photometric.rotation_only import RotationOnlyAligner
from panobench.types import Frame

#: An alignment whose cost exceeds that of the frames before it by this factor is repeated from another initial pose.
COST_JUMP = 1.5


@dataclass
class Start:
    """reference: the reference's position among the frames. T_fr: for it and each frame after it, the pose that takes
    points from the reference to the frame. seen: share of the reference's view that each frame sees, for a scene at
    the median depth.
    """

    reference: int
    T_fr: list[Pose]
    seen: list[float]

    def parallax(self) -> float:
        """Largest translation from the reference, in median depths (radians)."""
        return max(float(np.linalg.norm(T[:3, 3])) for T in self.T_fr) / MEDIAN_DEPTH

    def without_parallax(self) -> int:
        """How many frames show no parallax: they are within 1% of the median depth from the reference."""
        return sum(float(np.linalg.norm(T[:3, 3])) < 0.01 * MEDIAN_DEPTH for T in self.T_fr[1:])


class PoseStart(ABC):
    """A source of initial poses. It takes the frames one by one."""

    label: str

    @abstractmethod
    def add(self, frame: Frame, pyramids: list[list[F32]]) -> None:
        """Take the next frame. ``pyramids`` are the luma pyramids of all frames up to it."""

    @abstractmethod
    def start(self) -> Start | None:
        """The poses so far, None if there are none yet."""

    @abstractmethod
    def close(self) -> None:
        """Free resources. Nothing else is called afterwards."""


class FlatStart(PoseStart):
    """Aligns every frame to the first one, which has a constant depth."""

    label = "constant depth"

    def __init__(self, camera: Camera, solver: Solver) -> None:
        self.camera, self.solver, self.level = camera, solver, solver.coarse.level
        self.T_fr: list[Pose] = []
        self.costs: list[float] = []
        self.view = ViewShare(camera)
        self.seen: list[float] = []
        self.reference: Reference | None = None
        self.aligner: RotationOnlyAligner | None = None

    def add(self, frame: Frame, pyramids: list[list[F32]]) -> None:
        k = len(self.T_fr)
        if self.reference is None or self.aligner is None:
            self.reference = self.solver.flat(pyramids[0])
            self.aligner = RotationOnlyAligner(self.camera, len(pyramids[0]))
            self.T_fr, self.seen = [np.eye(4)], [1.0]
            return
        found, cost = self._aligned(self.reference, pyramids[k], self._predicted())
        if k == 1 or not cost < COST_JUMP * float(np.median(self.costs[-3:])):
            rotation = self.aligner.rotation(pyramids[k - 1], pyramids[k])
            if rotation is not None:
                other, other_cost = self._aligned(self.reference, pyramids[k], rotation @ self.T_fr[-1])
                if other_cost < cost:
                    found, cost = other, other_cost
        self.T_fr.append(found.T_fr)
        self.costs.append(cost)
        self.seen.append(self.view.of(found.T_fr, MEDIAN_DEPTH))

    def start(self) -> Start | None:
        return Start(0, self.T_fr, self.seen) if self.T_fr else None

    def close(self) -> None:
        self.reference = None

    def _predicted(self) -> Pose:
        """Pose of the newest frame by constant velocity from the two before it."""
        T = self.T_fr
        return T[-1] if len(T) < 2 else renormalise(T[-1] @ invert_pose(T[-2]) @ T[-1])

    def _aligned(self, reference: Reference, pyramid: list[F32], T_fr: Pose) -> tuple[Alignment, float]:
        frame = pyramid[self.level :]
        found = align(reference, frame, T_fr, self.solver.align_options)
        cost, seen = mean_cost(reference, frame, found, HUBER)
        return found, cost if seen > 0.1 else np.inf


class TrackStart(PoseStart):
    """Runs the ``sparse`` method on the frames; the first frame of its map is the reference."""

    label = "feature tracks"

    def __init__(self, camera: Camera, seed: int = 0) -> None:
        from panobench.methods.base import MethodContext
        from panobench.methods.sparse.config import SparseConfig
        from panobench.methods.sparse.method import SparseMethod

        self.view = ViewShare(camera)
        self.method = SparseMethod(SparseConfig(loops=False))
        self.method.start(camera, MethodContext(seed=seed))
        self.position: dict[int, int] = {}

    def add(self, frame: Frame, pyramids: list[list[F32]]) -> None:
        self.position[frame.index] = len(pyramids) - 1
        self.method.track(frame)

    def poses(self) -> dict[int, Pose]:
        """T_wc of every frame that was tracked, by its number."""
        session = self.method.session
        return {} if session is None else {r.index: invert_pose(session.pose_of(r)) for r in session.records}

    def start(self) -> Start | None:
        from panobench.methods.sparse.pointmap import ACTIVE

        session = self.method.session
        if session is None or len(session.records) < 3:
            return None
        first = self.position[session.records[0].index]
        poses = {self.position[r.index]: session.pose_of(r) for r in session.records}
        T_rw = invert_pose(poses[first])
        points = session.map.position[session.map.state == ACTIVE]
        if len(points) < 12:
            return None
        factor = MEDIAN_DEPTH / float(np.median(np.linalg.norm(points - T_rw[:3, 3], axis=1)))
        T_fr = [np.eye(4)]
        for k in range(first + 1, max(poses) + 1):
            T = T_fr[-1].copy()  # if the frame was not tracked, alignment starts from the one before
            if k in poses:
                T = poses[k] @ T_rw
                T[:3, 3] *= factor
            T_fr.append(T)
        return Start(first, T_fr, [self.view.of(T, MEDIAN_DEPTH) for T in T_fr])

    def close(self) -> None:
        self.method.pool.shutdown()
