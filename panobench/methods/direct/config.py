"""Options of the ``direct`` method."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DirectConfig:
    """Lengths are relative to the median scene depth; intensities are grey levels of 255.

    points:             points in the window's bundle adjustment.
    candidates:         pixels chosen per keyframe that are traced until they have a depth.
    face_pixels:        most pixels all tangent faces together may have; larger images are reduced to it.
    window:             keyframes in the bundle adjustment; older ones leave it with their points.
    held:               of these the oldest, whose poses are kept: they hold position and scale.
    iterations:         of the bundle adjustment per keyframe.
    huber:              residual where the loss turns linear.
    outlier:            root mean square residual of a pattern that is no longer used.
    gradient_softening: gradients beyond this count less (they magnify errors of the geometry).
    keyframe_distance:  new keyframe after moving this share of the median depth.
    keyframe_overlap:   new keyframe when less than this share of the points is still in view.
    lost_residual:      root mean square residual at which a frame counts as lost.
    """

    points: int = 1500
    candidates: int = 600
    face_pixels: int = 700_000
    window: int = 8
    held: int = 2
    iterations: int = 6
    huber: float = 9.0
    outlier: float = 20.0
    gradient_softening: float = 50.0
    keyframe_distance: float = 0.06
    keyframe_overlap: float = 0.8
    lost_residual: float = 25.0
