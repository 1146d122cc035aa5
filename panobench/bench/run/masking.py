"""The mask of a run: what hides part of the view from the method, as `--mask` says, and what is written about it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.bench.records.record import MaskRecord, MovingRecord
from panobench.bench.run.views import ChosenFrames, MethodSequence
from panobench.cameras.base import Camera
from panobench.errors import DatasetError, PanobenchError, UnavailableError, UnknownNameError, UsageError
from panobench.masks.base import MaskEstimate, MaskEstimator
from panobench.masks.files import MaskFile, read_mask_file
from panobench.masks.frame_masks import write_frame_masks
from panobench.plugins import registry
from panobench.specs import DatasetSpec, MaskSpec

Mask = NDArray[np.bool_]
#: Values of the run option ``mask`` that are neither an estimator nor a file.
AUTO, NONE = "auto", "none"
#: The estimator that ``auto`` means.
DEFAULT_MASK = "geometry"
#: The mask in a run's folder (white: the method saw it), and a frame on which it is drawn.
MASK, HIDDEN = "mask.png", "hidden.jpg"
#: Folders of masks of single frames: what else was hidden from the method, and what it left out by itself.
FRAME_MASKS, MOVING = "masks", "moving"
#: How they are drawn: hidden from the method, and left out by it (RGB).
HIDDEN_COLOUR, MOVING_COLOUR = (230, 50, 60), (250, 190, 30)


@dataclass(frozen=True)
class MaskChoice:
    """What the run option ``mask`` asks for: an estimator with its argument, or a file, or neither."""

    spec: MaskSpec | None = None
    argument: str = ""
    file: Path | None = None

    @property
    def source(self) -> str:
        return self.spec.name if self.spec else "file" if self.file else ""


def choose_mask(option: str | None, dataset: str) -> MaskChoice:
    """The choice that `--mask` makes; None: ``auto`` for recordings, none for rendered data.

    Raises UsageError for a file that is not there, UnknownNameError for what is neither a file nor an estimator, and
    UnavailableError for an estimator that cannot run here.
    """
    known = registry().specs(MaskSpec)
    if option is None:
        option = AUTO if registry().get(DatasetSpec, dataset).recorded and DEFAULT_MASK in known else NONE
    if option == NONE:
        return MaskChoice()
    name, _, argument = (DEFAULT_MASK if option == AUTO else option).partition(":")
    if name not in known:
        path = Path(option).expanduser()
        if path.is_file():
            return MaskChoice(file=path)
        if path.suffix or "/" in option:
            raise UsageError(f"--mask {option}: there is no such file")
        raise UnknownNameError("mask", name, [AUTO, NONE, *known])
    spec = registry().get(MaskSpec, name)
    reason = spec.unavailable()
    if reason:
        raise UnavailableError(f"mask estimator '{name}' cannot run here: {reason}")
    if argument and not spec.argument:
        raise UsageError(f"--mask {option}: '{name}' takes no argument")
    spec.load()(argument)  # this refuses a wrong argument now
    return MaskChoice(spec, argument)


def find_mask(choice: MaskChoice, sequence: ChosenFrames, seed: int) -> MaskEstimate | None:
    """The mask of a sequence; None without a choice. Raises DatasetError for a mask file that does not fit."""
    camera = sequence.camera
    if choice.file is not None:
        given = read_mask_for(camera, choice.file)
        return MaskEstimate(given.valid, message="; ".join(given.remarks), details=given.about())
    if choice.spec is None:
        return None
    estimator: MaskEstimator = choice.spec.load()(choice.argument)
    found = estimator.estimate(MethodSequence(sequence), seed)
    if found.valid.shape != (camera.height, camera.width):
        raise UnavailableError(f"mask estimator '{choice.spec.name}' returned a mask of shape {found.valid.shape}")
    return found


def read_mask_for(camera: Camera, path: Path) -> MaskFile:
    """A mask picture at the camera's size, or at another size of the same proportions."""
    try:
        return read_mask_file(path, (camera.width, camera.height))
    except DatasetError as error:
        raise UsageError(f"--mask {error}") from None


def apply_mask(
    choice: MaskChoice, sequence: ChosenFrames, seed: int, log: Callable[[str], None], frame_masks: bool = False
) -> MaskRecord | None:
    """Find the mask and hide what it hides from whoever reads ``sequence``; what is said about it, if there is one.

    frame_masks: the reader honours masks of single frames; otherwise what one of them hides is hidden in all.
    An estimator that fails leaves the view as it is.
    """
    begin = time.perf_counter()
    given = sequence.provenance().get("mask")
    record = MaskRecord(choice.source, given.get("file") if isinstance(given, dict) else None)
    if choice.file is not None:
        record.file = choice.file.name
    try:
        found = find_mask(choice, sequence, seed)
    except PanobenchError as error:
        if choice.spec is None:
            raise
        found, record.ok, record.message = None, False, str(error)
    whole = sequence.camera.with_mask(None)
    if found is not None:
        before = sequence.camera.valid_mask()
        record.ok, record.message = found.ok, found.message
        record.details = dict(found.details) or None
        valid = found.valid
        if found.frames and frame_masks:
            sequence.hide_in_frames(found.frames)
            record.frames = len(found.frames)
        elif found.whole is not None:
            valid = found.whole
        elif found.frames:
            valid = valid & np.all(list(found.frames.values()), axis=0)
        if not (before & valid).any():
            raise UsageError(f"--mask: the mask hides all of the view ({choice.source})")
        record.found = _share(whole, before & ~valid)
        sequence.hide(~valid)
    record.hidden = _share(whole, whole.valid_mask() & ~sequence.camera.valid_mask())
    if choice.source:
        record.seconds = round(time.perf_counter() - begin, 3)
        log(f"mask by {choice.source}: {record.message or f'{record.found:.1%} of the view hidden'}")
    if record.hidden:
        log(f"mask: {record.hidden:.1%} of the view hidden in all{f' ({record.file})' if record.file else ''}")
    return record if choice.source or record.hidden else None


def _share(camera: Camera, pixels: NDArray[np.bool_]) -> float:
    """Share of the camera's view, by solid angle."""
    area = camera.solid_angle()
    return round(float(area[pixels].sum() / max(float(area.sum()), 1e-12)), 6)


def moving_record(sequence: ChosenFrames, moving: Mapping[int, Mask]) -> MovingRecord | None:
    """What is said about the masks (H, W) of what a method left out by itself, if it left out anything."""
    camera = sequence.camera.with_mask(None)
    shares = [_share(camera, ~mask) for mask in moving.values()]
    return MovingRecord(len(shares), round(float(np.mean(shares)), 6), max(shares)) if shares else None


def write_masks(folder: Path, renders: Path, sequence: ChosenFrames, moving: Mapping[int, Mask]) -> None:
    """mask.png (white: seen), and ``masks/`` and ``moving/`` with those of single frames, as far as there are any.

    Below ``renders`` the frame of which most is hidden, the middle one if all are alike, with what is hidden drawn red
    and what the method left out (``moving``, False) yellow.
    """
    from panobench.datasets.files.images import write_image

    valid = sequence.camera.valid_mask()
    masks = sequence.frame_masks()
    write_frame_masks(folder / FRAME_MASKS, masks)
    write_frame_masks(folder / MOVING, moving)
    if not valid.all():
        write_image(folder / MASK, np.uint8(valid) * 255)
    every = {index: (masks.get(index), moving.get(index)) for index in {*masks, *moving}}
    most = max(every, key=lambda i: sum(int((~m).sum()) for m in every[i] if m is not None), default=None)
    if most is None and valid.all():
        return
    own, left_out = every.get(most, (None, None)) if most is not None else (None, None)
    hidden = ~valid if own is None else ~(valid & own)
    image = sequence.image(len(sequence) // 2 if most is None else most)
    if left_out is not None:
        image = _tinted(image, ~left_out & ~hidden, MOVING_COLOUR)
    renders.mkdir(exist_ok=True)
    write_image(renders / HIDDEN, _tinted(image, hidden, HIDDEN_COLOUR), quality=88)


def _tinted(image: NDArray[np.uint8], where: Mask, colour: tuple[int, int, int]) -> NDArray[np.uint8]:
    return np.where(where[..., None], 0.45 * image + 0.55 * np.array(colour), image).astype(np.uint8)
