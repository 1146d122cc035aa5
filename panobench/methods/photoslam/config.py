"""Options of the ``photoslam`` method."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from panobench.methods.sparse.config import SparseConfig
from panobench.options import Options, option


@dataclass(frozen=True)
class GaussianOptions(Options):
    """New Gaussians."""

    depth: Literal["points", "sweep"] = option(
        "points", "depth of new Gaussians: from the feature map's points around them, or a sweep over keyframes"
    )
    pixels_per_gaussian: float = option(6.0, "area of a keyframe per Gaussian", unit="px", above=0)
    insert_opacity: float = option(0.5, "Gaussians are added where the rendered opacity is lower", maximum=1)
    insert_error: float = option(0.12, "and where the colour (0 to 1, mean of 5x5 pixels) is off by more")
    flatten: float = option(0.3, "thickness of a new Gaussian over its radius", above=0)
    scale_factor: float = option(0.55, "radius of a new Gaussian over the spacing of the seeds", above=0)
    initial_opacity: float = option(0.9, "opacity of a new Gaussian", above=0, below=1)


@dataclass(frozen=True)
class MappingOptions(Options):
    """Mapping. A depth is the median scene depth."""

    levels: int = option(2, "sizes of the image pyramid a new keyframe is learnt on, the smallest first", above=0)
    mapping_iterations: int = option(40, "gradient steps per keyframe")
    final_iterations: int = option(300, "gradient steps at the end, on keyframes in random order")
    low_pass: float = option(0.1, "variance added to every projected Gaussian", unit="px²")
    loss_knee: float = option(0.05, "colour residual (0 to 1) below which the loss is quadratic")
    position_rate_rel: float = option(1e-3, "learning rate of positions", unit="depths")
    scale_rate: float = option(0.02, "learning rate of sizes (logarithms)")
    rotation_rate: float = option(0.015, "learning rate of orientations")
    opacity_rate: float = option(0.05, "learning rate of opacities (logits)")
    colour_rate: float = option(0.01, "learning rate of colours")


@dataclass(frozen=True)
class DensityOptions(Options):
    """Densification and pruning."""

    densify_every: int = option(5, "keyframes between two rounds of cloning, splitting and pruning; 0: never")
    pull: float = option(0.0002, "mean gradient across the image above which a Gaussian is cloned or split")
    most_per_pixel: float = option(0.3, "most Gaussians, over the pixels of one image", above=0)
    prune_opacity: float = option(0.05, "Gaussians fainter than this are dropped", maximum=1)
    largest_rel: float = option(0.3, "Gaussians larger than this are dropped", unit="depths", above=0)


@dataclass(frozen=True)
class PhotoslamConfig(GaussianOptions, MappingOptions, DensityOptions):
    """Options of the map have flat names; ``tracking`` holds those of ``sparse``."""

    tracking: SparseConfig = field(default_factory=SparseConfig)


PRESETS: dict[str, dict[str, Any]] = {
    "fast": {"mapping_iterations": 12, "final_iterations": 60, "pixels_per_gaussian": 8.0},
    "sweep": {"depth": "sweep"},
}
