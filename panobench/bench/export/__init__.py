"""Write a stored run for other programs: its path, its points or surface, its splats, a film, or a whole model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from panobench.bench.export import mesh, models, movie, splats, trajectories
from panobench.bench.export.base import ExportFormat, ExportOptions
from panobench.errors import OutputError, UnknownNameError

if TYPE_CHECKING:
    from panobench.api import Run


def export_run(run: Run, to: str, output: Path | None = None, options: ExportOptions | None = None) -> Path:
    """Write ``run`` in a format of ``FORMATS`` and return the file or folder.

    output: by default a name of the format's in the run's folder's parent. Raises UnknownNameError for the format,
    UsageError where the run lacks what it holds, UnavailableError where a package is missing, and OutputError where
    there is something already.
    """
    if to not in FORMATS:
        raise UnknownNameError("export format", to, FORMATS)
    form = FORMATS[to]
    target = output or run.folder.with_name(run.folder.name + "-" + form.default)
    if target.exists() and (form.default.endswith("/") or target.is_dir()):
        raise OutputError(f"{target} is there already; name another place with --output")
    form.write(run, target, options or ExportOptions())
    return target


def _recording(run: Run, target: Path, options: ExportOptions) -> None:
    from panobench.viewer.recording import write_recording

    write_recording(run, target)


#: name -> format, as `panobench export --to` takes it.
FORMATS = {
    "tum": ExportFormat("time, position, quaternion (x, y, z, w) per line", "tum.txt", trajectories.tum),
    "kitti": ExportFormat("a 3x4 matrix per line, times beside it", "kitti.txt", trajectories.kitti),
    "ply-points": ExportFormat("the opaque Gaussians as a point cloud", "points.ply", models.ply_points),
    "mesh": ExportFormat("a triangle mesh with colours", "mesh.ply", mesh.mesh),
    "colmap": ExportFormat("a COLMAP text model with images", "colmap/", models.colmap),
    "nerfstudio": ExportFormat("transforms.json with images", "nerfstudio/", models.nerfstudio),
    "ply-sh3": ExportFormat("the map with spherical harmonics of degree 3, all zero", "sh3.ply", splats.ply_sh3),
    "splat": ExportFormat("the map, 32 bytes per Gaussian", "map.splat", splats.splat),
    "spz": ExportFormat("the map, compressed", "map.spz", splats.spz),
    "sog": ExportFormat("the map, compressed as pictures", "map.sog", splats.sog),
    "mp4": ExportFormat("a film along the path", "path.mp4", movie.mp4),
    "rrd": ExportFormat("a recording for the Rerun viewer", "run.rrd", _recording),
}
