"""Panoramas of a map, drawn on a device: the counterpart of the Numba kernels behind ``splat.render``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from panobench.geometry import invert_pose
from panobench.gpu.device import Device, blocks_of, download
from panobench.kernels.columns import MOMENT, PARAMETERS, span
from panobench.splat.cuda.gaussians import DeviceGaussians
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.render import Gradients, Render
from panobench.splat.view import BOUND_LATLON, SPHERE, TILE_W, View

if TYPE_CHECKING:
    from panobench.splat.adam import Target

#: Floats in a row of moments; see ``MOMENT_ROW`` in vectors.cu.
_MOMENT_ROW = 16
#: Tile numbers are 16 bit.
_MOST_TILES = 1 << 15
#: Narrower panoramas have columns of tiles that one tangent plane cannot hold.
_LEAST_WIDTH = 64
_THREADS, _WARPS = 256, 8
_NOT_DRAWN = 0x7FFFFFFF
#: Threads of a block, and most blocks, of kernels that go through all Gaussians and add up what they say of the pose.
_CHAIN_THREADS, _CHAIN_BLOCKS = 128, 1056


def why_not(view: View) -> str:
    """Why a view cannot be drawn on a device, in words; "" if it can."""
    if view.projection != SPHERE or view.bound != BOUND_LATLON:
        return "it draws panoramas on the sphere only"
    if view.width < _LEAST_WIDTH or view.tiles_x * view.tiles_y > _MOST_TILES:
        return f"it draws panoramas from {_LEAST_WIDTH}x{_LEAST_WIDTH // 2} to 4096x2048"
    return ""


def chain_blocks(n: int) -> tuple[int, int]:
    """Blocks and threads for a kernel that goes through n Gaussians."""
    return min(blocks_of(n, _CHAIN_THREADS), _CHAIN_BLOCKS), _CHAIN_THREADS


@dataclass
class Tape:
    """What the backward pass needs, as tensors; see ``project.cu`` and ``blend.cu``."""

    device: Device
    view: View
    rays: Tensor
    tiles: Tensor
    camera: Tensor
    gaussians: DeviceGaussians
    packed: Tensor
    starts: Tensor
    ends: Tensor
    entries: Tensor
    used: Tensor
    sloped: bool


class DeviceRender(Render):
    """A render that stays on the device; its arrays are copied to the host on first use.

    images (5, H, W): colour, depth and opacity.
    """

    def __init__(
        self, images: Tensor, order: Tensor, drawn: int, touched: Tensor | None, weights: Tensor | None, tape: Tape
    ) -> None:
        self.images, self.pixel_angle = images, tape.view.pixel_angle
        self._order, self._drawn, self._touched, self._weights = order, drawn, touched, weights
        self.tape = tape

    def __getattr__(self, name: str) -> Any:
        if name in ("planes", "depth", "opacity"):
            host = download(self.images)
            self.__dict__.update(planes=host[:3], depth=host[3], opacity=host[4])
        elif name == "order":
            self.__dict__["order"] = download(self._order[: self._drawn]).astype(np.int32)
        elif name in ("touched", "weights"):
            tensor = self.__dict__["_" + name]
            self.__dict__[name] = None if tensor is None else download(tensor)
        else:
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")
        return self.__dict__[name]

    @property
    def drawn(self) -> int:
        return self._drawn

    def detach(self) -> Render:
        return Render(
            self.planes, self.depth, self.opacity, self.touched, self.order, self.weights, self.pixel_angle, None
        )

    def backward(
        self, d_colour: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None, *, planar: bool = False
    ) -> Gradients:
        t, n = self.tape, len(self.tape.gaussians)
        sums = self.sums(d_colour if planar else np.moveaxis(d_colour, -1, 0), d_depth, d_opacity)
        packed, pose = t.device.empty(n, PARAMETERS), t.device.zeros(6, dtype=torch.float64)
        means, log_scales, quats, _, _ = t.gaussians.tensors
        t.device.launch(
            "parameter_gradients", *chain_blocks(n), n, means, log_scales, quats, t.packed, t.camera, sums, packed, pose
        )
        return Gradients(download(packed), download(pose))

    def weighted_sums(self, planes: F32) -> F32:
        return download(self.sums(planes)[:, span(MOMENT.colour)].contiguous())

    def sums(self, d_planes: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None) -> Tensor:
        """``moments`` as a tensor (N, 16) on the device: of the scaled offset, see ``blend.cu``."""
        if d_depth is not None and self.tape.sloped:
            raise ValueError("sloped depth has no gradient: render without sloped=True to differentiate depth")
        upload = self.tape.device.upload
        planes = upload(np.asarray(d_planes, dtype=np.float32))
        if d_depth is None and d_opacity is None:
            return self.sums_on_device(planes)
        zero = self.tape.device.zeros(self.tape.view.height, self.tape.view.width)
        depth = zero if d_depth is None else upload(np.asarray(d_depth, dtype=np.float32))
        opacity = zero if d_opacity is None else upload(np.asarray(d_opacity, dtype=np.float32))
        return self.sums_on_device(planes, (depth, opacity))

    def sums_on_device(self, d_planes: Tensor, deep: tuple[Tensor, Tensor] | None = None) -> Tensor:
        """As ``sums``, of tensors. deep: dL/d(depth) and dL/d(opacity)."""
        t = self.tape
        out = t.device.zeros(len(t.gaussians), _MOMENT_ROW)
        t.device.launch(
            "backward_deep" if deep else "backward", len(t.tiles), _THREADS, t.tiles, t.starts, t.ends, t.entries,
            t.packed, t.rays, t.camera, t.view.width, t.view.height, self.images[:3], self.images[3], self.images[4],
            t.used, d_planes, *(deep or ()), out,
        )  # fmt: skip
        return out

    def loss_on_device(self, target: Target, image: Tensor, weights: Tensor) -> tuple[Tensor, Tensor]:
        """The sums (3,) of loss, dL/d(gain) and dL/d(offset), and dL/d(planes) (3, H, W)."""
        t, pixels = self.tape, self.tape.view.width * self.tape.view.height
        gradient, sums = t.device.empty(3, t.view.height, t.view.width), t.device.zeros(3, dtype=torch.float64)
        t.device.launch(
            "photometric_loss", blocks_of(pixels), _THREADS, pixels, self.images[:3],
            None if target.opaque is None else self.images[4], float(target.opaque or 0.0), image, weights,
            math.exp(target.gain), float(target.offset), float(target.knee), gradient, sums,
        )  # fmt: skip
        return sums, gradient


class DeviceRenderer:
    """Draws panoramas on a device; the arguments are those of ``Renderer``, and ``view`` must be one it can draw."""

    def __init__(self, device: Device, view: View, low_pass: float, near: float, stop: float) -> None:
        self.device, self.view, self.near, self.stop = device, view, near, stop
        self._low = low_pass * view.pixel_angle**2
        self._rays, self._tiles = device.upload(view.rays), device.upload(view.tiles)

    def _camera(self, T_wc: NDArray[np.float64]) -> Tensor:
        """What kernels need of the camera; see ``vectors.cu``."""
        T_cw, pixel = invert_pose(T_wc), 2 * math.pi / self.view.width
        values = [*T_cw[:3, :3].ravel(), *T_cw[:3, 3], self._low, self.near, self.stop]
        for width in (TILE_W, TILE_W // 2):  # a little slack, as in View.column_half
            half = 1.002 * math.tan(0.5 * (width - 1) * pixel)
            values += [half, 1 / math.hypot(1, half)]
        return self.device.upload(np.array(values, dtype=np.float32))

    def forward(
        self,
        gaussians: GaussianMap,
        T_wc: NDArray[np.float64],
        *,
        count_touched: bool = False,
        sloped: bool = False,
        sum_weights: bool = False,
        culled: NDArray[np.bool_] | None = None,
    ) -> DeviceRender:
        """As ``Renderer.forward``. A map of the host is copied to the device first."""
        d, v = self.device, self.view
        g, camera = DeviceGaussians.of(gaussians, d), self._camera(T_wc)
        n, W, H = len(g), v.width, v.height
        packed, box = d.empty(n, 16), d.empty(n, 2, dtype=torch.int32)
        key, count = d.empty(n, dtype=torch.int32), d.empty(n, dtype=torch.int32)
        slopes = d.empty(n, 2) if sloped else None
        d.launch(
            "project", blocks_of(n), _THREADS, n, *g.tensors, None if culled is None else d.upload(culled), camera,
            W, H, packed, slopes, box, key, count,
        )  # fmt: skip
        order = torch.sort(key, stable=True)[1]
        drawn, starts, ends, entries = self._lists(g, camera, packed, box, key, count, order)
        images = (d.empty if len(v.tiles) == v.tiles_x * v.tiles_y else d.zeros)(5, H, W)
        used = d.empty(v.tiles_x * v.tiles_y, _WARPS, dtype=torch.int32)
        touched = d.zeros(n, dtype=torch.int32) if count_touched else None
        weights = d.zeros(n) if sum_weights else None
        measured = sloped or count_touched or sum_weights
        d.launch(
            "forward_measured" if measured else "forward", len(v.tiles), _THREADS, self._tiles, starts, ends, entries,
            packed, self._rays, camera, W, H, images[:3], images[3], images[4], used,
            *((slopes, touched, weights) if measured else ()),
        )  # fmt: skip
        tape = Tape(d, v, self._rays, self._tiles, camera, g, packed, starts, ends, entries, used, sloped)
        return DeviceRender(images, order, drawn, touched, weights, tape)

    def _lists(
        self, g: DeviceGaussians, camera: Tensor, packed: Tensor, box: Tensor, key: Tensor, count: Tensor, order: Tensor
    ) -> tuple[int, Tensor, Tensor, Tensor]:
        """How many Gaussians are drawn; where each tile's entries begin and end, and the Gaussians in them.

        One sort of N distances, then a stable sort of the entries by their tile's number of 16 bits.
        """
        d, v, n = self.device, self.view, len(g)
        bounds = d.zeros(2, v.tiles_x * v.tiles_y, dtype=torch.int32)
        if n == 0:
            return 0, bounds[0], bounds[1], d.empty(0, dtype=torch.int32)
        sums = torch.cumsum(count[order], 0, dtype=torch.int32)
        total, drawn = torch.stack([sums[-1].long(), (key != _NOT_DRAWN).sum()]).tolist()
        tile, owner = d.empty(total, dtype=torch.int16), d.empty(total, dtype=torch.int32)
        d.launch(
            "list_tiles", blocks_of(n), _THREADS, n, order, sums, packed, box, key, camera, v.width, v.height, total,
            tile, owner,
        )  # fmt: skip
        tile, permutation = torch.sort(tile, stable=True)
        entries = d.empty(total, dtype=torch.int32)
        d.launch(
            "tile_ranges", blocks_of(total), _THREADS, total, tile, permutation, owner, bounds[0], bounds[1], entries
        )
        return drawn, bounds[0], bounds[1], entries
