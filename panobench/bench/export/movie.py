"""A film of the map along the smoothed path, as a panorama or through a lens."""

from __future__ import annotations

import io
import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.base import ExportOptions, map_of, poses_of
from panobench.errors import UsageError
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run
    from panobench.cameras.base import Camera

RATE = 24
#: Most frames of a film: a minute takes about as long as a run.
MOST = 60 * RATE
#: Widths unless one is given.
PANORAMA, PERSPECTIVE = 1024, 960
#: The path is smoothed over this share of its length.
_SMOOTH = 0.02


def mp4(run: Run, target: Path, options: ExportOptions) -> None:
    """H.264 at 24 frames per second, through the camera of ``options``: "erp" or "pinhole", "pinhole:DEGREES".

    Raises UsageError for another camera or a length that makes no sense.
    """
    import av

    from panobench.splat.render import Renderer

    gaussians = map_of(run)
    count = round(RATE * options.seconds) if math.isfinite(options.seconds) else 0
    if not 1 <= count <= MOST:
        raise UsageError(f"--seconds {options.seconds:g}: a film is at most {MOST // RATE} seconds long")
    camera = _camera(options)
    renderer = Renderer(camera, "pinhole" if camera.kind == "pinhole" else "sphere")
    content = io.BytesIO()
    with av.open(content, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=RATE, options={"crf": "19", "preset": "medium"})
        stream.width, stream.height, stream.pix_fmt = camera.width, camera.height, "yuv420p"
        for pose in flight(poses_of(run).T_wc, count):
            colour = np.clip(np.nan_to_num(renderer.forward(gaussians, pose).colour), 0.0, 1.0)
            picture = np.ascontiguousarray(np.rint(255.0 * colour).astype(np.uint8))
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))
    write_whole(target, content.getvalue())


def _camera(options: ExportOptions) -> Camera:
    from panobench.cameras.erp import ErpCamera
    from panobench.cameras.pinhole import PinholeCamera

    kind = options.camera.partition(":")[0]
    if kind not in ("erp", "pinhole"):
        raise UsageError(f"--camera {options.camera}: a film is erp, or pinhole as in pinhole:90")
    if kind == "erp":
        width = (options.width or PANORAMA) // 4 * 4  # the codec wants even sides
        return ErpCamera(width, width // 2)
    width = max(32, (options.width or PERSPECTIVE) // 32 * 32)  # so that the height is even, too
    degrees = options.camera.partition(":")[2] or "90"
    try:
        field = float(degrees)
    except ValueError:
        field = 0.0
    if not 10 <= field <= 150:
        raise UsageError(f"--camera {options.camera}: give 10 to 150 degrees, as in pinhole:90")
    vertical = math.degrees(2 * math.atan(math.tan(math.radians(field / 2)) * 9 / 16))
    return PinholeCamera.from_fov(width, field, vertical)


def flight(T_wc: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """``count`` poses (count, 4, 4) along the path at constant speed, position and direction smoothed.

    Where the camera only turned, or stood, time takes the place of distance.
    """
    from scipy.ndimage import gaussian_filter1d
    from scipy.spatial.transform import Rotation, Slerp

    if len(T_wc) == 1:
        return np.repeat(T_wc, count, axis=0)
    steps = np.linalg.norm(np.diff(T_wc[:, :3, 3], axis=0), axis=1)
    length = float(steps.sum())
    steps = steps + 0.05 * (length / len(steps) if length > 0 else 1.0)  # poses at one place stay apart
    along = np.concatenate([[0.0], np.cumsum(steps)])
    at = np.linspace(0.0, along[-1], count)
    out = np.tile(np.eye(4), (count, 1, 1))
    width = max(_SMOOTH * count, 1e-3)
    positions = np.stack([np.interp(at, along, T_wc[:, k, 3]) for k in range(3)], axis=1)
    out[:, :3, 3] = gaussian_filter1d(positions, width, axis=0, mode="nearest")
    quats = Slerp(along, Rotation.from_matrix(T_wc[:, :3, :3]))(at).as_quat()
    flips = np.cumprod(np.where((quats[1:] * quats[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    quats[1:] *= flips[:, None]
    quats = gaussian_filter1d(quats, width, axis=0, mode="nearest")
    out[:, :3, :3] = Rotation.from_quat(quats).as_matrix()
    return out
