"""When a frame becomes a keyframe, and which keyframes stay in the window (MonoGS's rules).

Matsuki et al., "Gaussian Splatting SLAM" (CVPR 2024), section 3.3 and supplementary: co-visibility is measured on the
sets of Gaussians two keyframes see, distances in units of the median scene depth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.views import View

Visible = NDArray[np.bool_]


def overlap(a: Visible, b: Visible, over: str = "union") -> float:
    """|A and B| over |A or B| ("union") or over the smaller set ("smaller"); sets may differ in length (map grew)."""
    n = min(len(a), len(b))
    both = np.count_nonzero(a[:n] & b[:n])
    na, nb = np.count_nonzero(a[:n]), np.count_nonzero(b[:n])
    total = na + nb - both if over == "union" else min(na, nb)
    return both / total if total else 0.0


def is_keyframe(
    config: PanogsConfig,
    visible: Visible,
    last_visible: Visible,
    distance_rel: float,
    frames_since: int,
    window_full: bool,
    new_share: float = 0.0,
) -> bool:
    """The rule of section 5 of docs/panogs.md. ``distance_rel``: translation from the last keyframe / median depth.

    Not MonoGS's: a frame of which ``new_share`` is unknown to the map, or drawn wrong, is a keyframe at once.
    """
    if new_share > config.keyframe_new and frames_since >= config.keyframe_new_interval:
        return True
    common = overlap(visible, last_visible)
    if not window_full:
        return (
            frames_since >= config.keyframe_interval and common < config.keyframe_overlap
        ) or distance_rel > config.keyframe_max_rel
    far = distance_rel > config.keyframe_max_rel
    return far or (common < config.keyframe_overlap and distance_rel > config.keyframe_min_rel)


def update_window(window: list[View], newest: View, size: int) -> list[View]:
    """Add ``newest`` (window order: newest first) and drop at most one view.

    The newest two are protected. First candidate: the oldest whose overlap with the newest is at most 0.3; else, if
    there are more than ``size``, the one that is far from the newest and close to the others.
    """
    window = [newest, *window]
    assert newest.touched is not None
    new_visible = newest.touched > 0
    for view in reversed(window[2:]):
        if view.touched is not None and overlap(view.touched > 0, new_visible, "smaller") <= 0.3:
            return [w for w in window if w is not view]
    if len(window) <= size:
        return window
    old = window[2:]
    positions = np.array([v.position for v in old])
    to_newest = np.linalg.norm(positions - newest.position, axis=1)
    between = np.linalg.norm(positions[:, None] - positions[None], axis=-1)
    inverse = 1.0 / (between + 1e-6)
    np.fill_diagonal(inverse, 0.0)
    drop = old[int(np.argmax(np.sqrt(to_newest) * inverse.sum(axis=1)))]
    return [w for w in window if w is not drop]
