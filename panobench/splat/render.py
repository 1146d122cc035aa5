"""The renderer: one camera, its buffers, forward and backward. The only door to the kernels.

A GPU backend replaces ``project``, ``bin_tiles``, ``blend_forward``, ``blend_backward`` and
``parameter_gradients`` behind the same class.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.splat import binning, blend, chain, project
from panobench.splat.block import PARAMETERS
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.kernel_options import PACK
from panobench.splat.view import CONIC_ERP, Projection, View, make_view

#: Columns of the moments that belong to the colours.
_COLOURS = slice(8, 11)
_NO_2D = np.zeros((0, 0), np.float32)


@dataclass
class RenderOutput:
    """planes (3, H, W) composited colour; depth (H, W) = sum of w dist; opacity (H, W) = sum of w.

    touched (N,) int32: pixels each Gaussian reaches while over half of the light still passes (if asked for).
    order (M,) int32: the Gaussians drawn, nearest first. weights (N,) float32: sum of w over the pixels, that is how
    many of them each Gaussian makes up (if asked for).
    """

    planes: F32
    depth: F32
    opacity: F32
    touched: NDArray[np.int32] | None
    order: NDArray[np.int32]
    weights: F32 | None = None

    @property
    def colour(self) -> F32:
        """(H, W, 3) view."""
        return self.planes.transpose(1, 2, 0)

    def expected_depth(self, opacity_min: float = 0.5) -> F32:
        """Radial depth (H, W) = depth / opacity, NaN where the opacity is below ``opacity_min``."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.opacity >= opacity_min, self.depth / self.opacity, np.nan).astype(np.float32)


@dataclass
class Gradients:
    """dL/d(parameter). ``packed`` (N, 14) holds means, log_scales, quats, opacity_logits, colours side by side.

    pose (6,): dL/dtau for T_cw <- exp(tau) T_cw, tau = (translation, rotation).
    """

    packed: F32
    pose: NDArray[np.float64]

    @property
    def means(self) -> F32:
        return self.packed[:, 0:3]

    @property
    def log_scales(self) -> F32:
        return self.packed[:, 3:6]

    @property
    def quats(self) -> F32:
        return self.packed[:, 6:10]

    @property
    def opacity_logits(self) -> F32:
        return self.packed[:, 10]

    @property
    def colours(self) -> F32:
        return self.packed[:, 11:14]


@dataclass
class Backward:
    """What the chain rule needs: the Gaussians, their camera, and moments (threads, N, MOMENTS)."""

    gaussians: GaussianMap
    R_cw: NDArray[np.float64]
    t_cw: NDArray[np.float64]
    view: View
    moments: F32


@dataclass
class _Scene:
    """What ``backward`` needs of the last forward pass."""

    gaussians: GaussianMap
    R_cw: NDArray[np.float64]
    t_cw: NDArray[np.float64]
    packed: F32
    starts: NDArray[np.int64]
    entries: NDArray[np.int32]
    spans: NDArray[np.uint8]
    done: NDArray[np.int32]
    tiles: NDArray[np.int32]
    out: RenderOutput
    sloped: bool


class Renderer:
    """Renders Gaussians into one camera.

    projection: "sphere" (exact on the tangent plane, every camera), "erp" or "pinhole" (first order).
    low_pass: variance added to every footprint, in pixels^2. near: Gaussians closer than this are not drawn. stop:
    transmittance at which a tile is finished. threads: None uses Numba's setting; results agree between
    thread counts to rounding.
    """

    def __init__(
        self,
        camera: Camera,
        projection: Projection = "sphere",
        low_pass: float = 0.3,
        near: float = 0.01,
        stop: float = 1e-4,
        threads: int | None = None,
    ) -> None:
        self.camera = camera
        self.view = make_view(camera, projection)
        self.low_pass, self.near, self.stop = low_pass, near, stop
        self.threads = threads or get_num_threads()
        self._wrap = float(camera.width) if self.view.projection == CONIC_ERP else 0.0
        self._scene: _Scene | None = None

    def forward(
        self,
        gaussians: GaussianMap,
        T_wc: NDArray[np.float64],
        *,
        count_touched: bool = False,
        sloped: bool = False,
        weigh: bool = False,
        hidden: NDArray[np.bool_] | None = None,
        tiles: NDArray[np.int32] | None = None,
    ) -> RenderOutput:
        """Render from camera-to-world pose ``T_wc``, in all tiles with valid pixels or in these ``tiles`` (others stay
        black).

        ``hidden`` (N,): Gaussians that are left out, because they are known to lie behind others.

        ``sloped``: depth follows each Gaussian's own surface across its footprint instead of being its centre's
        everywhere, which is biased to the near side where footprints overlap on an oblique wall (the mean of
        distance given direction; compare Zhang et al., "RaDe-GS", 2024). Such depth has no backward pass.
        """
        v = self.view
        T_cw = invert_pose(T_wc)
        R_cw, t_cw = np.ascontiguousarray(T_cw[:3, :3]), np.ascontiguousarray(T_cw[:3, 3])
        n = len(gaussians)
        packed, key = np.empty((n, PACK), np.float32), np.empty(n, np.float32)
        rows, cols = np.empty((n, 2), np.int32), np.empty((n, 2), np.int32)
        project.project(
            gaussians.means, gaussians.log_scales, gaussians.quats, gaussians.opacity_logits, gaussians.colours,
            R_cw, t_cw, v.projection, v.bound, v.intrinsics, v.pixel_angle, self.low_pass, self.near,
            sloped, packed, rows, cols, key, self.threads,
        )  # fmt: skip
        if hidden is not None:
            key[hidden] = -1.0
        order = binning.radix_order(key)
        packed, rows, cols = binning.gather(order, packed, rows, cols)
        tiles = v.tiles if tiles is None else tiles
        drawn = np.zeros(v.tiles_x * v.tiles_y, np.bool_)
        drawn[tiles] = True
        starts, entries, spans = binning.bin_tiles(
            packed, rows, cols, v.bound, v.cones, v.column_axes, v.column_half, v.intrinsics, drawn, self.threads
        )
        new = np.empty if len(tiles) == v.tiles_x * v.tiles_y else np.zeros
        planes = new((3, v.height, v.width), np.float32)
        depth, opacity = new((v.height, v.width), np.float32), new((v.height, v.width), np.float32)
        done = np.zeros(v.tiles_x * v.tiles_y, np.int32)
        counts = np.zeros((self.threads, len(order) if count_touched else 0), np.int32)
        sums = np.zeros((self.threads, len(order) if weigh else 0), np.float32)
        blend.blend_forward(
            packed, starts, entries, spans, v.rays, self._wrap, self.stop, tiles, self.threads,
            planes, depth, opacity, done, counts, sums,
        )  # fmt: skip
        touched, weights = None, None
        if count_touched:
            touched = np.zeros(n, np.int32)
            touched[order] = counts.sum(axis=0)
        if weigh:
            weights = np.zeros(n, np.float32)
            weights[order] = sums.sum(axis=0)
        out = RenderOutput(planes, depth, opacity, touched, order, weights)
        self._scene = _Scene(gaussians, R_cw, t_cw, packed, starts, entries, spans, done, tiles, out, sloped)
        return out

    def backward(
        self, d_colour: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None, *, planar: bool = False
    ) -> Gradients:
        """Gradients of the last ``forward`` for dL/d(output). d_colour (H, W, 3), or (3, H, W) if ``planar``."""
        s, v = self._scene, self.view
        if s is None:
            raise RuntimeError("backward() needs a forward() first")
        if d_depth is not None and s.sloped:
            raise ValueError("sloped depth has no gradient: render without sloped=True to differentiate depth")
        dc = np.ascontiguousarray(d_colour if planar else np.moveaxis(d_colour, -1, 0), dtype=np.float32)
        back = self.moments(dc, d_depth, d_opacity)
        g = back.gaussians
        packed = np.zeros((len(g), PARAMETERS), np.float32)
        pose = np.zeros((self.threads, 6))
        chain.parameter_gradients(
            back.moments, g.means, g.log_scales, g.quats, g.opacity_logits, g.colours,
            back.R_cw, back.t_cw, v.projection, v.intrinsics, v.pixel_angle, self.low_pass, packed, pose,
        )  # fmt: skip
        return Gradients(packed, pose.sum(axis=0))

    def weighted_sums(self, planes: F32) -> F32:
        """(N, 3): for each Gaussian of the last ``forward`` the sums of ``planes`` (3, H, W) over the pixels it
        colours, times what it contributes there (colours blend linearly: these are gradients by the colours).
        """
        return np.asarray(self.moments(planes).moments[:, :, _COLOURS].sum(axis=0))

    def moments(self, d_planes: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None) -> Backward:
        """The pixels' half of the backward pass: dL/d(planes) (3, H, W) -> moment sums per Gaussian."""
        s, v = self._scene, self.view
        if s is None:
            raise RuntimeError("a backward pass needs a forward() first")
        dc = np.ascontiguousarray(d_planes, dtype=np.float32)
        dd = _NO_2D if d_depth is None else np.ascontiguousarray(d_depth, dtype=np.float32)
        do = _NO_2D if d_opacity is None else np.ascontiguousarray(d_opacity, dtype=np.float32)
        moments = blend.new_moments(self.threads, len(s.gaussians))
        blend.blend_backward(
            s.packed, s.out.order, s.starts, s.entries, s.spans, v.rays, self._wrap, s.tiles, self.threads,
            s.out.planes, s.out.depth, s.out.opacity, s.done, dc, dd, do, moments,
        )  # fmt: skip
        return Backward(s.gaussians, s.R_cw, s.t_cw, v, moments)
