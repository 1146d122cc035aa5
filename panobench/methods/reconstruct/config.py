"""Options of the ``reconstruct`` method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ReconstructConfig:
    """Lengths named ``_rel`` are in units of the median scene depth; rates are those at the start.

    trajectory:          TUM file with the camera-to-world poses to use ("": the data's ground truth).
    max_time_difference: seconds between a frame and the file's pose that is taken for it.
    views:               most frames the map is fitted to, spread over the sequence.
    seeds:               frames tried as places to start Gaussians at; those that see nothing new add none.
    sweep_views:         frames the depth of a seed is swept over.
    sweep_width:         working width of the sweep, pixels.
    new_share:           of the image that must be unknown before a frame becomes a seed.
    pixels_per_gaussian: pixels of a seed per Gaussian.
    most_per_pixel:      Gaussians at most, over the pixels of one image.
    passes:              gradient steps per frame, in random order.
    decay:               what is left of the rates at the last step.
    densify_every:       passes between two rounds of cloning, splitting and pruning (0: never).
    densify_until:       share of the passes after which there are none.
    pull:                mean gradient across the image above which a Gaussian is cloned or split.
    """

    trajectory: str = ""
    max_time_difference: float = 0.02
    views: int = 300
    seeds: int = 24
    sweep_views: int = 8
    sweep_width: int = 256
    new_share: float = 0.02
    pixels_per_gaussian: float = 4.0
    most_per_pixel: float = 0.5
    passes: int = 15
    decay: float = 0.1
    densify_every: int = 3
    densify_until: float = 0.6
    pull: float = 0.0002
    low_pass: float = 0.1
    flatten: float = 0.15
    scale_factor: float = 0.55
    initial_opacity: float = 0.9
    prune_opacity: float = 0.05
    largest_rel: float = 0.3
    position_rate_rel: float = 1e-3
    scale_rate: float = 0.04
    rotation_rate: float = 0.03
    opacity_rate: float = 0.1
    colour_rate: float = 0.02
    loss_knee: float = 0.05


PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"passes": 5, "seeds": 12, "densify_every": 0},
    "thorough": {"passes": 60, "views": 1000, "decay": 0.02},
}
