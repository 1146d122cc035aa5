"""Options of PanoGS-SLAM, stage by stage. The defaults are the best we have; ``PAPER`` is the paper's setting."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from panobench.options import Options, option


@dataclass(frozen=True)
class RenderingOptions(Options):
    """Rendering and its loss."""

    projection: Literal["auto", "sphere", "erp", "pinhole"] = option("auto", "projection of Gaussians; auto is sphere")
    low_pass: float = option(0.1, "variance added to every footprint", unit="px^2")
    weights: Literal["cosine", "uniform", "gaussian"] = option(
        "cosine", "weights of the latitudes, in the loss and in alignment"
    )
    knee: float = option(0.05, "residual below which the loss is quadratic", unit="of 1")


@dataclass(frozen=True)
class StartOptions(Options):
    """The first map."""

    iterations: int = option(20, "mapping steps on the first keyframe")
    constant_depth: float = option(2.0, "depth of the first frame if no estimator is named", above=0)


@dataclass(frozen=True)
class ExposureOptions(Options):
    """Bringing frames to the map's exposure (wide views only)."""

    match: bool = option(True, "bring frames whose exposure plainly differs from the map's to it")
    flicker: bool | Literal["auto"] = option(
        "auto",
        "take out bands of mains light under a rolling shutter; auto: if the first frames show that there are any",
    )
    least_before: float = option(0.04, "least log gain that is corrected before tracking")
    least_after: float = option(0.015, "least log gain that is corrected after tracking, before mapping")


@dataclass(frozen=True)
class RollingShutterOptions(Options):
    """Rectifying frames whose rows are read one after another."""

    readout_ms: float | None = option(
        0.0,
        "time from the first row of a lens to its last; 0: global shutter; none: estimated",
        unit="ms",
    )
    least_px: float = option(0.02, "least distance a pixel is moved for", unit="px", above=0)


@dataclass(frozen=True)
class StitchOptions(Options):
    """Panoramas stitched from two lenses back to back, which see things near the seam from two places."""

    baseline_mm: float = option(0.0, "distance between the two lenses; 0: one centre", unit="mm")
    distance_m: float | None = option(
        None, "distance of what is stitched without a seam; 0: infinite; none: the scene's", unit="m"
    )
    most_px: float = option(1.0, "parallax at the seam from which it is left out; 0: never", unit="px")


@dataclass(frozen=True)
class RigOptions(Options):
    """Several lenses with a centre each."""

    enabled: bool = option(
        True, "see through each lens of a rig from its own centre; off: through the stitched panorama"
    )


@dataclass(frozen=True)
class TrackingOptions(Options):
    """Alignment of a frame to renders of the map."""

    solver: Literal["gauss-newton", "adam"] = option("gauss-newton", "adam is the paper's, on the rendering loss")
    iterations: int = option(15, "steps of solver adam")
    renders: int = option(2, "renders of the map per frame, at most", above=0)
    pixels: int = option(16384, "pixels aligned per pyramid level, evenly spread; a narrow view uses all", above=0)
    exposure: bool = option(False, "solve for gain and offset in every alignment")
    gradient_min: float = option(
        0.015,
        "least gradient of a rendered pixel that is aligned: plain walls have a mottle of their own",
        unit="of 1 per px",
        above=0,
    )
    opacity_min: float = option(0.9, "opacity below which a rendered pixel has no depth to align to", maximum=1.0)
    render_again_px: float = option(0.7, "distance from the last render beyond which another one is made", unit="px")


@dataclass(frozen=True)
class RelocalisationOptions(Options):
    """Noticing that the camera is lost, and finding it again."""

    enabled: bool = option(True, "give no pose to a frame that the map does not explain, until it is found again")
    unusual: float = option(1.5, "residual, over the median of the last frames, from which a pose is checked")
    usual_frames: int = option(20, "frames in that median", above=0)
    agree_tracked: float = option(0.4, "share of blocks that must agree with the map for a camera that was tracked")
    agree_lost: float = option(0.5, "the same for a camera that was lost")
    agree_entry: float = option(0.65, "share of finer blocks that must agree for a camera looked for in a saved map")
    agree_surely: float = option(0.85, "the same at which the search ends at once")
    likeness_min: float = option(0.25, "correlation of thumbnails from which a keyframe is a start of the search")
    starts: int = option(8, "starts tried for a frame while the camera has just been lost")
    starts_later: int = option(3, "starts tried for a frame after ``patience`` frames")
    patience: int = option(5, "frames with the larger number of starts")
    rounds: int = option(4, "renders and alignments from one start")


@dataclass(frozen=True)
class AtlasOptions(Options):
    """Other maps, begun where the camera is lost for good, and how they are joined."""

    enabled: bool = option(True, "begin another map where the camera is lost for good (monocular runs)")
    lost: int = option(8, "frames without a pose after which another map is begun", above=0)
    overlap: int = option(24, "frames from before the loss that another map begins with, to be joined by", above=0)
    patience: int = option(60, "frames that such a map may wait for its first depth before it begins without them")
    agree: float = option(0.76, "share of fine blocks that must agree where the camera is found in an older map")
    common: int = option(10, "frames with a pose in both maps that join them, at least", above=2)
    moved: float = option(0.1, "distance that the camera must have moved over these", unit="depths", above=0)
    common_after_cut: int = option(40, "``common`` where only looks tell how two maps lie, as after a cut", above=2)
    moved_after_cut: float = option(0.5, "``moved`` there", unit="depths", above=0)
    alike: float = option(0.5, "correlation of the thumbnails of two frames in a row below which there is a cut")
    residual: float = option(0.06, "disagreement of these over that distance, at most", above=0)
    turn: float = option(1.0, "disagreement of their rotations, at most", unit="degrees", above=0)


@dataclass(frozen=True)
class KeyframeOptions(Options):
    """When a frame becomes a keyframe (MonoGS's rule), and the window of keyframes."""

    window: int = option(8, "keyframes in the window", above=0)
    overlap: float = option(0.9, "co-visibility with the last keyframe below which a frame may become one")
    distance_min: float = option(
        0.05, "distance from the last keyframe at which low co-visibility counts", unit="depths"
    )
    distance_max: float = option(0.08, "distance from it at which a frame becomes one", unit="depths")
    wide: float = option(1.5, "factor on both distances in wide views, which still see most of the scene", above=0)
    interval: int = option(5, "least distance between keyframes while the window fills", unit="frames")
    new_share: float = option(0.04, "share of the image that is unknown or wrong from which a frame becomes a keyframe")
    new_interval: int = option(4, "least distance between such keyframes", unit="frames")


@dataclass(frozen=True)
class SeedingOptions(Options):
    """New Gaussians."""

    pixels_per_gaussian: float = option(6.0, "pixels per seed; the map gets finer where it must", above=0)
    opacity_below: float = option(0.5, "rendered opacity below which the map is thin", maximum=1.0)
    error_above: float = option(0.12, "mean colour error over 5 x 5 pixels from which the map is wrong", unit="of 1")
    depth_guided: bool = option(True, "depth from the nearest pixel that has one; off: the ablation w/o DGIS")
    guess_share: float = option(
        0.2, "share of a narrow view that is unknown after a sweep from which the nearest depth is used there"
    )
    flatten: float = option(0.15, "thickness of a disc over its width")
    scale_factor: float = option(0.55, "standard deviation of a disc over the distance between seeds", above=0)
    opacity: float = option(0.9, "opacity of a new Gaussian", below=1)
    carve: bool = option(True, "drop Gaussians in front of a swept surface where the colour is wrong")
    carve_depth: float = option(0.85, "share of the swept depth below which a Gaussian stands in front of it")
    carve_share: float = option(0.25, "share of a Gaussian's weight on wrong pixels from which it is dropped")


@dataclass(frozen=True)
class MovingOptions(Options):
    """What moves through the scene by itself, and is left out of the map."""

    enabled: bool = option(True, "leave out of the map what later frames do not confirm")
    error: float = option(0.16, "colour error from which a frame contradicts the map", unit="of 1")
    share: float = option(0.012, "share of a frame that must have changed for anything to be left out")
    confirmed: float = option(0.03, "mean difference up to which later frames confirm what a frame shows", unit="of 1")
    seen_through: float = option(
        0.2, "share of the views with an opinion on a Gaussian that must see through it for it to go", maximum=1.0
    )


@dataclass(frozen=True)
class DensityOptions(Options):
    """Refining and thinning the map."""

    adaptive: bool = option(True, "seeds follow the detail of the image, and discs too coarse for it are split")
    split_error: float = option(0.06, "mean colour error over a disc's pixels from which it is split", unit="of 1")
    split_size_px: float = option(1.0, "least standard deviation of a disc that is split", unit="px")
    split_share: float = option(0.05, "share of all Gaussians split at once, at most")
    split_new_share: float = option(0.02, "share of the image unknown or wrong above which nothing is split")
    prune_opacity: float = option(0.05, "opacity below which a Gaussian is dropped", above=0, below=1)
    largest: float = option(0.3, "largest standard deviation of a Gaussian", unit="depths")


@dataclass(frozen=True)
class FixedLagOptions(Options):
    """Fixed-lag smoothing of the last poses, and depth of new regions swept over the last frames."""

    lag: int = option(12, "frames between the newest frame and the one that receives depth", above=0)
    lag_min: int = option(4, "the same, at least, in a narrow view that turns away from what it saw")
    view_share: float = option(0.6, "share of that frame's view that the newest must still see (narrow views)")
    step_min: float = option(0.008, "distance from the last buffered frame at which a frame is buffered", unit="depths")
    sweep: bool = option(True, "sweep the depth of new regions; off: the nearest pixel's")
    new_share: float = option(0.005, "share of the image that must be new for a sweep")
    confidence: float = option(0.2, "confidence from which swept depth is used")
    parallax_min: float = option(0.03, "translation that a sweep needs", unit="depths")
    near: float = option(0.1, "nearest depth swept", unit="depths", above=0)
    far: float = option(15.0, "farthest depth swept", unit="depths", above=0)
    disprove_depth: float = option(0.1, "log ratio from which a swept depth is another than the map's", above=0)
    disprove_share: float = option(0.6, "error of the swept depth over the map's below which the map's is disproved")
    disprove_margin: float = option(0.004, "margin on that comparison", unit="of 1")
    smooth: bool = option(True, "refine the poses of the last frames jointly with depth")
    shared_min: int = option(4, "frames two lags must share for the scale to pass from one to the other")
    shared_far: float = option(0.5, "distance over the lag's length from which such a frame counts")
    stretch_max: float = option(1.25, "largest change of scale of one lag, either way", above=0)


@dataclass(frozen=True)
class FactorOptions(Options):
    """Bundle-adjustment factors between frames, and the trajectory that suits them."""

    enabled: bool = option(True, "fit the trajectory to bundle-adjustment factors over all frames")
    every: int = option(8, "a reference frame every so many frames that moved", above=0)
    reach: int = option(24, "frames on either side that a reference is compared with", above=0)
    renew_after: int = option(48, "frames after which a factor is made again if the map's depth has changed", above=0)
    renew_change: float = option(0.01, "median change of the log depth from which it is made again")
    late: int = option(4, "frames a factor may wait for other work")
    free: int = option(96, "last frames whose poses a fit may change", above=0)
    rig_reach: float = option(
        0.7, "on a rig: how far a frame may be from the reference that it is compared with", unit="depths", above=0
    )
    prior_translation: float = option(
        0.006,
        "standard deviation of a tracked position, which is held less where factors move it far",
        unit="depths",
        above=0,
    )
    prior_bend: float = option(
        0.0018, "standard deviation of how a fit bends tracked positions, from frame to frame", unit="depths", above=0
    )
    prior_rotation: float = option(0.005, "standard deviation of a tracked rotation", unit="rad", above=0)


@dataclass(frozen=True)
class RevisitOptions(Options):
    """Loop factors from revisits: places the camera comes back to tie the whole trajectory together, at the end."""

    enabled: bool = option(True, "look for revisits")
    old: int = option(200, "frames that moved after which a place counts as left", above=0)
    near: float = option(0.3, "distance from an old place that counts as back", unit="depths")
    old_most: int = option(6, "old references that a reference is compared with, at most")
    recent: int = option(3, "recent references in the same factor", above=0)
    cost_max: float = option(2.0, "alignment cost of an old reference over the median cost of recent ones, at most")
    overlap_min: float = option(0.6, "share of the view that an old reference must share")
    prior_translation: float = option(1.0, "standard deviation of a position that has drifted", unit="depths", above=0)
    prior_rotation: float = option(0.5, "standard deviation of a rotation that has drifted", unit="rad", above=0)
    alike: int = option(6, "old references that are compared because they look alike, at most; 0: none")
    agree: float = option(0.5, "share of fine blocks of an image that such a reference must explain", maximum=1.0)
    turn_max: float = option(5.0, "turn by which such an alignment may contradict the poses so far", unit="degrees")
    drift_max: float = option(0.01, "drift of the position since then that it may take out, over the way", maximum=1.0)


@dataclass(frozen=True)
class MappingOptions(Options):
    """Training steps on the map."""

    iterations: int = option(8, "steps per keyframe")
    steps_per_frame: int = option(4, "steps spread over frames, about so many each; 0: all at the keyframe")
    backlog: int = option(
        8, "a frame does more steps than usual once so many times more than usual are planned", above=0
    )
    random_views: int = option(2, "views outside the window in each round of steps")
    random_from: Literal["frames", "keyframes"] = option("frames", "where these come from")
    blurred_below: float = option(
        0.75, "fine detail, over the sharpest frames', below which the map learns less from a frame; 0: off", below=1
    )
    frame_pool: int = option(300, "frames outside the window whose images are kept for mapping")
    refine_poses: bool = option(True, "refine the poses of the views along with the map")
    isotropy: float = option(0.0, "weight of MonoGS's isotropy regulariser")
    culling_px: float = option(
        0.01, "summed weight below which a view's steps leave a Gaussian out; 0: draw all", unit="px"
    )
    final_iterations: int = option(15, "steps per keyframe at the end, on all views, with falling rates")
    final_rounds: int = option(
        1, "rounds of such steps, at most, each twice as long as the one before; more than 1: while views left out gain"
    )
    final_gain: float = option(0.05, "least that the pictures of these views must gain for another round", unit="dB")
    final_rate: float = option(0.1, "learning rates at the end of these steps over those at the start", above=0)


@dataclass(frozen=True)
class RateOptions(Options):
    """Learning rates and Adam."""

    position: float = option(1e-3, "step of a mean", unit="depths")
    scale: float = option(0.04, "step of a log standard deviation")
    rotation: float = option(0.06, "step of a rotation", unit="rad")
    lift: float = option(0.2, "factor on the position's rate along a disc's normal")
    tilt: float = option(0.1, "factor on the rotation's rate out of a disc's plane")
    opacity: float = option(0.1, "step of an opacity logit")
    colour: float = option(0.02, "step of a colour", unit="of 1")
    pose_translation: float = option(2e-4, "step of a view's position", unit="depths")
    pose_rotation: float = option(2e-4, "step of a view's rotation", unit="rad")
    beta1: float = option(0.8, "decay of Adam's first moment", below=1)
    beta2: float = option(0.99, "decay of Adam's second moment", below=1)


@dataclass(frozen=True)
class PanogsConfig(Options):
    """Everything that tunes panogs. The unit "depths" is the median depth of the scene."""

    rendering: RenderingOptions = field(default_factory=RenderingOptions)
    start: StartOptions = field(default_factory=StartOptions)
    exposure: ExposureOptions = field(default_factory=ExposureOptions)
    rolling_shutter: RollingShutterOptions = field(default_factory=RollingShutterOptions)
    stitch: StitchOptions = field(default_factory=StitchOptions)
    rig: RigOptions = field(default_factory=RigOptions)
    tracking: TrackingOptions = field(default_factory=TrackingOptions)
    relocalisation: RelocalisationOptions = field(default_factory=RelocalisationOptions)
    atlas: AtlasOptions = field(default_factory=AtlasOptions)
    keyframes: KeyframeOptions = field(default_factory=KeyframeOptions)
    seeding: SeedingOptions = field(default_factory=SeedingOptions)
    moving: MovingOptions = field(default_factory=MovingOptions)
    density: DensityOptions = field(default_factory=DensityOptions)
    fixed_lag: FixedLagOptions = field(default_factory=FixedLagOptions)
    factors: FactorOptions = field(default_factory=FactorOptions)
    revisits: RevisitOptions = field(default_factory=RevisitOptions)
    mapping: MappingOptions = field(default_factory=MappingOptions)
    rates: RateOptions = field(default_factory=RateOptions)


#: The paper's solver, iterations and projection.
PAPER: dict[str, Any] = {
    "rendering.projection": "erp",
    "rendering.low_pass": 0.3,
    "rendering.knee": 0.0,
    "start.iterations": 60,
    "exposure.match": False,
    "exposure.flicker": False,
    "tracking.solver": "adam",
    "tracking.iterations": 15,
    "tracking.renders": 1,
    "relocalisation.enabled": False,
    "atlas.enabled": False,
    "keyframes.new_share": 1.0,
    "keyframes.wide": 1.0,
    "seeding.pixels_per_gaussian": 4.0,
    "seeding.carve": False,
    "moving.enabled": False,
    "density.adaptive": False,
    "fixed_lag.sweep": False,
    "fixed_lag.smooth": False,
    "factors.enabled": False,
    "revisits.enabled": False,
    "mapping.iterations": 30,
    "mapping.steps_per_frame": 0,
    "mapping.final_iterations": 0,
    "mapping.culling_px": 0.0,
    "mapping.blurred_below": 0.0,
    "mapping.isotropy": 10.0,
    "rates.position": 1.6e-4,
    "rates.scale": 1e-3,
    "rates.rotation": 2e-3,
    "rates.lift": 1.0,
    "rates.tilt": 1.0,
    "rates.opacity": 0.05,
    "rates.colour": 2.5e-3,
    "rates.beta1": 0.9,
    "rates.beta2": 0.999,
}
#: For those who want the trajectory soon and a sketch of the map.
FAST: dict[str, Any] = {"mapping.iterations": 5, "mapping.final_iterations": 3}
#: For those who want the best pictures, and can wait: the map is trained until they stop getting better.
BEST: dict[str, Any] = {"mapping.final_iterations": 30, "mapping.final_rounds": 3}
PRESETS: dict[str, dict[str, Any]] = {"paper": PAPER, "fast": FAST, "best": BEST}
