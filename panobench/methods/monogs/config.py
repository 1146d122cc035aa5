"""Options of the ``monogs`` method: the published values of MonoGS's monocular setting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from panobench.options import Options, option


@dataclass(frozen=True)
class RenderingOptions(Options):
    """Rendering."""

    projection: Literal["pinhole", "sphere"] = option("pinhole", "how Gaussians are projected while mapping")
    low_pass: float = option(0.3, "variance added to every projected Gaussian", unit="px²")


@dataclass(frozen=True)
class TrackingOptions(Options):
    """Tracking: Adam on the pose of each frame."""

    tracking_iterations: int = option(100, "most steps per frame", above=0)
    rotation_rate: float = option(0.003, "learning rate of the rotation", unit="rad")
    translation_rate: float = option(0.001, "learning rate of the translation", unit="world units")
    exposure_rate: float = option(0.01, "learning rate of gain and offset")
    converged: float = option(1e-4, "length of a pose step below which tracking ends")
    edge_threshold: float = option(1.1, "only pixels steeper than this many median gradients are tracked")
    black_threshold: float = option(0.01, "pixels whose summed colour (0 to 3) is darker show nothing")


@dataclass(frozen=True)
class KeyframeOptions(Options):
    """Keyframes."""

    window: int = option(8, "keyframes that are mapped jointly", above=0)
    keyframe_interval: int = option(
        5, "frames between two keyframes until the window is full for the first time", unit="frames"
    )
    window_overlap_start: float = option(
        0.4, "overlap with the newest keyframe at which one leaves the window, until the window is full once"
    )
    window_overlap: float = option(0.3, "the same afterwards")
    keyframe_overlap: float = option(0.9, "share of common Gaussians below which a moved frame becomes a keyframe")
    keyframe_min_rel: float = option(0.05, "translation that a keyframe of low overlap needs", unit="depths")
    keyframe_max_rel: float = option(0.08, "translation after which every frame becomes a keyframe", unit="depths")


@dataclass(frozen=True)
class GaussianOptions(Options):
    """New Gaussians."""

    first_depth: float = option(2.0, "depth of the first keyframe", unit="world units", above=0)
    first_depth_noise: float = option(0.3, "standard deviation of the first depth", unit="world units")
    first_share: int = option(32, "one in this many pixels of the first keyframe becomes a Gaussian", above=0)
    later_share: int = option(64, "one in this many pixels of a later keyframe becomes a Gaussian", above=0)
    point_size: float = option(
        0.01, "variance of a new Gaussian over its mean squared distance to its neighbours and the depth", above=0
    )
    initial_opacity: float = option(0.5, "opacity of a new Gaussian", above=0, below=1)
    extent: float = option(
        6.0,
        "of the scene, where the first depth is 2; scales the rates of positions and sizes, and the sizes allowed",
        above=0,
    )


@dataclass(frozen=True)
class MappingOptions(Options):
    """Mapping: one step sums the window and some older keyframes."""

    initial_iterations: int = option(1050, "steps on the first keyframe")
    initial_update: int = option(100, "steps between two rounds of densification and pruning at the start", above=0)
    initial_fade: int = option(500, "step at the start at which all opacities are lowered once")
    mapping_iterations: int = option(150, "steps per keyframe")
    joint_iterations: int = option(300, "steps on the keyframe that fills the window for the first time")
    window_views: int = option(
        8, "keyframes of the window in one step; fewer than the window: chosen at random", above=0
    )
    random_views: int = option(2, "older keyframes in one step, chosen at random")
    refined_poses: int = option(3, "newest keyframes whose poses are refined while mapping")
    update_every: int = option(150, "steps between two rounds of cloning, splitting and pruning", above=0)
    update_offset: int = option(50, "step of the first such round")
    fade_every: int = option(2001, "steps between two rounds that lower the opacities of what is not in view", above=0)
    prune_opacity: float = option(0.7, "Gaussians fainter than this are dropped in such a round", maximum=1)
    prune_pixels: float = option(20.0, "Gaussians with a larger radius are dropped in such a round", unit="px")
    prune_seen: int = option(3, "new Gaussians that at most this many keyframes of a full window see are dropped")
    pull: float = option(
        0.0002, "mean gradient across the image above which a Gaussian is cloned or split, for images of 480 rows"
    )
    isotropy: float = option(10.0, "weight of the regulariser that keeps Gaussians round")
    position_rate: float = option(1.6e-3, "learning rate of positions at the start, in extents", above=0)
    position_rate_end: float = option(1.6e-6, "the same after rate_steps steps", above=0)
    rate_steps: int = option(30_000, "steps over which the position's rate falls", above=0)
    colour_rate: float = option(2.5e-3, "learning rate of colours")
    opacity_rate: float = option(0.05, "learning rate of opacities (logits)")
    scale_rate: float = option(1e-3, "learning rate of sizes (logarithms), in extents as well")
    turn_rate: float = option(1e-3, "learning rate of the Gaussians' orientations")
    final_iterations: int = option(
        0, "steps on random keyframes at the end, colour refinement; the paper's evaluation does 26,000"
    )


@dataclass(frozen=True)
class MonogsConfig(RenderingOptions, TrackingOptions, KeyframeOptions, GaussianOptions, MappingOptions):
    """All options, with flat names. A depth is the median scene depth."""


PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"tracking_iterations": 50, "initial_iterations": 350, "mapping_iterations": 60, "joint_iterations": 120,
             "window_views": 3, "random_views": 1, "update_every": 60, "update_offset": 20},
}  # fmt: skip
