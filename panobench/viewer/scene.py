"""What the Rerun viewer shows in space: paths, the camera's frustum, and the map as ellipsoids."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.splat.gaussians import GaussianMap
from panobench.viewer.pictures import bytes_of

Array = NDArray[np.float64]

#: Most Gaussians of a finished map: the viewer draws each as a mesh of its own.
MAX_ELLIPSOIDS = 40_000


def log_map(
    stream: Any, gaussians: GaussianMap, name: str = "world/map", most: int = MAX_ELLIPSOIDS, *, static: bool = True
) -> None:
    """The opaque Gaussians as solid ellipsoids of one standard deviation; the largest where there are too many."""
    opacity = 1.0 / (1.0 + np.exp(-gaussians.opacity_logits.astype(np.float64)))
    scales = np.exp(gaussians.log_scales.astype(np.float64))
    usable = (opacity > 0.5) & np.isfinite(gaussians.means).all(axis=1) & np.isfinite(scales).all(axis=1)
    size = np.where(usable, scales.max(axis=1), -1.0)
    chosen = np.sort(np.argsort(-size)[: min(most, int(usable.sum()))])
    q = gaussians.quats[chosen].astype(np.float64)
    q /= np.maximum(np.linalg.norm(q, axis=1, keepdims=True), 1e-12)
    stream.log(
        name,
        rr.Ellipsoids3D(
            centers=gaussians.means[chosen],
            half_sizes=scales[chosen],
            quaternions=q[:, [1, 2, 3, 0]],
            colors=bytes_of(gaussians.colours[chosen]),
            fill_mode=rr.components.FillMode.Solid,
        ),
        static=static,
    )


def log_poses(stream: Any, T_wc: Array, name: str, colour: tuple[int, int, int]) -> None:
    """A whole path (N, 4, 4) as a line."""
    if len(T_wc):
        stream.log(f"world/{name}", rr.LineStrips3D([T_wc[:, :3, 3]], colors=colour), static=True)


def log_camera(stream: Any, T_wc: Array, camera: Camera | None) -> None:
    """Where the camera is; a perspective one with its frustum, a panorama with its axes."""
    stream.log("world/camera", rr.Transform3D(translation=T_wc[:3, 3], mat3x3=T_wc[:3, :3]))
    if camera is not None and camera.kind == "pinhole":
        about = camera.to_dict()
        stream.log(
            "world/camera",
            rr.Pinhole(
                focal_length=(about["fx"], about["fy"]),
                principal_point=(about["cx"], about["cy"]),
                width=camera.width,
                height=camera.height,
                camera_xyz=rr.ViewCoordinates.RDF,
                image_plane_distance=0.3,
            ),
        )
    else:
        axes = 0.15 * np.eye(3)
        stream.log(
            "world/camera/axes",
            rr.Arrows3D(origins=np.zeros((3, 3)), vectors=axes, colors=[(220, 60, 60), (60, 180, 60), (70, 110, 255)]),
        )
