"""Old references that may show the place where the camera is, and the checks that only the right ones pass.

By the poses so far, a place is near; by its appearance it is recognised whatever the position has drifted by. Rotations
of a wide view hardly drift, so how two references are turned to each other is known, and where an alignment says
something else, the place is another. Buildings have places that look the same: a revisit may not ask for more drift
than the way between the visits explains. That way goes through revisits that are already believed, so the more places
tie a trajectory together, the less can be believed of it that is wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from panobench.geometry import invert_pose, so3_log
from panobench.methods.panogs.config import RevisitOptions
from panobench.methods.panogs.factor_graph.place_recognition import Places, Thumbnail
from panobench.methods.panogs.tracking.agreement import FINE, share_alike
from panobench.photometric.align import Alignment
from panobench.photometric.pyramid import F32
from panobench.photometric.stereo import WorkingScale
from panobench.photometric.warp import sample_points

Pose = NDArray[np.float64]


@dataclass
class Way:
    """The trajectory over references as a graph: consecutive ones, and those that revisits tie together.

    ties: pairs of numbers in the list of references.
    """

    ties: list[tuple[int, int]] = field(default_factory=list)

    def lengths(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,): how far each reference is from the newest, the last of positions (N, 3), along the graph."""
        count = len(positions)
        i = np.array([*range(count - 1), *(a for a, _ in self.ties)], np.int64)
        j = np.array([*range(1, count), *(b for _, b in self.ties)], np.int64)
        steps = np.maximum(np.linalg.norm(positions[i] - positions[j], axis=1), 1e-12)  # an edge of length 0 is none
        graph = coo_matrix((steps, (i, j)), (count, count)).tocsr()
        return np.asarray(dijkstra(graph, directed=False, indices=count - 1))


class Recogniser:
    """Thumbnails of all references in their order, and the checks on those that look alike.

    newest: the newest reference's.
    """

    def __init__(self, scale: WorkingScale, options: RevisitOptions) -> None:
        self.scale, self.options = scale, options
        self.places = Places(scale.camera)
        self.newest: Thumbnail | None = None
        self.weights = np.nan_to_num(scale.camera.solid_angle()).astype(np.float32)
        self.fine = FINE.for_camera(scale.camera)

    def add(self, luma: F32) -> None:
        """The newest reference's luma (h, w)."""
        self.newest = self.places.thumbnail(luma)
        self.places.add(self.newest)

    def alike(self, among: NDArray[np.bool_]) -> list[int]:
        """The references that look most like the newest, best first; among (N,): only these."""
        if self.newest is None:
            return []
        return [m.number for m in self.places.find(self.newest, self.options.alike, among)]

    def is_right(self, luma: F32, depth_map: F32, old: F32, start: Pose, found: Alignment) -> bool:
        """Whether an alignment of an old reference, from the pose T_fr ``start``, shows it to be the newest's place.

        luma, depth_map (h, w): of the newest, NaN where unknown; old (h, w): luma of the old reference.
        """
        turn = so3_log(found.T_fr[:3, :3] @ start[:3, :3].T)
        if not np.isfinite(found.cost) or np.degrees(np.linalg.norm(turn)) > self.options.turn_max:
            return False
        seen = self._seen_from(depth_map, old, found.T_fr)
        known = np.isfinite(luma) & np.isfinite(seen)
        return share_alike(luma, seen, known, self.weights, self.fine.alike) >= self.options.agree

    def _seen_from(self, depth_map: F32, old: F32, T_fr: Pose) -> F32:
        """(h, w): what the old reference shows of the points of a depth map; NaN where that is not known."""
        s = self.scale
        points = (s.rays * depth_map[..., None]).reshape(-1, 3)
        return sample_points(old, points, T_fr, s.code, s.cam).reshape(depth_map.shape)


def drift_of(start: Pose, found: Alignment) -> float:
    """How far an alignment moves the old reference from where the poses so far, T_fr ``start`` (4, 4), have it."""
    moved = invert_pose(found.T_fr)[:3, 3] - invert_pose(start)[:3, 3]
    return float(np.linalg.norm(moved))
