"""Depth of each panorama of a path by the others: PatchMatch from a small size to the whole.

It starts at the depth at hand. Views far apart are compared, because the depth of a wall is known no better than their
parallax allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.patchmatch import propagate, try_planes, window
from panobench.bench.export.planes import normals_of
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.geometry import invert_pose
from panobench.photometric.planar import depth_information, planar_filter
from panobench.photometric.sweep import padded

Float = NDArray[np.float32]

#: Views that one is compared with, and their distances from it over the scene's median depth.
OTHERS, NEAREST, FARTHEST = 10, 0.15, 1.0
#: The part of the others with the least differences counts: the rest may be hidden.
VISIBLE = 0.4
#: Pixels between the samples of a window: wider ones straddle the edges of small things.
SPACING = 1
#: Differences of luma (of 1) are cut here, and a sample weighs less the more its luma differs from the middle's.
TRUNCATION, SIGMA = 0.03, 0.1
#: A better plane must save so much, so that nothing moves where nothing has texture; closer than ``SAME``, planes are
#: one.
SAVED, SAME = 3e-5, 1e-3
#: Of the filter at the end (``planar_filter``): pixels around each, differences of luma (of 1) and of log depth.
RADIUS, SMOOTH_LUMA, SMOOTH_DEPTH, FLOOR = 6, 0.03, 0.008, 0.01
#: Views wider than this are matched at half their size first, and these as well.
SMALLEST = 512
#: Depths tried, over the median depth.
LIMITS = (0.05, 20.0)


@dataclass(frozen=True)
class Pass:
    """Of both colours of the chessboard: neighbours (4 or 8) and random changes that each pixel tries; the largest of
    log depth and of the normal.
    """

    neighbours: int
    tries: int
    depth: float
    normal: float


COARSE = (Pass(8, 4, 0.1, 0.4), Pass(8, 4, 0.05, 0.2))
FINE = (Pass(8, 3, 0.02, 0.2), Pass(4, 3, 0.005, 0.1))


class PlaneField:
    """A plane for each pixel of view ``k``, the best of those offered and found.

    finer: the same views several times as wide, in which windows are compared in their place.
    """

    def __init__(
        self,
        views: PosedPanoramas,
        k: int,
        others: list[int],
        seed: int = 0,
        spacing: int = SPACING,
        finer: PosedPanoramas | None = None,
    ) -> None:
        T = np.stack([invert_pose(views.T_wc[j]) @ views.T_wc[k] for j in others]).astype(np.float32)
        compared = finer or views
        self.planes = np.full((*views.depth.shape[1:], 3), np.nan, np.float32)
        self.cost = np.full(views.depth.shape[1:], np.inf, np.float32)
        self._views, self._k, self._others, self._seed = views, k, others, seed
        self._view = (
            compared.luma[k], compared.scale.rays, padded(compared.luma[others], wrap=True),
            np.ascontiguousarray(T[:, :3, :3]), np.ascontiguousarray(T[:, :3, 3]),
            max(1, round(VISIBLE * len(others))), window(spacing),
            np.array([TRUNCATION, 1 / SIGMA, SAVED, SAME], np.float32),
        )  # fmt: skip
        self._limits = np.array(LIMITS, np.float32) * np.float32(views.median_depth)

    def offer(self, planes: Float) -> None:
        """Planes (H, W, 3), NaN for none: those that frames agree better on are taken."""
        try_planes(np.ascontiguousarray(planes, np.float32), *self._view, self.planes, self.cost)

    def offer_depth(self, depth: Float) -> None:
        """The same for a depth (H, W), along its surface."""
        rays = self._views.scale.rays
        normal = normals_of(depth, rays)
        slope = (normal * rays).sum(axis=-1)
        with np.errstate(divide="ignore"):
            self.offer(np.where((np.abs(slope) > 0.1)[..., None], normal / (depth * slope)[..., None], np.nan))

    def improve(self, passes: tuple[Pass, ...]) -> None:
        """Propagate planes and change them."""
        for one in passes:
            changes = np.array([one.depth, one.normal], np.float32)
            for colour in (0, 1):
                self._seed += 1
                propagate(
                    *self._view, self._limits, one.neighbours, one.tries, changes, colour, self._seed,
                    self.planes.copy(), self.planes, self.cost,
                )  # fmt: skip

    def smooth(self) -> None:
        """Move the planes to the depth of their neighbours, where that is known better and nearly the same."""
        luma, scale, (R, t) = self._views.luma, self._views.scale, self._view[3:5]
        depth = self.depth(scale.rays)
        known = np.isfinite(depth)
        depth = np.where(known, depth, np.float32(1))
        information, smooth = np.empty_like(depth), np.empty_like(depth)
        own, others = luma[self._k], luma[self._others]
        depth_information(own, depth, scale.rays, others, R, t, scale.code, scale.cam, information)
        information = np.where(known, information, 0).astype(np.float32)
        floor = FLOOR * float(np.median(information[known])) if known.any() else 0.0
        planar_filter(
            depth,
            information,
            np.nan_to_num(own),
            scale.rays,
            RADIUS,
            1,
            SMOOTH_LUMA,
            SMOOTH_DEPTH,
            floor,
            True,
            smooth,
        )
        self.planes *= (depth / smooth)[..., None]

    def depth(self, rays: Float) -> Float:
        """Radial depth (h, w) along the unit rays (h, w, 3) of a panorama of any size, NaN where there is no plane."""
        planes = cv2.resize(self.planes, rays.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        with np.errstate(divide="ignore"):
            depth = 1 / (planes * rays).sum(axis=-1)
        return np.where(np.isfinite(depth) & (depth > 0), depth, np.nan).astype(np.float32)


def matched_depth(levels: list[PosedPanoramas], k: int, rays: Float, seed: int = 0) -> Float:
    """Radial depth (h, w) of view ``k`` along the unit rays (h, w, 3) of a panorama, NaN where no frame says anything.

    It begins at the depth of the views. levels: of ``pyramid_of``; those larger than the depth are compared, but
    have no more planes than it has pixels.
    """
    others = far_others(levels[-1], k)
    whole = widest_within(levels, rays.shape[1])
    field: PlaneField | None = None
    for views in levels:
        at = min(views, whole, key=lambda size: size.luma.shape[2])
        coarser, field = field, PlaneField(at, k, others, seed, finer=views)
        if coarser is None:
            field.offer(at.scale.rays / at.depth[k][..., None])
        else:
            planes = cv2.resize(coarser.planes, field.cost.shape[::-1], interpolation=cv2.INTER_NEAREST)
            field.offer(np.asarray(planes, np.float32))
        field.offer_depth(at.depth[k])
        field.improve(COARSE if coarser is None else FINE)
    assert field is not None
    if len(levels) == 1:
        field.improve(FINE)
    field.smooth()
    return field.depth(rays)


def widest_within(levels: list[PosedPanoramas], width: int) -> PosedPanoramas:
    """The largest of the sizes of ``pyramid_of`` that is at most ``width`` wide, or the smallest."""
    return next((views for views in reversed(levels) if views.luma.shape[2] <= width), levels[0])


def pyramid_of(views: PosedPanoramas) -> list[PosedPanoramas]:
    """The views at the sizes at which they are matched, the smallest first: at least two, if they can be halved."""
    levels = [views]
    while (len(levels) == 1 or levels[0].luma.shape[2] > SMALLEST) and (half := levels[0].halved()) is not None:
        levels.insert(0, half)
    return levels


def far_others(views: PosedPanoramas, k: int) -> list[int]:
    """Views to compare view ``k`` with: far apart if there are enough, else as the sweep takes them."""
    found = views.others(k, OTHERS, NEAREST, FARTHEST)
    return found if len(found) >= 3 else views.others(k, OTHERS)
