"""Options of the ``photoslam`` method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from panobench.methods.sparse.config import SparseConfig


@dataclass(frozen=True)
class PhotoslamConfig:
    """``tracking`` holds the options of ``sparse`` (``--set tracking.features=900``); the rest is the map's.

    depth:               of new Gaussians: "points", from the feature map's points around them, or "sweep", from a
                         plane sweep over the last keyframes.
    pixels_per_gaussian: pixels of a keyframe per Gaussian.
    insert_opacity:      Gaussians are added where the rendered opacity is lower,
    insert_error:        or the colour off by more (0..1, mean of 5x5 pixels).
    levels:              sizes of the image pyramid a new keyframe is learnt on, the smallest first.
    mapping_iterations:  gradient steps per keyframe.
    final_iterations:    gradient steps at the end, on keyframes in random order.
    densify_every:       keyframes between two rounds of cloning, splitting and pruning.
    most_per_pixel:      Gaussians at most, over the pixels of one image.
    """

    tracking: SparseConfig = field(default_factory=SparseConfig)
    depth: Literal["points", "sweep"] = "points"
    pixels_per_gaussian: float = 6.0
    insert_opacity: float = 0.5
    insert_error: float = 0.12
    levels: int = 2
    mapping_iterations: int = 40
    final_iterations: int = 300
    densify_every: int = 5
    most_per_pixel: float = 0.3
    pull: float = 0.0002
    low_pass: float = 0.1
    flatten: float = 0.3
    scale_factor: float = 0.55
    initial_opacity: float = 0.9
    prune_opacity: float = 0.05
    largest_rel: float = 0.3
    position_rate_rel: float = 1e-3
    scale_rate: float = 0.02
    rotation_rate: float = 0.015
    opacity_rate: float = 0.05
    colour_rate: float = 0.01
    loss_knee: float = 0.05


PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"mapping_iterations": 12, "final_iterations": 60, "pixels_per_gaussian": 8.0},
    "sweep": {"depth": "sweep"},
}
