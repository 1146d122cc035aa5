"""The surface of a map as triangles: depths rendered along the path, fused into a truncated signed distance.

Curless and Levoy, "A volumetric method for building complex models from range images", 1996; surfaces by scikit-image's
marching cubes (Lewiner et al. 2003).
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.base import MIN_OPACITY, ExportOptions, map_of, opacities, poses_of
from panobench.errors import UnavailableError, UsageError
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run
    from panobench.splat.gaussians import GaussianMap

Float = NDArray[np.float32]

#: Panoramas rendered, and their width. Frames are read up to that width, or to ``WIDEST`` where it is asked for.
VIEWS, WIDTH, WIDEST = 32, 1024, 2048
#: Voxels along the longest side unless their size is given, and most of them in all.
SIDE, MOST = 256, 80_000_000
#: The distance is cut at so many voxels; it must reach over the noise of the depths.
TRUNCATION = 2.5
#: Pieces with fewer triangles are dropped.
SMALLEST = 200


@dataclass(frozen=True)
class Mesh:
    """vertices (V, 3) in the map's world; faces (F, 3), seen counter-clockwise from free space; colours (V, 3)."""

    vertices: Float
    faces: NDArray[np.int32]
    colours: NDArray[np.uint8]


def mesh(run: Run, target: Path, options: ExportOptions) -> None:
    """A PLY of triangles with coloured vertices; of panoramas, plain walls are put where the frames agree on them.

    Raises UnavailableError without scikit-image, InputError where the frames cannot be read again.
    """
    gaussians, path = map_of(run), poses_of(run).T_wc
    chosen = chosen_poses(len(path))
    depths, colours = _views(gaussians, path[chosen])
    if options.images and run.camera.kind == "erp":
        depths = _by_frames(run, chosen, depths, options.width)
    made = surface(gaussians, path[chosen], depths, colours, options.voxel)
    write_whole(target, mesh_ply(made))


def chosen_poses(count: int) -> NDArray[np.int64]:
    """Numbers of the poses, of so many, from which the map is looked at."""
    return np.unique(np.linspace(0, count - 1, VIEWS).round().astype(np.int64))


def _by_frames(run: Run, chosen: NDArray[np.int64], depths: Float, width: int | None) -> Float:
    """The depths (K, H, W) at the chosen poses, corrected by the frames there, read at a width (None: the run's)."""
    from panobench.bench.export.frame_depth import depths_by_frames
    from panobench.bench.export.frames import frames_of, shots_of
    from panobench.bench.export.posed_panoramas import posed_panoramas

    every = shots_of(run, ExportOptions())
    shots = [every[k] for k in chosen]
    T_wc = np.stack([shot.T_wc for shot in shots])
    widest = min(max(width or 0, WIDTH), WIDEST)
    views = posed_panoramas(frames_of(run, width), [shot.frame for shot in shots], T_wc, depths, widest)
    return depths_by_frames(views, depths)


def surface(
    gaussians: GaussianMap,
    T_wc: NDArray[np.float64],
    depths: Float,
    colours: NDArray[np.uint8],
    voxel: float | None = None,
) -> Mesh:
    """The surface that panoramas at poses (K, 4, 4) see at radial depths (K, H, W), NaN where unknown.

    colours (K, H, W, 3). voxel: edge in the map's unit, None: a ``SIDE``-th of its extent. Raises UnavailableError
    without scikit-image, UsageError for a voxel that is too small, or where nothing is opaque.
    """
    try:
        from skimage.measure import marching_cubes
    except ImportError as error:
        raise UnavailableError("a mesh needs the package scikit-image: pip install 'panobench[mesh]'") from error
    from panobench.bench.export.fusion import fuse

    low, high = _box(gaussians)
    size = voxel if voxel is not None else float((high - low).max()) / SIDE
    if not (math.isfinite(size) and size > 0):
        raise UsageError(f"--voxel {voxel}: give the edge of a voxel in the map's unit, as in 0.02")
    shape = tuple(int(n) for n in np.ceil((high - low) / size) + 1)
    if math.prod(shape) > MOST:
        raise UsageError(f"--voxel {size:g} makes {math.prod(shape):,} voxels; {MOST:,} is the most")
    distance, weight = fuse(depths, T_wc, low, shape, size, TRUNCATION * size)
    try:
        vertices, faces, _, _ = marching_cubes(
            distance, 0.0, mask=_whole_cubes(weight > 0), gradient_direction="descent"
        )
    except (ValueError, RuntimeError) as error:  # no voxel on either side
        raise UsageError(f"no surface was found in the map ({error})") from error
    faces = _large_pieces(faces, len(vertices))
    used, faces = np.unique(faces, return_inverse=True)
    points = (low + size * vertices[used]).astype(np.float32)
    return Mesh(
        points, faces.reshape(-1, 3).astype(np.int32), _colours(points, depths, colours, T_wc, TRUNCATION * size)
    )


def _whole_cubes(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether all corners of the cube that ends at a voxel were seen: no surface stands where sight ends."""
    whole = np.zeros_like(seen)
    corners = [
        seen[i : i - 1 or None, j : j - 1 or None, k : k - 1 or None] for i in (0, 1) for j in (0, 1) for k in (0, 1)
    ]
    whole[1:, 1:, 1:] = np.logical_and.reduce(corners)
    return whole


def _box(gaussians: GaussianMap) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners around nearly all opaque Gaussians: what stands far outside would make the voxels large."""
    points = gaussians.means[(opacities(gaussians) > MIN_OPACITY) & np.isfinite(gaussians.means).all(axis=1)]
    if len(points) < 10:
        raise UsageError("the map has nothing opaque to make a surface of")
    low, high = np.quantile(points.astype(np.float64), [0.005, 0.995], axis=0)
    margin = 0.03 * (high - low).max()
    return low - margin, high + margin


def _views(gaussians: GaussianMap, poses: NDArray[np.float64]) -> tuple[Float, NDArray[np.uint8]]:
    """Radial depths (K, H, W), NaN where the map is not opaque, and colours (K, H, W, 3) of panoramas."""
    from panobench.cameras.erp import ErpCamera
    from panobench.splat.render import Renderer

    renderer = Renderer(ErpCamera(WIDTH, WIDTH // 2))
    depths, colours = [], []
    for pose in poses:
        render = renderer.forward(gaussians, pose, sloped=True)
        depths.append(render.expected_depth(0.8))
        colours.append(np.rint(255 * np.clip(np.nan_to_num(render.colour), 0, 1)).astype(np.uint8))
    return np.stack(depths), np.stack(colours)


def _large_pieces(faces: NDArray[np.integer], count: int) -> NDArray[np.integer]:
    """The faces of connected pieces that are not specks."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    ends = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(ends), bool), (ends[:, 0], ends[:, 1])), shape=(count, count))
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    sizes = np.bincount(piece)
    return faces[sizes[piece] >= min(SMALLEST, int(sizes.max()))]


def _colours(
    points: Float, depths: Float, colours: NDArray[np.uint8], poses: NDArray[np.float64], reach: float
) -> NDArray[np.uint8]:
    """(V, 3): the mean of the views that see a vertex; grey where none does."""
    from panobench.cameras.erp import ErpCamera

    camera = ErpCamera(depths.shape[2], depths.shape[1])
    total, weight = np.zeros((len(points), 3)), np.zeros(len(points))
    for depth, colour, pose in zip(depths, colours, poses):
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        pixels, _ = camera.project(local)
        column = np.clip(pixels[:, 0].astype(int), 0, camera.width - 1)
        row = np.clip(pixels[:, 1].astype(int), 0, camera.height - 1)
        distance = np.linalg.norm(local, axis=1)
        near = np.abs(depth[row, column] - distance) < reach
        share = near / np.maximum(distance, 1e-6)
        total += share[:, None] * colour[row, column]
        weight += share
    mean = np.where(weight[:, None] > 0, total / np.maximum(weight, 1e-12)[:, None], 128.0)
    return np.rint(mean).astype(np.uint8)


def mesh_ply(made: Mesh) -> bytes:
    """The mesh as binary PLY."""
    from plyfile import PlyData, PlyElement

    vertex = np.zeros(len(made.vertices), [*((n, "f4") for n in "xyz"), *((n, "u1") for n in ("red", "green", "blue"))])
    for k, name in enumerate(vertex.dtype.names or ()):
        vertex[name] = made.vertices[:, k] if k < 3 else made.colours[:, k - 3]
    face = np.zeros(len(made.faces), [("vertex_indices", "i4", (3,))])
    face["vertex_indices"] = made.faces
    content = io.BytesIO()
    PlyData([PlyElement.describe(vertex, "vertex"), PlyElement.describe(face, "face")], byte_order="<").write(content)
    return content.getvalue()
