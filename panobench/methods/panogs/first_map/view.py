"""What of the first depth is known well enough for the first map, where a mask hides part of a wide view.

What carries the camera hides another part of the scene in every frame. A direction of the first frame that it soon
covers is found in few of the others, all of them near, and nearly any depth suits those: of what less than half of the
frames saw, a half to nine tenths was wrong in simulated recordings. Such directions get no Gaussians; later frames see
what is there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.photometric.overlap import ViewWidth
from panobench.types import DepthEstimate, Frame

#: Share of the frames that must see a direction.
SEEN_MIN = 0.5
#: Fewest frames besides the first that can tell.
FEWEST = 2


def well_seen(camera: Camera, estimate: DepthEstimate, frames: Sequence[Frame]) -> NDArray[np.bool_] | None:
    """(H, W): directions of the first frame whose depth is known; None where all of them are to be used.

    frames: with their masks; those that ``estimate`` has poses of count.
    """
    others = [f for f in frames if f.index in estimate.T_wc and f.index != estimate.frame_index]
    valid = camera.valid_mask()
    hidden = any(f.mask is not None for f in others) or (camera.with_mask(None).valid_mask() & ~valid).any()
    if not hidden or len(others) < FEWEST or ViewWidth.of(camera) is not ViewWidth.WIDE:
        return None
    known = valid & np.isfinite(estimate.depth)
    points = camera.rays()[known] * estimate.depth[known][:, None]
    count = np.zeros(len(points))
    for frame in others:
        T = invert_pose(estimate.T_wc[frame.index])
        pixels, inside = camera.project(points @ T[:3, :3].T + T[:3, 3])
        x, y = np.floor(np.nan_to_num(pixels)).astype(np.intp).T
        x, y = np.clip(x, 0, camera.width - 1), np.clip(y, 0, camera.height - 1)
        visible = valid if frame.mask is None else valid & frame.mask
        count += inside & visible[y, x]
    seen = np.zeros_like(valid)
    seen[known] = count >= SEEN_MIN * len(others)
    return seen
