"""Options of PanoGS-SLAM. The defaults are the best we have; ``PAPER`` is the paper's setting."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Literal

_POSITIVE = ("constant_depth", "keyframe_wide", "pixels_per_gaussian", "scale_factor", "tracking_pixels", "window")


@dataclass(frozen=True)
class PanogsConfig:
    """Grouped by stage; lengths named ``_rel`` are in units of the median scene depth."""

    # Rendering
    projection: Literal["auto", "sphere", "erp", "pinhole"] = "auto"
    low_pass: float = 0.1
    # Tracking
    solver: Literal["gauss-newton", "adam"] = "gauss-newton"
    tracking_iterations: int = 15  # of solver "adam"
    tracking_renders: int = 2
    tracking_pixels: int = 16384  # of every level of the pyramid that are aligned, evenly spread; all in a narrow view
    exposure: bool = False  # gain and offset are unknowns of every alignment
    match_exposure: bool = True  # frames are brought to the map's exposure if theirs differs plainly
    relocalise: bool = True  # a frame the map does not explain gets no pose until it is found again
    loss: Literal["cosine", "uniform", "gaussian"] = "cosine"
    # Keyframes (MonoGS's rule)
    window: int = 8
    keyframe_overlap: float = 0.9
    keyframe_min_rel: float = 0.05
    keyframe_max_rel: float = 0.08
    keyframe_wide: float = 1.5  # both times so much in wide views: they still see most of it from there
    keyframe_interval: int = 5
    keyframe_new: float = 0.04
    keyframe_new_interval: int = 4
    # Gaussians
    pixels_per_gaussian: float = 6.0  # of the seeds; the map gets finer where it must (densify)
    insert_opacity: float = 0.5
    insert_error: float = 0.12
    sweep: bool = True  # depth of newly seen regions from the last frames, not from the nearest pixel
    sweep_share: float = 0.005  # of the image that must be new for a sweep
    delay: int = 12  # frames looked back: the length of the smoothed window, and what a newly seen region waits
    delay_min: int = 4  # the same in a narrow view that turns away from what it saw
    delay_share: float = 0.6  # of the view of a frame looked back to that the newest must still see
    guess_share: float = 0.2  # unknown share of a narrow view above which the nearest depth is taken at once
    smooth: bool = True  # refine the poses of the last frames jointly with depth, behind the tracker
    adjust: bool = True  # fit the trajectory to windows of bundle adjustment over all frames
    laps: bool = True  # places come back to tie the whole trajectory together, in the end
    sweep_confidence: float = 0.2
    carve: bool = True  # drop Gaussians in front of a swept surface where the colour is wrong
    depth_guided: bool = True  # False: the "w/o DGIS" ablation
    flatten: float = 0.15
    scale_factor: float = 0.55
    initial_opacity: float = 0.9
    # Mapping
    mapping_iterations: int = 8
    steps_per_frame: int = 4  # mapping steps are spread over frames, about so many each; 0: all at the keyframe
    initial_iterations: int = 20
    random_views: int = 2
    random_from: Literal["frames", "keyframes"] = "frames"
    frame_pool: int = 300  # frames outside the window whose images are kept for mapping
    refine_poses: bool = True
    pose_rate_rotation: float = 2e-4
    pose_rate_translation_rel: float = 2e-4
    position_rate_rel: float = 1e-3
    scale_rate: float = 0.04
    rotation_rate: float = 0.06
    lift: float = 0.2  # factors on the rates of leaving the disc's plane and of tilting it
    tilt: float = 0.1
    opacity_rate: float = 0.1
    colour_rate: float = 0.02
    loss_knee: float = 0.05
    adam_beta1: float = 0.8
    adam_beta2: float = 0.99
    isotropy: float = 0.0
    densify: bool = True  # seeds follow the detail of the image, and discs too coarse for it are split
    split_error: float = 0.06  # colour error over a disc's pixels from which it is split, and its least size there
    split_size_px: float = 1.0
    split_new: float = 0.02  # with more of the image unknown or wrong nothing is split: that is not for want of detail
    prune_opacity: float = 0.05
    hidden_px: float = 0.01  # a view's steps leave out what makes up fewer of its pixels than that, in sum
    final_iterations: int = 15  # steps per keyframe at the end, on all views, with falling rates
    loop: bool = False  # close loops: parts of the map long out of sight sleep, are recognised, correct the drift since
    # Depth of the first frame when the run names no estimator
    constant_depth: float = 2.0

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, (int, float)) and not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{f.name} must be a number from 0 up, not {value}")
        for name in _POSITIVE:
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0")
        for name in ("adam_beta1", "adam_beta2", "initial_opacity"):
            if not getattr(self, name) < 1:
                raise ValueError(f"{name} must be below 1")


#: The paper's solver, iterations and projection.
PAPER: dict[str, Any] = {
    "projection": "erp",
    "relocalise": False,
    "keyframe_new": 1.0,
    "keyframe_wide": 1.0,
    "densify": False,
    "hidden_px": 0.0,
    "pixels_per_gaussian": 4.0,
    "steps_per_frame": 0,
    "match_exposure": False,
    "carve": False,
    "sweep": False,
    "smooth": False,
    "adjust": False,
    "laps": False,
    "solver": "adam",
    "tracking_iterations": 15,
    "mapping_iterations": 30,
    "final_iterations": 0,
    "initial_iterations": 60,
    "tracking_renders": 1,
    "low_pass": 0.3,
    "position_rate_rel": 1.6e-4,
    "scale_rate": 1e-3,
    "rotation_rate": 2e-3,
    "lift": 1.0,
    "tilt": 1.0,
    "opacity_rate": 0.05,
    "colour_rate": 2.5e-3,
    "loss_knee": 0.0,
    "adam_beta1": 0.9,
    "adam_beta2": 0.999,
    "isotropy": 10.0,
}
#: For those who want the trajectory soon and a sketch of the map.
FAST: dict[str, Any] = {"mapping_iterations": 5, "final_iterations": 3}
PRESETS: dict[str, dict[str, Any]] = {"paper": PAPER, "fast": FAST}
