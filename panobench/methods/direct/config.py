"""Options of the ``direct`` method."""

from __future__ import annotations

from dataclasses import dataclass

from panobench.options import Options, option


@dataclass(frozen=True)
class DirectConfig(Options):
    """Points, window and keyframes. A depth is the median scene depth; residuals are grey levels of 255."""

    points: int = option(1500, "active points in the window's bundle adjustment", above=0)
    candidates: int = option(600, "pixels chosen per keyframe, traced until they have a depth")
    face_pixels: int = option(
        700_000, "most pixels of all tangent faces together; larger images are reduced", unit="px", above=0
    )
    window: int = option(8, "keyframes in the bundle adjustment; older ones leave it with their points", above=0)
    held: int = option(2, "oldest keyframes of the window whose poses are fixed: they hold position and scale")
    iterations: int = option(6, "iterations of the bundle adjustment per keyframe")
    huber: float = option(9.0, "residual from which the Huber loss is linear", unit="grey levels", above=0)
    outlier: float = option(20.0, "RMS residual of a pattern from which it is an outlier", unit="grey levels", above=0)
    gradient_softening: float = option(
        50.0,
        "gradients beyond this are down-weighted, as they magnify errors of the geometry",
        unit="grey levels",
        above=0,
    )
    keyframe_distance: float = option(0.06, "translation after which a frame becomes a keyframe", unit="depths")
    keyframe_overlap: float = option(
        0.8, "a frame becomes a keyframe when less than this share of the points is still in view"
    )
    lost_residual: float = option(25.0, "RMS residual from which a frame is lost", unit="grey levels", above=0)
