"""Co-visibility of keyframes, and the window of keyframes that are optimised together (MonoGS's rules).

Matsuki et al., "Gaussian Splatting SLAM" (CVPR 2024), section 3.3 and supplementary: co-visibility is measured on the
sets of Gaussians that two keyframes see.
"""

from __future__ import annotations

from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from panobench.methods.splatting.views import SeenGaussians, View

#: A view leaves the window at once when it shares no more of the smaller set with the newest view.
OVERLAP_MIN = 0.3

AnyView = TypeVar("AnyView", bound=View)


def overlap(
    a: SeenGaussians, b: SeenGaussians, ids: NDArray[np.int32], over: Literal["union", "smaller"] = "union"
) -> float:
    """|A and B| over |A or B| ("union") or over the smaller set, of the Gaussians ``ids`` (N,) that are still there.

    Gaussians that came after either of the views was made do not count.
    """
    common = ids[ids < min(len(a.seen), len(b.seen))]
    in_a, in_b = a.seen[common], b.seen[common]
    both = np.count_nonzero(in_a & in_b)
    count_a, count_b = np.count_nonzero(in_a), np.count_nonzero(in_b)
    total = count_a + count_b - both if over == "union" else min(count_a, count_b)
    return both / total if total else 0.0


def update_window(
    window: list[AnyView], newest: AnyView, size: int, ids: NDArray[np.int32], overlap_min: float = OVERLAP_MIN
) -> list[AnyView]:
    """Put ``newest`` in front of the window (newest first) and drop at most one view. ids (N,): of the map's Gaussians.

    The newest two are never dropped. The first candidate is the oldest view whose overlap with the newest is at most
    ``overlap_min``; else, if there are more than ``size`` views, the one that is far from the newest and close to the
    others.
    """
    window = [newest, *window]
    assert newest.seen is not None
    for view in reversed(window[2:]):
        if view.seen is not None and overlap(view.seen, newest.seen, ids, "smaller") <= overlap_min:
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
