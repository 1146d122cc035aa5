"""When a frame becomes a keyframe (MonoGS's rule, and one more).

Matsuki et al., "Gaussian Splatting SLAM" (CVPR 2024), section 3.3 and supplementary.
"""

from __future__ import annotations

from panobench.methods.panogs.config import KeyframeOptions


def is_keyframe(
    options: KeyframeOptions,
    overlap: float,
    distance: float,
    frames_since: int,
    window_full: bool,
    new_share: float = 0.0,
) -> bool:
    """The rule of section 5 of docs/panogs.md.

    overlap: co-visibility with the last keyframe, 0..1. distance: from the last keyframe, in median depths. new_share:
    share of the frame that the map does not know or draws wrong; a frame with much of it is a keyframe at once, which
    is not MonoGS's.
    """
    if new_share > options.new_share and frames_since >= options.new_interval:
        return True
    seen_little = overlap < options.overlap
    if distance > options.distance_max:
        return True
    if not window_full:
        return seen_little and frames_since >= options.interval
    return seen_little and distance > options.distance_min
