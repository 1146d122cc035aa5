"""Options of the ``monogs`` method: the published values of MonoGS's monocular setting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal


@dataclass(frozen=True)
class MonogsConfig:
    """Iterations are gradient steps; a mapping step sums the whole window and ``random_views`` older keyframes.

    window_views:      keyframes of the window in one mapping step (fewer than the window: a random choice).
    refined_poses:     newest keyframes whose poses are refined while mapping.
    *_share:           one in how many pixels becomes a Gaussian, in the first and in later keyframes.
    point_size:        of a new Gaussian: variance over the mean squared distance to its neighbours and the depth.
    extent:            of the scene, in units where the first depth is 2; scales the position rate and sizes.
    update_every, update_offset: mapping steps between rounds of cloning, splitting and pruning, and the first one.
    fade_every:        mapping steps between two rounds that lower the opacities of what is not in view.
    pull:              mean gradient across the image above which a Gaussian is cloned or split, for images of 480 rows
                       (a Gaussian of one pixel is pulled in proportion to 1 / rows, the loss being a mean).
    prune_opacity, prune_pixels: Gaussians fainter, or with a larger radius in the image, are dropped in such a round.
    final_iterations:  steps on random keyframes at the end ("colour refinement"; the paper's evaluation does 26,000).
    """

    projection: Literal["pinhole", "sphere"] = "pinhole"
    low_pass: float = 0.3
    # Tracking
    tracking_iterations: int = 100
    rotation_rate: float = 0.003
    translation_rate: float = 0.001
    exposure_rate: float = 0.01
    converged: float = 1e-4
    edge_threshold: float = 1.1
    black_threshold: float = 0.01
    # Keyframes
    window: int = 8
    keyframe_interval: int = 5
    keyframe_overlap: float = 0.9
    keyframe_min_rel: float = 0.05
    keyframe_max_rel: float = 0.08
    # Gaussians
    first_depth: float = 2.0
    first_depth_noise: float = 0.3
    first_share: int = 32
    later_share: int = 64
    point_size: float = 0.01
    initial_opacity: float = 0.5
    extent: float = 6.0
    # Mapping
    initial_iterations: int = 1050
    initial_update: int = 100
    initial_fade: int = 500
    mapping_iterations: int = 150
    window_views: int = 8
    random_views: int = 2
    refined_poses: int = 3
    update_every: int = 150
    update_offset: int = 50
    fade_every: int = 2001
    prune_opacity: float = 0.7
    prune_pixels: float = 20.0
    prune_seen: int = 3
    pull: float = 0.0002
    isotropy: float = 10.0
    position_rate: float = 1.6e-4
    position_rate_end: float = 1.6e-6
    rate_steps: int = 30_000
    colour_rate: float = 2.5e-3
    opacity_rate: float = 0.05
    scale_rate: float = 1e-3
    turn_rate: float = 1e-3
    final_iterations: int = 0


PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"tracking_iterations": 50, "initial_iterations": 350, "mapping_iterations": 60, "window_views": 3,
             "random_views": 1, "update_every": 60, "update_offset": 20},
}  # fmt: skip
