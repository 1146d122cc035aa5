"""Options of the ``sparse`` method."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SparseConfig:
    """Lengths are relative to the median scene depth, angles in degrees, "px" are pixels of a tangent face.

    features:           corners wanted per keyframe, shared over the faces.
    face_pixels:        most pixels all tangent faces together may have; larger images are reduced to it.
    levels:             pyramid levels of the patch alignment (0: by the resolution).
    huber_px:           where the residual's loss turns linear.
    min_zncc:           least correlation of an aligned patch with its template.
    init_parallax:      median angle the tracks must show, rotation removed, before two views are tried.
    min_parallax:       angle between two rays before a point is triangulated.
    keyframe_distance:  new keyframe after moving this share of the median depth.
    keyframe_ratio:     new keyframe when fewer than this share of the last keyframe's points are left.
    keyframe_gap:       new keyframe at least after this many frames, if the camera moves at all.
    window:             keyframes refined by the local bundle adjustment.
    min_inliers:        fewer points than this and the frame is lost.
    loops:              look for loop closures.
    restart_after:      a new map is begun after this many lost frames in a row (the longest one is the answer).
    refit:              at the end, solve every frame's pose again against the refined points.
    final_ba:           iterations of bundle adjustment over all keyframes at the end (0: none).
    """

    features: int = 700
    face_pixels: int = 1_000_000
    levels: int = 0
    huber_px: float = 1.0
    min_zncc: float = 0.75
    init_parallax: float = 1.5
    min_parallax: float = 0.8
    keyframe_distance: float = 0.06
    keyframe_ratio: float = 0.75
    keyframe_gap: int = 20
    window: int = 8
    min_inliers: int = 20
    loops: bool = True
    restart_after: int = 20
    refit: bool = True
    final_ba: int = 10
