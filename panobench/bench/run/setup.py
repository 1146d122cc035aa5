"""Set up a run: make the method with its options, the sequence through its camera, and the depth estimator.

This happens before anything is written; every mistake of the user is a PanobenchError.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from panobench.bench.run.config import method_config
from panobench.bench.run.masking import MaskChoice, choose_mask
from panobench.bench.run.request import RunRequest
from panobench.bench.run.views import ChosenFrames
from panobench.datasets.base import FrameSequence
from panobench.depth.base import DepthEstimator
from panobench.errors import UnavailableError, UnsupportedError, UsageError
from panobench.kernels.ahead import Prepared, Progress, compile_ahead, entry_points
from panobench.maps.saved import SavedMap
from panobench.methods.base import BatchMethod, OnlineMethod
from panobench.plugins import registry
from panobench.specs import CameraSpec, DatasetSpec, DepthSpec, MethodSpec

if TYPE_CHECKING:
    from panobench.gpu.device import Device

DEFAULT_DEPTH = "bootstrap"


@dataclass
class DepthChoice:
    """The depth estimator of a run; ``make`` counts how often the method asked for one."""

    name: str
    argument: str
    spec: DepthSpec
    chosen: bool
    made: int = 0

    @property
    def label(self) -> str:
        return f"{self.name}:{self.argument}" if self.argument else self.name

    def make(self) -> DepthEstimator:
        self.made += 1
        estimator: DepthEstimator = self.spec.load()(self.argument)
        return estimator


@dataclass
class RunSetup:
    """Everything a run needs, ready to start. device: what maps are computed on, None for the CPU; device_note: why."""

    spec: MethodSpec
    origin: str
    method: OnlineMethod | BatchMethod
    config: Any
    sequence: ChosenFrames
    depth: DepthChoice | None
    mask: MaskChoice = field(default_factory=MaskChoice)
    kernels: Prepared = field(default_factory=Prepared)
    saved_map: SavedMap | None = None
    device: Device | None = None
    device_note: str = ""


def set_up_run(request: RunRequest, progress: Progress = lambda done, total: None) -> RunSetup:
    """Make everything that ``request`` names, kernels included; ``progress`` is told when those have to be compiled.

    Raises UnknownNameError, UsageError, UnsupportedError, UnavailableError or DatasetError.
    """
    from panobench.cameras.calibration import calibration_file

    spec = method_spec(request)
    saved_map = open_map(request, spec)
    config = method_config(spec, request.preset, request.settings)
    depth = open_depth(request.depth)
    mask = choose_mask(request.mask, request.dataset)
    cls = spec.load()
    method = cls(config) if spec.config is not None else cls()
    if not isinstance(method, (OnlineMethod, BatchMethod)):
        raise UnsupportedError(f"method '{spec.name}' is neither an OnlineMethod nor a BatchMethod")
    device, device_note = choose_device(request.device, method)
    kind = None if calibration_file(request.camera) else request.camera.partition(":")[0]
    kernels = compile_ahead(entry_points(spec.name, kind, request.dataset), progress)
    sequence = open_input(request, spec)
    if "imu" in spec.needs and request.imu == "off":
        raise UsageError(f"--imu off: method '{spec.name}' needs an IMU")
    if "imu" in spec.needs and sequence.imu is None:
        raise UnsupportedError(f"method '{spec.name}' needs an IMU; sequence '{sequence.name}' has none")
    own_poses = bool(getattr(config, "trajectory", ""))  # the method reads poses from a file that the user names
    if "poses" in spec.needs and sequence.groundtruth is None and not own_poses:
        raise UnsupportedError(f"method '{spec.name}' needs given poses; sequence '{sequence.name}' has none")
    origin = registry().entries[MethodSpec.kind][spec.name].origin
    return RunSetup(spec, origin, method, config, sequence, depth, mask, kernels, saved_map, device, device_note)


def open_map(request: RunRequest, spec: MethodSpec) -> SavedMap | None:
    """The saved map to start from, if one is asked for; the folder to save to is checked too.

    Raises UsageError for a method that does not take maps or needs one, MapError and OutputError for the folders.
    """
    if (request.continue_map or request.save_map) and not spec.maps:
        able = [name for name, other in registry().specs(MethodSpec).items() if other.maps]
        raise UsageError(f"method '{spec.name}' neither saves maps nor starts from one; {', '.join(able)} can")
    if spec.needs_map and not request.continue_map:
        raise UsageError(
            f"method '{spec.name}' needs a saved map: --continue DIR, made by `panobench run --save-map DIR`"
        )
    if not (request.continue_map or request.save_map):
        return None
    from panobench.maps.store import check_writable, read_map

    if request.save_map:
        check_writable(Path(request.save_map).expanduser())
    return read_map(Path(request.continue_map).expanduser()) if request.continue_map else None


def choose_device(choice: str, method: OnlineMethod | BatchMethod) -> tuple[Device | None, str]:
    """The device for ``--device``, None for the CPU, and what the user should know of the choice ("": nothing).

    Raises UnavailableError where "cuda" cannot run, and UnsupportedError where the method has no use for it.
    """
    from panobench.splat.backend import open_device

    if not method.uses_device:
        if choice == "cuda":
            raise UnsupportedError(f"--device cuda: this method computes on the CPU alone ({type(method).__name__})")
        return None, ""
    return open_device(choice)


def method_spec(request: RunRequest) -> MethodSpec:
    """The method, if it is known, takes the camera asked for and can run here."""
    spec = registry().get(MethodSpec, request.method)
    check_camera(request.camera, spec)
    reason = spec.unavailable()
    if reason:
        raise UnavailableError(f"method '{spec.name}' cannot run here: {reason}")
    return spec


def check_camera(option: str, spec: MethodSpec) -> None:
    """Raise unless the option names a camera kind the method takes; calibration files are judged when read."""
    from panobench.cameras.calibration import calibration_file

    if calibration_file(option) is not None:
        return
    kind = option.partition(":")[0]
    registry().get(CameraSpec, kind)
    check_kind(kind, spec)


def check_kind(kind: str, spec: MethodSpec) -> None:
    """Raise UnsupportedError unless the method takes images of that kind of camera."""
    if kind not in spec.cameras:
        raise UnsupportedError(f"method '{spec.name}' does not take {kind} images; it takes {', '.join(spec.cameras)}")


def open_input(request: RunRequest, spec: MethodSpec | None = None) -> ChosenFrames:
    """The sequence through the camera asked for, the frames chosen."""
    sequence = _through_camera(request)
    if spec is not None:
        check_kind(sequence.camera.kind, spec)
    return ChosenFrames(sequence, request.every, request.max_frames)


def open_source(request: RunRequest, width: int | None) -> FrameSequence:
    """The dataset's own sequence at ``width``."""
    from panobench.datasets.open import open_sequence

    sequence = open_sequence(request.dataset, request.sequence, request.root, width, request.given())
    if request.groundtruth is None:
        return sequence
    from panobench.trajectories.matching import Frames
    from panobench.trajectories.reference import ReferencedSequence, read_reference

    file = Path(request.groundtruth).expanduser()
    reference = read_reference(file, Frames.of(sequence), scale=request.groundtruth_scale, any_clock=request.align_time)
    return ReferencedSequence(sequence, reference)


def _through_camera(request: RunRequest) -> FrameSequence:
    """The sequence itself if its camera is the one asked for, otherwise converted from its full resolution.

    A generator renders for a camera of which the conversion would have to enlarge the images.
    """
    # the name of a camera model alone may mean the dataset's own camera; anything more is a conversion
    kind = registry().get(DatasetSpec, request.dataset).camera
    if (
        request.fov is None
        and request.camera in registry().specs(CameraSpec)
        and request.camera == (kind or request.camera)
    ):
        source = open_source(request, request.width)
        if source.camera.kind == request.camera:
            return source
    from panobench.cameras.factory import parse_camera_option
    from panobench.cameras.footprint import ENLARGED, enlargement
    from panobench.datasets.writing.converted import ConvertedSequence

    source = open_source(request, None)
    choice = parse_camera_option(request.camera, source.camera, request.width, request.fov)
    if enlargement(source.camera, choice.camera, choice.R_target_source) > ENLARGED:
        rendered = source.rendered_by(choice.camera, choice.R_target_source)
        if rendered is not None:
            return rendered
    return ConvertedSequence(source, choice.camera, choice.R_target_source)


def open_depth(option: str | None) -> DepthChoice | None:
    """The estimator of `--depth NAME[:ARGUMENT]`; the default when None. Raises for unknown names or arguments."""
    known = registry().specs(DepthSpec)
    if option is None and DEFAULT_DEPTH not in known:
        return None
    name, _, argument = (option or DEFAULT_DEPTH).partition(":")
    spec = registry().get(DepthSpec, name)
    reason = spec.unavailable()
    if reason and option is not None:
        raise UnavailableError(f"depth estimator '{name}' cannot run here: {reason}")
    if argument and not spec.argument:
        raise UsageError(f"--depth {option}: '{name}' takes no argument")
    choice = DepthChoice(name, argument, spec, option is not None)
    if option is not None:
        spec.load()(argument)  # this refuses a wrong argument now, not after the first frames
    return choice


def wants_imu(request: RunRequest, spec: MethodSpec) -> bool:
    """Whether the method gets the sequence's inertial samples, if there are any."""
    return request.imu != "off" and ("imu" in spec.needs or "imu" in spec.uses)


def oracle_depth(setup: RunSetup) -> Callable[[int], Any]:
    """Depth to hand over with frame i: all of it to methods that need depth, the first one for an oracle, else none."""
    sequence = setup.sequence
    if "depth" in setup.spec.needs:
        return sequence.depth
    if setup.depth is None or not setup.depth.spec.needs_dataset_depth:
        return lambda index: None
    given: list[int] = []

    def first(index: int) -> Any:
        depth = None if given else sequence.depth(index)
        if depth is not None:
            given.append(index)
        return depth

    return first
