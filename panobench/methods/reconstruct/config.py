"""Options of the ``reconstruct`` method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from panobench.options import Options, option


@dataclass(frozen=True)
class InputOptions(Options):
    """Poses and views."""

    trajectory: str = option("", "TUM file with the camera-to-world poses to use; empty: the data's ground truth")
    max_time_difference: float = option(0.02, "most between a frame and the pose of the file taken for it", unit="s")
    views: int = option(300, "most frames the map is fitted to, spread over the sequence", above=0)


@dataclass(frozen=True)
class SeedOptions(Options):
    """Where Gaussians start."""

    seeds: int = option(24, "frames tried as places to start Gaussians; those that see nothing new add none", above=0)
    sweep_views: int = option(8, "frames that the depth of a seed is swept over", above=0)
    sweep_width: int = option(256, "width of the images that are swept", unit="px", above=0)
    new_share: float = option(0.02, "share of the image that must be unknown before a frame becomes a seed")
    pixels_per_gaussian: float = option(4.0, "area of a seed per Gaussian", unit="px", above=0)
    flatten: float = option(0.15, "thickness of a new Gaussian over its radius", above=0)
    scale_factor: float = option(0.55, "radius of a new Gaussian over the spacing of the seeds", above=0)
    initial_opacity: float = option(0.9, "opacity of a new Gaussian", above=0, below=1)


@dataclass(frozen=True)
class FittingOptions(Options):
    """Fitting the map to all views. Rates are those at the start; a depth is the median scene depth."""

    passes: int = option(15, "gradient steps per frame, in random order")
    decay: float = option(0.1, "what is left of the learning rates at the last step", above=0)
    low_pass: float = option(0.1, "variance added to every projected Gaussian", unit="px²")
    loss_knee: float = option(0.05, "colour residual (0 to 1) below which the loss is quadratic")
    position_rate_rel: float = option(1e-3, "learning rate of positions", unit="depths")
    scale_rate: float = option(0.04, "learning rate of sizes (logarithms)")
    rotation_rate: float = option(0.03, "learning rate of orientations")
    opacity_rate: float = option(0.1, "learning rate of opacities (logits)")
    colour_rate: float = option(0.02, "learning rate of colours")


@dataclass(frozen=True)
class DensityOptions(Options):
    """Densification and pruning."""

    densify_every: int = option(3, "passes between two rounds of cloning, splitting and pruning; 0: never")
    densify_until: float = option(0.6, "share of the passes after which there are no such rounds")
    pull: float = option(0.0002, "mean gradient across the image above which a Gaussian is cloned or split")
    most_per_pixel: float = option(0.5, "most Gaussians, over the pixels of one image", above=0)
    prune_opacity: float = option(0.05, "Gaussians fainter than this are dropped", maximum=1)
    largest_rel: float = option(0.3, "Gaussians larger than this are dropped", unit="depths", above=0)


@dataclass(frozen=True)
class ReconstructConfig(InputOptions, SeedOptions, FittingOptions, DensityOptions):
    """All options, with flat names."""


PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"passes": 5, "seeds": 12, "densify_every": 0},
    "thorough": {"passes": 60, "views": 1000, "decay": 0.02},
}
