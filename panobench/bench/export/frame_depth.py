"""Depth of a map put right by the frames: a plane for each pixel, then planes of the scene, then what views confirm."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.confirmation import confirmed
from panobench.bench.export.plane_alignment import align
from panobench.bench.export.plane_matching import far_others, matched_depth, pyramid_of, widest_within
from panobench.bench.export.plane_pieces import solid_pieces
from panobench.bench.export.plane_preference import preferred
from panobench.bench.export.planes import Plane, find_planes
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.cameras.erp import ErpCamera

Float = NDArray[np.float32]

#: The planes of the scene are found and aligned at this width.
PLANES_WIDTH = 512
#: Depths agree that differ by less than so many pixels of the frames are wide, or of the depths where these are wider.
TOLERANCE = 0.8


def depths_by_frames(views: PosedPanoramas, depths: Float, seed: int = 0) -> Float:
    """Radial depths (K, H, W) of the map at the views' poses, put right by the frames; NaN where these contradict.

    Pixels that no frame shows, and all pixels of a camera that stood still, keep the map's depth.
    """
    height, width = depths.shape[1:]
    rays = ErpCamera(width, height).rays().astype(np.float32)
    levels = pyramid_of(views)
    made = np.stack([matched_depth(levels, k, rays) if far_others(views, k) else d for k, d in enumerate(depths)])
    tolerance = TOLERANCE * 2 * math.pi / min(views.scale.camera.width, width)
    sure = confirmed(made, views.T_wc, rays, tolerance)
    whole = widest_within(levels, width)
    flat = _on_planes(whole, views, made, sure, rays, np.random.default_rng(seed))
    stays = np.isfinite(sure) & (np.abs(flat / made - 1) < tolerance)
    made = np.where(stays, flat, confirmed(flat, views.T_wc, rays, tolerance))
    shown = cv2.resize(views.scale.valid.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST) > 0
    return np.where(shown, made, depths)


def _on_planes(
    views: PosedPanoramas,
    finer: PosedPanoramas,
    depths: Float,
    sure: Float,
    rays: Float,
    generator: np.random.Generator,
) -> Float:
    """The depths (K, H, W), moved onto planes of the scene where these are preferred; sure: NaN where not confirmed.

    finer: the same views, at the size at which they are compared.
    """
    matched = replace(views, depth=_resized(depths, views))
    found = [
        solid_pieces(plane, sure[:, ::2, ::2], views.T_wc, rays[::2, ::2], views.median_depth)
        for plane in scene_planes(matched, generator)
    ]
    made, small, size = depths.copy(), views.depth.shape[:0:-1], rays.shape[1::-1]
    for k, T in enumerate(views.T_wc):
        stays = cv2.resize(np.isfinite(sure[k]).astype(np.uint8), small, interpolation=cv2.INTER_NEAREST) > 0
        number = cv2.resize(preferred(matched, k, stays, found, finer), size, interpolation=cv2.INTER_NEAREST)
        world = rays @ T[:3, :3].T
        for j, pieces in enumerate(found):
            on_it = number == j
            made[k][on_it] = pieces.plane.depth(world[on_it], T[:3, 3])
    return made


def scene_planes(views: PosedPanoramas, generator: np.random.Generator) -> list[Plane]:
    """The large planes of the views' depth, where the frames agree on them."""
    while views.luma.shape[2] > PLANES_WIDTH and (half := views.halved()) is not None:
        views = half
    return [align(plane, views, generator) or plane for plane in find_planes(views, generator)]


def _resized(depths: Float, views: PosedPanoramas) -> Float:
    """Depths (K, h, w) of the size of the views' frames, their own where unknown."""
    size = views.depth.shape[:0:-1]
    small = np.stack([cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST) for depth in depths])
    return np.where(np.isfinite(small), small, views.depth)
