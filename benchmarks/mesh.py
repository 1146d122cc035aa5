"""How true a mesh is: precision, recall and F-score beside the exact surface that a run's frames see.

    panobench run --method panogs --sequence room1 --width 512 --max-frames 120 --out RUN
    panobench export RUN --to mesh --width 1024 --voxel 0.02 -o room1.ply
    python benchmarks/mesh.py RUN room1.ply

Only for runs on sequences with exact depth, such as the built-in rooms. The mesh is aligned by the run's trajectory
(Sim(3)). Precision is the share of its surface within ``--tolerance`` of the true one, recall the converse. What the
room's backdrops show, the street behind a window, counts on neither side.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from plyfile import PlyData
from scipy.spatial import cKDTree

from panobench.api import Run
from panobench.bench.export.frames import frames_of
from panobench.datasets.base import FrameSequence
from panobench.datasets.open import open_sequence
from panobench.datasets.synthetic.rooms import RoomSequence
from panobench.geometry import umeyama

Array = NDArray[np.float64]

#: Width of the panoramas of exact depth; edge of the cells that keep one of their points each, metres.
WIDTH, CELL = 1024, 0.005
#: Points per square metre of a mesh.
DENSITY = 20_000


@dataclass(frozen=True)
class Score:
    precision: float
    recall: float

    @property
    def f(self) -> float:
        return 2 * self.precision * self.recall / max(self.precision + self.recall, 1e-12)

    def __str__(self) -> str:
        return f"F {self.f:.3f} (precision {self.precision:.3f}, recall {self.recall:.3f})"


@dataclass(frozen=True)
class TrueSurface:
    """Points (N, 3) of a surface that frames see, in metres, evenly spread; those within low and high (3,) count."""

    points: Array
    low: Array
    high: Array

    @classmethod
    def seen_by(cls, frames: FrameSequence, low: Array, high: Array) -> TrueSurface:
        truth, rays = frames.groundtruth, frames.camera.rays()
        points = np.zeros((0, 3))
        for k, T in enumerate(truth.T_wc if truth else ()):
            depth = frames.depth(k)
            if depth is None:
                break
            seen = np.isfinite(depth)
            new = (depth[seen][:, None] * rays[seen]) @ T[:3, :3].T + T[:3, 3]
            points = _one_per_cell(np.concatenate([points, _within(new, low, high)]))
        if not len(points):
            raise SystemExit(f"{frames.name} has no exact depth")
        return cls(points, low, high)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.points)

    def score(self, points: Array, tolerance: float) -> Score:
        """Of points (M, 3) in metres, evenly spread over another surface."""
        points = _within(points, self.low, self.high)
        if not len(points):
            return Score(0.0, 0.0)
        near, _ = self._tree.query(points, distance_upper_bound=tolerance)
        found, _ = cKDTree(points).query(self.points, distance_upper_bound=tolerance)
        return Score(float(np.isfinite(near).mean()), float(np.isfinite(found).mean()))


def room_box(run: Run, margin: float = 0.05) -> tuple[Array, Array]:
    """Corners of all that a built-in room has but its backdrops; of everything in other sequences."""
    spec = run.record.spec
    sequence = open_sequence(spec.option("dataset"), spec.option("sequence"), spec.option("root"))
    if not isinstance(sequence, RoomSequence):
        return np.full(3, -np.inf), np.full(3, np.inf)
    mesh = sequence.world.plan.mesh
    backdrop = np.array([m.texture != "" and max(m.emission) > 0 for m in mesh.materials])
    solid = ~backdrop[mesh.material]
    corners = np.concatenate([mesh.p0[solid], (mesh.p0 + mesh.eu)[solid], (mesh.p0 + mesh.ev)[solid]])
    return corners.min(axis=0) - margin, corners.max(axis=0) + margin


def points_on(vertices: Array, faces: NDArray[np.integer], seed: int = 0) -> Array:
    """Random points on triangles (F, 3), ``DENSITY`` to a square metre."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    generator = np.random.default_rng(seed)
    which = generator.choice(len(faces), int(DENSITY * area.sum()), p=area / area.sum())
    s, t = generator.random((2, len(which), 1))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    return np.asarray(a[which] + s * (b - a)[which] + t * (c - a)[which])


def in_metres(run: Run, points: Array) -> Array:
    """Points (N, 3) of the run's world in that of the ground truth, by the trajectory."""
    truth = run.groundtruth
    if truth is None:
        raise SystemExit(f"{run.folder} has no ground truth")
    _, of_run, of_truth = np.intersect1d(run.trajectory.times, truth.times, return_indices=True)
    return umeyama(run.trajectory.T_wc[of_run, :3, 3], truth.T_wc[of_truth, :3, 3]).apply_points(points)


def _within(points: Array, low: Array, high: Array) -> Array:
    return points[((points > low) & (points < high)).all(axis=1)]


def _one_per_cell(points: Array) -> Array:
    cells = np.floor(points / CELL).astype(np.int64) + (1 << 20)
    _, first = np.unique(cells @ np.array([1 << 42, 1 << 21, 1]), return_index=True)
    return points[first]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--tolerance", type=float, default=0.02, help="metres")
    options = parser.parse_args()
    run, read = Run(options.run), PlyData.read(str(options.mesh))
    vertices = np.stack([np.asarray(read["vertex"][axis], np.float64) for axis in "xyz"], axis=1)
    faces = np.stack([np.asarray(face) for face in read["face"]["vertex_indices"]])
    surface = TrueSurface.seen_by(frames_of(run, WIDTH), *room_box(run))
    print(surface.score(points_on(in_metres(run, vertices), faces), options.tolerance))


if __name__ == "__main__":
    main()
