"""``network:FILE``: a segmentation network of the user's says which pixels do not show the scene, frame by frame.

It sees every frame, so that people who walk through the scene are hidden too. Geometry alone finds what moves with the
camera; a network finds what it was trained on, whether it moves or not.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.depth.network_description import (
    NetworkInput,
    described,
    description_path,
    finite,
    one_of,
    read_values,
)
from panobench.depth.network_input import NetworkView, normalised
from panobench.depth.network_model import ONNX_SUFFIXES, NetworkModel, check_loadable, load_model
from panobench.depth.onnx_file import check_contents, read_contents
from panobench.errors import InputError, UsageError
from panobench.masks.base import MaskEstimate, MaskEstimator
from panobench.masks.frame_masks import FrameMasks

Mask = NDArray[np.bool_]
#: What the output's values mean: a score for each class, the number of a class, or how likely a pixel is to be hidden.
MEANINGS = ("scores", "labels", "likelihood")
#: What is hidden in this share of the frames moves with the camera, and is hidden in all of them.
ALWAYS = 0.9
#: Share of a pixel that must be hidden for the pixel to be.
PART = 0.3


@dataclass(frozen=True)
class MaskNetworkDescription(NetworkInput):
    """Input and output of a segmentation network.

    meaning: see MEANINGS. hidden: numbers of the classes that are hidden, of scores or labels. above: of a likelihood,
    from which a pixel is hidden. widen_deg: what was found is widened by this angle.
    """

    meaning: str = "likelihood"
    hidden: tuple[int, ...] = ()
    above: float = 0.5
    widen_deg: float = 1.0


class NetworkMask(MaskEstimator):
    """``network:FILE``: an ONNX or TorchScript file with a description beside it."""

    def __init__(self, argument: str = "") -> None:
        """Raises UsageError, InputError or UnavailableError for what cannot be used."""
        super().__init__(argument)
        if not argument or "\0" in argument:
            raise UsageError("--mask network:FILE needs an ONNX or TorchScript file")
        self.path = Path(argument).expanduser()
        check_loadable(self.path)
        values = read_values(self.path, "docs/masks.md")
        self.description = check_mask_description(values, description_path(self.path))

    def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
        """Raises InputError for an output that is no mask, and what reading the sequence raises."""
        camera, model = sequence.camera, load_model(self.path, self.description)
        view = _MaskView(camera, self.description)
        found, count = FrameMasks(), np.zeros((camera.height, camera.width), np.int32)
        for index in range(len(sequence)):
            tensor = normalised(view.network_image(sequence.image(index)), self.description)
            hidden = view.camera_mask(self._hidden(model, tensor))
            count += hidden
            found.put(index, ~hidden)
        always = count >= ALWAYS * len(sequence)
        frames, shares = FrameMasks(), []
        for index, visible in found.items():
            if (~visible & ~always & view.valid).any():
                frames.put(index, visible)
            shares.append(float((~visible & view.valid).sum()) / max(int(view.valid.sum()), 1))
        message = f"{self.path.name} hides {np.mean(shares):.1%} of the pixels of a frame, {max(shares):.1%} at most"
        return MaskEstimate(view.valid & ~always, frames, message=message, details={"frames": len(frames)})

    def _hidden(self, model: NetworkModel, tensor: NDArray[np.float32]) -> Mask:
        """(h, w) of the network's output: what is not to be seen."""
        d, answer = self.description, model.output(tensor)
        if d.meaning == "scores":
            if answer.ndim != 3 or max(d.hidden) >= answer.shape[0]:
                raise InputError(
                    f"output '{d.output}' has shape {answer.shape}; scores are one picture for each class, and "
                    f"class {max(d.hidden)} is hidden",
                    self.path,
                )
            answer = answer.argmax(axis=0)
        elif answer.ndim != 2:
            raise InputError(f"output '{d.output}' has shape {answer.shape}; one value a pixel is needed", self.path)
        model.check_aspect(answer)
        if d.meaning == "likelihood":
            return np.asarray(answer > d.above)
        return np.isin(np.rint(answer).astype(np.int64), d.hidden)


class _MaskView(NetworkView):
    """Also turns the network's output into the camera's mask."""

    def __init__(self, camera: Camera, d: MaskNetworkDescription) -> None:
        super().__init__(camera, d)
        pixel = 2 * np.pi / d.width
        if self.back is None:
            pixel = float(np.sqrt(camera.solid_angle().max())) * camera.width / d.width
        self._widen = round(np.radians(d.widen_deg) / pixel)

    def camera_mask(self, hidden: Mask) -> Mask:
        """(h, w) of the network -> (H, W) of the camera, widened."""
        size = (self.d.width, self.d.height)
        wide = cv2.resize(hidden.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
        k = self._widen
        if k:
            if self.back is not None:  # over the seam
                wide = np.concatenate([wide[:, -k:], wide, wide[:, :k]], axis=1)
            disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * k + 1, 2 * k + 1))
            wide = cv2.dilate(wide, disc)
            wide = np.ascontiguousarray(wide[:, k:-k]) if self.back is not None else wide
        if self.back is not None:
            return np.asarray(self.back.image(np.asarray(wide, np.float32)) > PART)
        camera_size = (self.camera.width, self.camera.height)
        return np.asarray(cv2.resize(wide, camera_size, interpolation=cv2.INTER_LINEAR) > PART)


def check_mask_description(values: Any, path: Path) -> MaskNetworkDescription:
    """A description from plain values. Raises InputError for missing, unknown or impossible values."""
    d = described(MaskNetworkDescription, values, path, _CHECKS)
    if d.meaning != "likelihood" and not d.hidden:
        raise InputError("'hidden' is missing: the numbers of the classes that are hidden, [11] say", path)
    return d


def network_files(argument: str) -> list[Path]:
    """The files that ``network:FILE`` depends on, with the weights that an ONNX file keeps beside itself."""
    network = NetworkMask(argument).path
    beside: list[Path] = []
    if network.suffix.lower() in ONNX_SUFFIXES:
        check_contents(network)
        beside = [network.parent / name for name in sorted(read_contents(network).external)]
    return [network, description_path(network), *beside]


def _classes(key: str, value: Any, path: Path) -> tuple[int, ...]:
    numbers = value if isinstance(value, list) else [value]
    if not numbers or any(isinstance(n, bool) or not isinstance(n, int) or not 0 <= n < 1 << 16 for n in numbers):
        raise InputError(f"{key} must be numbers of classes, [11, 13] say, not {value!r}", path)
    return tuple(numbers)


def _angle(key: str, value: Any, path: Path) -> float:
    number = finite(key, value, path)
    if not 0 <= number <= 20:
        raise InputError(f"{key} must be an angle from 0 to 20 degrees, not {value!r}", path)
    return number


_CHECKS = {"meaning": one_of(*MEANINGS), "hidden": _classes, "above": finite, "widen_deg": _angle}
