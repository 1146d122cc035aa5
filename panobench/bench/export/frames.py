"""The frames of a model: as the run's camera took them, or a panorama as the six faces of a cube."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.base import ExportOptions, poses_of
from panobench.bench.run.request import RunRequest, run_options
from panobench.errors import InputError, PanobenchError, UsageError
from panobench.geometry import quaternion_from_matrix
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run
    from panobench.bench.run.views import ChosenFrames
    from panobench.cameras.base import Camera

Array = NDArray[np.float64]
#: Faces in the order they are written; the first is the rig's reference.
FACES = ("front", "right", "back", "left", "up", "down")


@dataclass(frozen=True)
class Shot:
    """One picture of a model: its name below images/, its pose (4, 4) camera-to-world, and its frame's index.

    face: index into ``FACES``, None for a whole frame.
    """

    name: str
    T_wc: Array
    frame: int
    face: int | None = None


def model_camera(run: Run, options: ExportOptions) -> Camera:
    """The camera of the pictures: the run's, or that of a face. Raises UsageError for faces of what is no panorama."""
    if not options.faces:
        return run.camera
    from panobench.cameras.pinhole import PinholeCamera

    if run.camera.kind != "erp":
        raise UsageError(
            f"--faces is for panoramas; the frames of {run.folder} were taken by a {run.camera.kind} camera"
        )
    # as fine in the middle of a face as the panorama is at its horizon
    width = options.width or 2 * round(run.camera.width / (2 * math.pi))
    return PinholeCamera.from_fov(width, 90.0, 90.0)


def shots_of(run: Run, options: ExportOptions) -> list[Shot]:
    """The pictures of all frames that have a pose."""
    trajectory, times = poses_of(run), run.frames.get("time", np.zeros(0))
    order = [int(np.abs(times - t).argmin()) if len(times) else k for k, t in enumerate(trajectory.times)]
    if not options.faces:
        return [Shot(f"{i:06d}.png", T, i) for i, T in zip(order, trajectory.T_wc)]
    shots = []
    for i, T in zip(order, trajectory.T_wc):
        for face, R in enumerate(face_rotations()):
            pose = T.copy()
            pose[:3, :3] = T[:3, :3] @ R.T
            shots.append(Shot(f"{FACES[face]}/{i:06d}.png", pose, i, face))
    return shots


def face_rotations() -> list[Array]:
    """(3, 3) from the panorama's axes into those of each face."""
    from panobench.cameras.views import view_rotation

    return [view_rotation(name) for name in FACES]


def frames_of(run: Run, width: int | None = None) -> ChosenFrames:
    """The frames of the run, read from the data set again, at another width if given.

    Raises InputError where the data set is gone.
    """
    from panobench.bench.run.setup import open_input

    spec = run.record.spec
    request = RunRequest(**{o.name: spec.option(o.name) for o in run_options()})
    try:
        return open_input(request if width is None else replace(request, width=width))
    except PanobenchError as error:
        raise InputError(f"the frames cannot be read again ({error}); --no-images leaves them out") from error


def write_pictures(run: Run, shots: list[Shot], target: Path, options: ExportOptions) -> None:
    """Write the pictures to images/. Raises InputError where the data set is gone."""
    from panobench.datasets.files.images import write_image

    sequence = frames_of(run)
    views = _views(run, options)
    last: tuple[int, NDArray[np.uint8] | None] = (-1, None)
    for shot in shots:
        path = target / "images" / shot.name
        path.parent.mkdir(parents=True, exist_ok=True)
        image = last[1] if shot.frame == last[0] else None
        if image is None:
            image = sequence.image(shot.frame)
            last = (shot.frame, image)
        write_image(path, image if shot.face is None else views[shot.face](image))


def _views(run: Run, options: ExportOptions) -> list[Callable[[NDArray[np.uint8]], NDArray[np.uint8]]]:
    """What makes each face of a panorama; none for whole frames."""
    if not options.faces:
        return []
    from panobench.cameras.reproject import Reprojector

    camera = model_camera(run, options)
    return [Reprojector(run.camera, camera, R).image for R in face_rotations()]


def write_rig(target: Path) -> None:
    """rig_config.json, by which COLMAP's rig_configurator makes one rig of the faces."""
    write_whole(target, json.dumps([{"cameras": list(_rig_cameras())}], indent=1) + "\n")


def _rig_cameras() -> Iterator[dict[str, object]]:
    rotations = face_rotations()
    for name, R in zip(FACES, rotations):
        if name == FACES[0]:
            yield {"image_prefix": f"{name}/", "ref_sensor": True}
        else:
            rotation = [float(v) for v in quaternion_from_matrix(R @ rotations[0].T)]
            yield {
                "image_prefix": f"{name}/",
                "cam_from_rig_rotation": rotation,
                "cam_from_rig_translation": [0.0, 0.0, 0.0],
            }
