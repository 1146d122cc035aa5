"""Write a stored run for other programs: its path, its points, or a model with frames, camera and poses."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.bench.request import RunRequest, run_options
from panobench.errors import InputError, OutputError, PanobenchError, UnknownNameError, UsageError
from panobench.geometry import quaternion_from_matrix
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run
    from panobench.splat.gaussians import GaussianMap

#: Gaussians with less opacity are no points of a surface.
MIN_OPACITY = 0.5
#: From OpenCV's camera axes (x right, y down, z forward) to OpenGL's (x right, y up, z backward).
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class ExportFormat:
    """A format: what it is, where it goes by default (a file, or a folder with "/" at its end), and its writer."""

    about: str
    default: str
    write: Callable[[Run, Path, bool], None]


def export_run(run: Run, to: str, output: Path | None = None, *, images: bool = True) -> Path:
    """Write ``run`` in a format of ``FORMATS`` and return the file or folder.

    output: by default a name of the format's in the run's folder's parent. images: models also get their frames, read
    from the data set again. Raises UnknownNameError for the format, UsageError where the run lacks what it holds, and
    OutputError where there is something already.
    """
    if to not in FORMATS:
        raise UnknownNameError("export format", to, FORMATS)
    form = FORMATS[to]
    target = output or run.folder.with_name(run.folder.name + "-" + form.default)
    if target.exists() and (form.default.endswith("/") or target.is_dir()):
        raise OutputError(f"{target} is there already; name another place with --output")
    form.write(run, target, images)
    return target


def _poses(run: Run) -> Any:
    if not len(run.trajectory):
        raise UsageError(f"{run.folder} has no poses to export")
    return run.trajectory


def _tum(run: Run, target: Path, images: bool) -> None:
    from panobench.datasets.trajectory_io import tum_text

    write_whole(target, tum_text(_poses(run)))


def _kitti(run: Run, target: Path, images: bool) -> None:
    """Poses, and their times beside them, as KITTI keeps them."""
    trajectory = _poses(run)
    rows = trajectory.T_wc[:, :3].reshape(-1, 12)
    write_whole(target, "".join(" ".join(f"{v:.12e}" for v in row) + "\n" for row in rows))
    write_whole(target.with_name(f"{target.stem}.times.txt"), "".join(f"{t:.9f}\n" for t in trajectory.times))


def _points(run: Run) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Centres (N, 3) and colours (N, 3) of the opaque Gaussians of its map; none without a map."""
    gaussians: GaussianMap | None = run.map
    if gaussians is None:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    opacity = 1.0 / (1.0 + np.exp(-np.asarray(gaussians.opacity_logits, np.float64).ravel()))
    centres = np.asarray(gaussians.means, np.float32)
    keep = (opacity > MIN_OPACITY) & np.isfinite(centres).all(axis=1)
    colours = np.clip(np.asarray(gaussians.colours)[keep], 0.0, 1.0)
    return centres[keep], np.rint(255.0 * colours).astype(np.uint8)


def _ply_points(run: Run, target: Path, images: bool) -> None:
    centres, colours = _points(run)
    if not len(centres):
        raise UsageError(f"{run.folder} has no map, or nothing opaque in it")
    names = ["x", "y", "z", "red", "green", "blue"]
    table = np.zeros(len(centres), dtype=[(n, "<f4" if n in "xyz" else "u1") for n in names])
    for k, name in enumerate(names):
        table[name] = centres[:, k] if k < 3 else colours[:, k - 3]
    types = "".join(f"property {'float' if n in 'xyz' else 'uchar'} {n}\n" for n in names)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{types}end_header\n"
    write_whole(target, header.encode("ascii") + table.tobytes())


def _colmap(run: Run, target: Path, images: bool) -> None:
    """A text model (cameras.txt, images.txt, points3D.txt) in sparse/0, beside the images.

    https://colmap.github.io/format.html: poses are world-to-camera, quaternions (w, x, y, z).
    """
    from panobench.cameras.calibration import colmap

    trajectory, names = _poses(run), _write_images(run, target, images)
    model = target / "sparse" / "0"
    model.mkdir(parents=True)
    colmap.write(run.camera, model / "cameras.txt")
    camera_id = next(
        line.split()[0] for line in (model / "cameras.txt").read_text().splitlines() if line[:1] not in ("", "#")
    )
    T_cw = np.linalg.inv(trajectory.T_wc)
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points in it\n"]
    for k, (T, name) in enumerate(zip(T_cw, names), 1):
        numbers = [*quaternion_from_matrix(T[:3, :3]), *T[:3, 3]]
        lines.append(f"{k} {' '.join(f'{v:.12g}' for v in numbers)} {camera_id} {name}\n\n")
    write_whole(model / "images.txt", "".join(lines))
    centres, colours = _points(run)
    rows = [
        f"{k} {x:.7g} {y:.7g} {z:.7g} {r} {g} {b} 0\n"
        for k, ((x, y, z), (r, g, b)) in enumerate(zip(centres.tolist(), colours.tolist()), 1)
    ]
    write_whole(model / "points3D.txt", "# POINT3D_ID X Y Z R G B ERROR TRACK\n" + "".join(rows))


def _nerfstudio(run: Run, target: Path, images: bool) -> None:
    """transforms.json beside the images: camera-to-world poses with OpenGL's camera axes, as nerfstudio reads them."""
    from panobench.cameras.calibration.nerfstudio import camera_values

    trajectory, document = _poses(run), camera_values(run.camera)
    names = _write_images(run, target, images)
    document["frames"] = [
        {"file_path": f"images/{name}", "transform_matrix": (T @ OPENGL).tolist()}
        for T, name in zip(trajectory.T_wc, names)
    ]
    if len(_points(run)[0]):
        _ply_points(run, target / "points.ply", images)
        document["ply_file_path"] = "points.ply"
    write_whole(target / "transforms.json", json.dumps(document, indent=1) + "\n")


def _write_images(run: Run, target: Path, images: bool) -> list[str]:
    """A name per pose of the trajectory; with ``images`` the frames are written to images/ under these names."""
    frames = run.frames
    times = frames.get("time", np.zeros(0))
    order = [int(np.abs(times - t).argmin()) if len(times) else k for k, t in enumerate(run.trajectory.times)]
    names = [f"{i:06d}.png" for i in order]
    if images:
        from panobench.bench.setup import open_input
        from panobench.datasets.images import write_image

        spec = run.record.spec
        try:
            sequence = open_input(RunRequest(**{o.name: spec.option(o.name) for o in run_options()}))
        except PanobenchError as error:
            raise InputError(f"the frames cannot be read again ({error}); --no-images leaves them out") from error
        folder = target / "images"
        folder.mkdir(parents=True)
        for i, name in zip(order, names):
            write_image(folder / name, sequence.image(i))
    return names


#: name -> format, as `panobench export --to` takes it.
FORMATS = {
    "tum": ExportFormat("the trajectory: time, position, quaternion (x, y, z, w) per line", "tum.txt", _tum),
    "kitti": ExportFormat("the trajectory: a 3x4 matrix per line, times beside it", "kitti.txt", _kitti),
    "ply-points": ExportFormat("the opaque Gaussians' centres and colours as a point cloud", "points.ply", _ply_points),
    "colmap": ExportFormat("a COLMAP text model with images", "colmap/", _colmap),
    "nerfstudio": ExportFormat("transforms.json with images, as nerfstudio reads them", "nerfstudio/", _nerfstudio),
}
