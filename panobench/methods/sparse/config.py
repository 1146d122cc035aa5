"""Options of the ``sparse`` method."""

from __future__ import annotations

from dataclasses import dataclass

from panobench.options import Options, option


@dataclass(frozen=True)
class SparseConfig(Options):
    """Features, keyframes and map. A depth is the median scene depth; px are pixels of a tangent face, but of the image
    where faces are finer than it is (with a rig or an IMU).
    """

    features: int = option(700, "corners wanted per keyframe, shared over the faces", above=0)
    face_pixels: int = option(
        1_000_000, "most pixels of all tangent faces together; larger images are reduced", unit="px", above=0
    )
    levels: int = option(0, "pyramid levels of the patch alignment; 0: by the resolution")
    huber_px: float = option(0.2, "residual from which the Huber loss is linear", unit="px", above=0)
    min_zncc: float = option(0.75, "least correlation of an aligned patch with its template", minimum=-1, maximum=1)
    init_parallax: float = option(
        1.5, "median parallax of the tracks, rotation removed, before two views are tried", unit="deg"
    )
    min_parallax: float = option(0.8, "angle between two rays before a point is triangulated", unit="deg")
    keyframe_distance: float = option(0.06, "translation after which a frame becomes a keyframe", unit="depths")
    keyframe_ratio: float = option(
        0.75, "a frame becomes a keyframe when fewer than this share of the last keyframe's points are left"
    )
    keyframe_gap: int = option(
        20, "a frame becomes a keyframe after this many if the camera moves at all", unit="frames"
    )
    window: int = option(8, "keyframes refined by the local bundle adjustment", above=0)
    min_inliers: int = option(20, "with fewer inliers than this the frame is lost", above=0)
    loops: bool = option(True, "look for loop closures")
    rig: bool = option(True, "see through each lens of a rig from its own centre; off: through the stitched panorama")
    restart_after: int = option(
        20, "lost frames in a row after which a new map begins; the longest map is the answer", unit="frames"
    )
    refit: bool = option(True, "solve every frame's pose again at the end, against the refined points")
    final_ba: int = option(10, "iterations of bundle adjustment over all keyframes at the end; 0: none")
    readout_ms: float | None = option(
        0.0, "time from the first row of a lens to its last; 0: global shutter; none: estimated", unit="ms"
    )
    stitch_mm: float = option(
        0.0, "distance between the two lenses back to back that a panorama is stitched from; 0: one centre", unit="mm"
    )
    stitch_m: float | None = option(
        None, "distance of what is stitched without a seam; 0: infinite; none: the scene's", unit="m"
    )
