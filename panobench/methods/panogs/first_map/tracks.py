"""What feature tracks of the first frames tell of the camera: its readout, and how large two lenses' distance is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.methods.base import MethodContext
from panobench.methods.panogs.rectification.rolling_shutter import RollingShutter
from panobench.methods.panogs.rectification.seam import Seam
from panobench.types import Frame

Pose = NDArray[np.float64]
#: So many frames are enough.
FRAMES = 20
#: A scale whose standard deviation is larger than this share is no use.
MOST_SIGMA = 0.25


def learn_from_tracks(
    camera: Camera,
    frames: list[Frame],
    T_wc: dict[int, Pose],
    shutter: RollingShutter,
    seam: Seam,
    context: MethodContext,
) -> None:
    """Tell ``shutter`` its readout if it is unknown, and ``seam`` where the lenses are, by ``sparse`` on ``frames``.

    T_wc (4, 4): poses of some of the frames in the map's unit, by index.
    """
    from panobench.methods.sparse.config import SparseConfig
    from panobench.methods.sparse.method import SparseMethod

    unknown = shutter.unknown
    config = SparseConfig(
        loops=False,
        keyframe_gap=1,
        readout_ms=None if unknown else 1e3 * shutter.readout_s,
        stitch_mm=1e3 * seam.baseline_m,
        stitch_m=seam.options.distance_m,
    )
    tracks = SparseMethod(config)
    tracks.start(camera, MethodContext(seed=context.seed, log=context.log))
    for frame in frames:
        tracks.track(frame)
    found = tracks.finish()
    if unknown:
        shutter.tell(1e-3 * float(found.extra.get("readout_ms", 0.0)))
    if not seam.stitched:
        return
    sigma = found.extra.get("scale_sigma_percent")
    metres = dict(zip(found.trajectory.times, found.trajectory.T_wc))
    both = [(metres[f.time], T_wc[f.index]) for f in frames if f.time in metres and f.index in T_wc]
    if sigma is None or sigma > 100 * MOST_SIGMA or len(both) < 3:
        context.warn("the camera moved too little to tell how far its two lenses are apart on this scale: seam ignored")
        return
    a, b = (np.stack([pair[k][:3, 3] for pair in both]) for k in (0, 1))
    scale = float(np.linalg.norm(a - a.mean(axis=0)) / max(float(np.linalg.norm(b - b.mean(axis=0))), 1e-12))
    distance = found.extra.get("stitch_m") or 0.0
    seam.place(scale, distance)
    said = f"{distance:.2g} m" if distance else "infinity"
    context.log(f"two lenses: a unit of the map is {scale:.3f} m, give or take {sigma:.1f}%; stitched for {said}")
