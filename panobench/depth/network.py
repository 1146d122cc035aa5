"""Depth of the first frame by a neural network: the user's, or the one that comes with the package.

The network gets a panorama, whatever the camera; the parts that the camera does not see are black. Its output is
converted to radial distance and reprojected to the camera's pixels.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.reproject import sample_depth
from panobench.depth.base import DepthEstimator
from panobench.depth.network_description import NetworkDescription, description_path, read_description
from panobench.depth.network_input import NetworkView, normalised
from panobench.depth.network_model import ONNX_SUFFIXES, NetworkModel, check_loadable, load_model
from panobench.depth.onnx_file import check_contents, read_contents
from panobench.errors import InputError, UsageError
from panobench.types import DepthEstimate, Frame

F32 = NDArray[np.float32]
#: Depth that is known up to scale only is scaled to this median, as in ``bootstrap``.
MEDIAN_DEPTH = 2.0
#: Least share of the view that must have a usable value.
LEAST_KNOWN = 0.5
#: z depth is divided by the cosine to the optical axis only where the cosine exceeds this.
LEAST_COSINE = 0.05


class NetworkDepth(DepthEstimator):
    """``network:FILE``: an ONNX or TorchScript file with a description beside it."""

    def __init__(self, argument: str = "") -> None:
        super().__init__(argument)
        self.path = self._file()
        check_loadable(self.path)
        self.description = read_description(self.path)

    def _file(self) -> Path:
        if not self.argument or "\0" in self.argument:
            raise UsageError("--depth network:FILE needs an ONNX or TorchScript file")
        return Path(self.argument).expanduser()

    def start(self, camera: Camera, seed: int = 0) -> None:
        """Load the network. Raises InputError, UsageError or UnavailableError if that fails."""
        self._view = _DepthView(camera, self.description)
        self._model: NetworkModel | None = load_model(self.path, self.description)

    def add(self, frame: Frame) -> DepthEstimate:
        """Raises InputError if the output is no depth map."""
        if self._model is None:
            self._model = load_model(self.path, self.description)
        d = self.description
        answer = self._model(normalised(self._view.network_image(frame.image), d))
        self._model = None  # free its memory and threads
        depth = self._view.camera_depth(answer)
        known = np.isfinite(depth)
        valid = self._view.valid
        share = float(known[valid].mean()) if valid.any() else 0.0
        if share < LEAST_KNOWN:
            raise InputError(
                f"the network's output is NaN, infinite, not positive or beyond 'far' in {1 - share:.0%} of the view; "
                "check range, mean, std and meaning in its description",
                self.path,
            )
        depth[~valid] = np.nan
        if not d.metric:
            depth *= np.float32(MEDIAN_DEPTH / float(np.nanmedian(depth)))
        return DepthEstimate(depth, frame.index, metric=d.metric, message=f"network {self.path.name}")


class RoomsNetDepth(NetworkDepth):
    """``rooms-net``: the small network that scripts/train_rooms_net.py trains; it comes with the package."""

    def _file(self) -> Path:
        return Path(__file__).parent / "weights" / "rooms-net.onnx"


def network_files(argument: str) -> list[Path]:
    """The files that ``network:FILE`` depends on, with the weights that an ONNX file keeps beside itself."""
    return _files(NetworkDepth(argument).path)


def rooms_net_files(argument: str) -> list[Path]:
    """The files that ``rooms-net`` depends on."""
    return _files(RoomsNetDepth(argument).path)


def _files(network: Path) -> list[Path]:
    beside: list[Path] = []
    if network.suffix.lower() in ONNX_SUFFIXES:
        check_contents(network)
        beside = [network.parent / name for name in sorted(read_contents(network).external)]
    return [network, description_path(network), *beside]


class _DepthView(NetworkView):
    """Also turns the network's output into the camera's depth."""

    def __init__(self, camera: Camera, d: NetworkDescription) -> None:
        super().__init__(camera, d)
        self.d: NetworkDescription = d

    def camera_depth(self, answer: F32) -> F32:
        """Output (h, w) -> radial distance at the camera's pixels (H, W), NaN where the output is not usable."""
        h, w = answer.shape
        distance = _positive(answer, self.d)
        if self.back is not None:
            if (h, w) != (self.d.height, self.d.width):
                distance = _resized(distance, self.d.width, self.d.height)
            assert self.there is not None
            distance[~self.there.valid] = np.nan  # predictions for the black parts
            depth = self.back.depth(distance)
        else:
            depth = _resized(distance, self.camera.width, self.camera.height)
            if self.d.meaning.endswith("z"):
                cosine = self.camera.rays()[..., 2]
                with np.errstate(invalid="ignore"):
                    depth = np.where(cosine > LEAST_COSINE, depth / cosine, np.nan)
        depth = (depth * np.float32(self.d.scale)).astype(np.float32)
        depth[~(depth <= self.d.far)] = np.nan
        return depth


def _positive(answer: F32, d: NetworkDescription) -> F32:
    """Distance or z from the output by its meaning; NaN where that is not finite and positive."""
    with np.errstate(all="ignore"):
        if d.meaning.startswith("inverse"):
            out = 1.0 / answer
        elif d.meaning == "log-distance":
            out = np.exp(answer)
        else:
            out = answer.copy()
    out = np.asarray(out, dtype=np.float32)
    out[~(np.isfinite(out) & (out > 0) & (out < 1e6))] = np.nan
    return out


def _resized(depth: F32, width: int, height: int) -> F32:
    """Depth at another size by edge-aware interpolation; pixel centres are at k + 0.5."""
    h, w = depth.shape
    x = np.clip((np.arange(width) + 0.5) * w / width - 0.5, 0, w - 1).astype(np.float32)
    y = np.clip((np.arange(height) + 0.5) * h / height - 0.5, 0, h - 1).astype(np.float32)
    columns, rows = np.meshgrid(x, y)
    return sample_depth(depth, columns, rows, "edge-aware")
