"""Depth of a map put right by the frames: planes of the scene, then a plane for each pixel, then what views confirm."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.confirmation import confirmed
from panobench.bench.export.plane_depth import corrected_depths
from panobench.bench.export.plane_matching import matched_depth
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.cameras.erp import ErpCamera

Float = NDArray[np.float32]

#: The planes of the scene are found and aligned at this width.
PLANES_WIDTH = 512
#: Depths agree that differ by less than so many pixels of the frames are wide.
TOLERANCE = 0.8


def depths_by_frames(views: PosedPanoramas, depths: Float) -> Float:
    """Radial depths (K, H, W) of the map at the views' poses, put right by the frames; NaN where these contradict.

    Pixels that no frame shows, and all pixels of a camera that stood still, keep the map's depth.
    """
    small = views
    while small.luma.shape[2] > PLANES_WIDTH and (half := small.halved()) is not None:
        small = half
    height, width = depths.shape[1:]
    rays = ErpCamera(width, height).rays().astype(np.float32)
    start = corrected_depths(small, depths)
    coarse = views.halved()
    made = np.stack([matched_depth(views, coarse, k, start[k], rays) for k in range(len(views))])
    made = confirmed(made, views.T_wc, rays, TOLERANCE * 2 * math.pi / views.scale.camera.width)
    shown = cv2.resize(views.scale.valid.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return np.where(shown, made, depths)
