"""Models for other programs: frames, camera, poses and points, as COLMAP and nerfstudio keep them, or points alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from panobench.bench.export.base import ExportOptions, opaque_points
from panobench.bench.export.frames import model_camera, shots_of, write_pictures, write_rig
from panobench.errors import UsageError
from panobench.geometry import invert_pose, quaternion_from_matrix
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run

#: From OpenCV's camera axes (x right, y down, z forward) to OpenGL's (x right, y up, z backward).
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def ply_points(run: Run, target: Path, options: ExportOptions) -> None:
    centres, colours = opaque_points(run)
    if not len(centres):
        raise UsageError(f"{run.folder} has no map, or nothing opaque in it")
    names = ["x", "y", "z", "red", "green", "blue"]
    table = np.zeros(len(centres), dtype=[(n, "<f4" if n in "xyz" else "u1") for n in names])
    for k, name in enumerate(names):
        table[name] = centres[:, k] if k < 3 else colours[:, k - 3]
    types = "".join(f"property {'float' if n in 'xyz' else 'uchar'} {n}\n" for n in names)
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(table)}\n{types}end_header\n"
    write_whole(target, header.encode("ascii") + table.tobytes())


def colmap(run: Run, target: Path, options: ExportOptions) -> None:
    """A text model (cameras.txt, images.txt, points3D.txt) in sparse/0, beside the images; of faces also their rig.

    https://colmap.github.io/format.html: poses are world-to-camera, quaternions (w, x, y, z).
    """
    from panobench.cameras.calibration import colmap as calibration

    camera, shots = model_camera(run, options), shots_of(run, options)
    if options.images:
        write_pictures(run, shots, target, options)
    model = target / "sparse" / "0"
    model.mkdir(parents=True)
    if options.faces:
        write_rig(target / "rig_config.json")
    calibration.write(camera, model / "cameras.txt")
    camera_id = next(
        line.split()[0] for line in (model / "cameras.txt").read_text().splitlines() if line[:1] not in ("", "#")
    )
    lines = ["# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then a line of points in it\n"]
    for k, shot in enumerate(shots, 1):
        T = invert_pose(shot.T_wc)
        numbers = [*quaternion_from_matrix(T[:3, :3]), *T[:3, 3]]
        lines.append(f"{k} {' '.join(f'{v:.12g}' for v in numbers)} {camera_id} {shot.name}\n\n")
    write_whole(model / "images.txt", "".join(lines))
    centres, colours = opaque_points(run)
    rows = [
        f"{k} {x:.7g} {y:.7g} {z:.7g} {r} {g} {b} 0\n"
        for k, ((x, y, z), (r, g, b)) in enumerate(zip(centres.tolist(), colours.tolist()), 1)
    ]
    write_whole(model / "points3D.txt", "# POINT3D_ID X Y Z R G B ERROR TRACK\n" + "".join(rows))


def nerfstudio(run: Run, target: Path, options: ExportOptions) -> None:
    """transforms.json beside the images: camera-to-world poses with OpenGL's camera axes, as nerfstudio reads them."""
    from panobench.cameras.calibration.nerfstudio import camera_values

    document, shots = camera_values(model_camera(run, options)), shots_of(run, options)
    if options.images:
        write_pictures(run, shots, target, options)
    document["frames"] = [
        {"file_path": f"images/{shot.name}", "transform_matrix": (shot.T_wc @ OPENGL).tolist()} for shot in shots
    ]
    if len(opaque_points(run)[0]):
        ply_points(run, target / "points.ply", options)
        document["ply_file_path"] = "points.ply"
    write_whole(target / "transforms.json", json.dumps(document, indent=1) + "\n")
