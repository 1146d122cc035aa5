"""The renderer of one camera, and the renders it makes, which differentiate themselves.

    render = Renderer(camera).forward(gaussians, T_wc)
    gradients = render.backward(d_colour)

This is the only door to the kernels. A renderer that is given a device draws there, by ``splat.cuda``, with the same
arguments and results.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numba import get_num_threads
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.kernels.columns import FOOTPRINT_COLUMNS, MOMENT, PARAMETER, PARAMETERS, span
from panobench.splat import binning, blend, chain, project
from panobench.splat.backend import renderer_on
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.view import CONIC_ERP, Projection, View, make_view

if TYPE_CHECKING:
    from panobench.gpu.device import Device

_NO_2D = np.zeros((0, 0), np.float32)


@dataclass
class Gradients:
    """dL/d(parameter) of N Gaussians, and dL/d(pose).

    packed (N, PARAMETERS): the columns of ``ParameterColumns``; its parts also have the names and shapes of
    ``GaussianMap``. pose (6,): dL/dtau for T_cw <- exp(tau) T_cw, tau = (translation, rotation).
    """

    packed: F32
    pose: NDArray[np.float64]

    @property
    def means(self) -> F32:
        return self.packed[:, span(PARAMETER.mean)]

    @property
    def log_scales(self) -> F32:
        return self.packed[:, span(PARAMETER.log_scale)]

    @property
    def quats(self) -> F32:
        return self.packed[:, span(PARAMETER.quat)]

    @property
    def opacity_logits(self) -> F32:
        return self.packed[:, PARAMETER.logit]

    @property
    def colours(self) -> F32:
        return self.packed[:, span(PARAMETER.colour)]


@dataclass(frozen=True)
class _Settings:
    """What all renders of one renderer share; see ``Renderer``.

    wrap: pixels after which a panorama's columns repeat for first-order footprints; 0 where nothing repeats.
    """

    view: View
    low_pass: float
    near: float
    stop: float
    threads: int
    wrap: float


@dataclass
class _Tape:
    """What the backward pass needs of its forward pass. Arrays are in order of depth, as ``Render.order``.

    footprints (M, FOOTPRINT_COLUMNS), starts (tiles + 1,), entries (E,), spans (E, 2), done (tiles,): see ``project``,
    ``bin_tiles`` and ``blend_forward``. sloped: the depth has no gradient.
    """

    settings: _Settings
    gaussians: GaussianMap
    R_cw: NDArray[np.float64]
    t_cw: NDArray[np.float64]
    footprints: F32
    starts: NDArray[np.int64]
    entries: NDArray[np.int32]
    spans: NDArray[np.uint8]
    done: NDArray[np.int32]
    sloped: bool


@dataclass
class Moments:
    """A loss's gradient as far as the image goes: sums per Gaussian, and what the chain rule needs beside them.

    sums (threads, N, MOMENTS): see ``blend_backward``; R_cw (3, 3), t_cw (3,): world to camera; low_pass: pixels^2.
    """

    sums: F32
    gaussians: GaussianMap
    R_cw: NDArray[np.float64]
    t_cw: NDArray[np.float64]
    view: View
    low_pass: float


@dataclass
class Render:
    """What a camera sees of a map.

    w is the blending weight of a Gaussian in a pixel, and dist its distance (radial depth).

    planes (3, H, W): composited colour, of 1. depth (H, W) = sum of w dist. opacity (H, W) = sum of w.
    order (M,) int32: the Gaussians drawn, nearest first. pixel_angle: radians that one pixel spans.
    touched (N,) int32, if asked for: the pixels that each Gaussian reaches while over half of the light still passes.
    weights (N,) float32, if asked for: sum of w over the pixels, that is how many of them each Gaussian makes up.

    A render keeps its map and some 100 bytes per Gaussian drawn for its backward pass; ``detach`` gives them up.
    """

    planes: F32
    depth: F32
    opacity: F32
    touched: NDArray[np.int32] | None
    order: NDArray[np.int32]
    weights: F32 | None
    pixel_angle: float
    _tape: _Tape | None = field(repr=False)

    @property
    def drawn(self) -> int:
        """How many Gaussians are drawn."""
        return len(self.order)

    @property
    def colour(self) -> F32:
        """(H, W, 3) view."""
        return self.planes.transpose(1, 2, 0)

    @property
    def gaussians(self) -> GaussianMap:
        """The map it shows. Raises RuntimeError once detached."""
        if self._tape is None:
            raise RuntimeError("this render was detached: it does not know its map any more")
        return self._tape.gaussians

    def expected_depth(self, opacity_min: float = 0.5) -> F32:
        """Radial depth (H, W) = depth / opacity, NaN where the opacity is below ``opacity_min``."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.opacity >= opacity_min, self.depth / self.opacity, np.nan).astype(np.float32)

    def detach(self) -> Render:
        """The same images without what the backward pass needs: for a render that is kept."""
        return replace(self, _tape=None)

    def backward(
        self, d_colour: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None, *, planar: bool = False
    ) -> Gradients:
        """Gradients for dL/d(output): d_colour (H, W, 3), or (3, H, W) if ``planar``; d_depth, d_opacity (H, W).

        The map must be as it was drawn. Raises ValueError for d_depth on sloped depth, RuntimeError once detached.
        """
        moments = self.moments(d_colour if planar else np.moveaxis(d_colour, -1, 0), d_depth, d_opacity)
        g, view = moments.gaussians, moments.view
        packed = np.zeros((len(g), PARAMETERS), np.float32)
        pose = np.zeros((len(moments.sums), 6))
        chain.parameter_gradients(
            moments.sums, g.means, g.log_scales, g.quats, g.opacity_logits, g.colours, moments.R_cw, moments.t_cw,
            view.projection, view.intrinsics, view.pixel_angle, moments.low_pass, packed, pose,
        )  # fmt: skip
        return Gradients(packed, pose.sum(axis=0))

    def weighted_sums(self, planes: F32) -> F32:
        """(N, 3): for each Gaussian the sums of ``planes`` (3, H, W) over the pixels, times its blending weight there.

        Colours blend linearly, so these are the gradients by the colours for dL/d(planes) = ``planes``.
        """
        return np.asarray(self.moments(planes).sums[:, :, span(MOMENT.colour)].sum(axis=0))

    def moments(self, d_planes: F32, d_depth: F32 | None = None, d_opacity: F32 | None = None) -> Moments:
        """The pixels' half of ``backward``, which raises the same: dL/d(planes) (3, H, W) -> sums per Gaussian."""
        tape = self._tape
        if tape is None:
            raise RuntimeError("this render was detached: it has no backward pass any more")
        if d_depth is not None and tape.sloped:
            raise ValueError("sloped depth has no gradient: render without sloped=True to differentiate depth")
        s = tape.settings
        dc = np.ascontiguousarray(d_planes, dtype=np.float32)
        dd = _NO_2D if d_depth is None else np.ascontiguousarray(d_depth, dtype=np.float32)
        do = _NO_2D if d_opacity is None else np.ascontiguousarray(d_opacity, dtype=np.float32)
        sums = blend.new_moments(s.threads, len(tape.gaussians))
        blend.blend_backward(
            tape.footprints, self.order, tape.starts, tape.entries, tape.spans, s.view.rays, s.wrap, s.view.tiles,
            s.threads, self.planes, self.depth, self.opacity, tape.done, dc, dd, do, sums,
        )  # fmt: skip
        return Moments(sums, tape.gaussians, tape.R_cw, tape.t_cw, s.view, s.low_pass)


class Renderer:
    """Renders Gaussians into one camera. It keeps that camera's tables and nothing of what it rendered.

    projection: "sphere" (exact on the tangent plane, for every camera), "erp" or "pinhole" (first order).
    low_pass: variance added to every footprint, pixels^2. near: Gaussians closer than this are not drawn, in the map's
    unit. stop: transmittance at which a tile is finished. threads: None for Numba's setting; images do not depend on
    their number, gradients only through rounding. device: what draws, None for the CPU. Raises UnsupportedError where
    it cannot draw the camera.
    """

    def __init__(
        self,
        camera: Camera,
        projection: Projection = "sphere",
        low_pass: float = 0.3,
        near: float = 0.01,
        stop: float = 1e-4,
        threads: int | None = None,
        device: Device | None = None,
    ) -> None:
        view = make_view(camera, projection)
        wrap = float(camera.width) if view.projection == CONIC_ERP else 0.0
        self.camera, self.device = camera, device
        self._settings = _Settings(view, low_pass, near, stop, threads or get_num_threads(), wrap)
        self._on_device = renderer_on(device, view, low_pass, near, stop) if device else None

    @property
    def view(self) -> View:
        return self._settings.view

    def forward(
        self,
        gaussians: GaussianMap,
        T_wc: NDArray[np.float64],
        *,
        count_touched: bool = False,
        sloped: bool = False,
        sum_weights: bool = False,
        culled: NDArray[np.bool_] | None = None,
    ) -> Render:
        """Render from camera-to-world pose ``T_wc`` (4, 4).

        count_touched, sum_weights: fill ``touched`` and ``weights``.
        culled (N,): Gaussians that are left out, because they are known to be occluded.
        sloped: across a footprint the depth follows the Gaussian's own surface (its mean distance given the direction;
        compare Zhang et al., "RaDe-GS", 2024), instead of being that of its centre, which is biased to the near side
        where footprints overlap on an oblique wall. Such depth has no backward pass.
        """
        if self._on_device is not None:
            return self._on_device.forward(
                gaussians, T_wc, count_touched=count_touched, sloped=sloped, sum_weights=sum_weights, culled=culled
            )
        s, v, gaussians = self._settings, self.view, gaussians.on_host()
        T_cw = invert_pose(T_wc)
        R_cw, t_cw = np.ascontiguousarray(T_cw[:3, :3]), np.ascontiguousarray(T_cw[:3, 3])
        n = len(gaussians)
        chosen = np.arange(n, dtype=np.int32) if culled is None else np.flatnonzero(~culled).astype(np.int32)
        m = len(chosen)
        footprints, key = np.empty((m, FOOTPRINT_COLUMNS), np.float32), np.empty(m, np.float32)
        rows, cols = np.empty((m, 2), np.int32), np.empty((m, 2), np.int32)
        project.project(
            chosen, gaussians.means, gaussians.log_scales, gaussians.quats, gaussians.opacity_logits, gaussians.colours,
            R_cw, t_cw, v.projection, v.bound, v.intrinsics, v.pixel_angle, s.low_pass, s.near,
            sloped, footprints, rows, cols, key, s.threads,
        )  # fmt: skip
        nearest = binning.radix_order(key)
        footprints, rows, cols = binning.gather(nearest, footprints, rows, cols)
        order = chosen[nearest]
        drawn = np.zeros(v.tiles_x * v.tiles_y, np.bool_)
        drawn[v.tiles] = True
        starts, entries, spans = binning.bin_tiles(
            footprints, rows, cols, v.bound, v.cones, v.column_axes, v.column_half, v.intrinsics, drawn, s.threads
        )
        new = np.empty if len(v.tiles) == v.tiles_x * v.tiles_y else np.zeros
        planes = new((3, v.height, v.width), np.float32)
        depth, opacity = new((v.height, v.width), np.float32), new((v.height, v.width), np.float32)
        done = np.zeros(v.tiles_x * v.tiles_y, np.int32)
        counted = len(order) if count_touched or sum_weights else 0
        counts, sums = np.zeros((s.threads, counted), np.int32), np.zeros((s.threads, counted), np.float32)
        blend.blend_forward(
            footprints, starts, entries, spans, v.rays, s.wrap, s.stop, v.tiles, s.threads,
            planes, depth, opacity, done, counts, sums,
        )  # fmt: skip
        touched, weights = None, None
        if count_touched:
            touched = np.zeros(n, np.int32)
            touched[order] = counts.sum(axis=0)
        if sum_weights:
            weights = np.zeros(n, np.float32)
            weights[order] = sums.sum(axis=0)
        tape = _Tape(s, gaussians, R_cw, t_cw, footprints, starts, entries, spans, done, sloped)
        return Render(planes, depth, opacity, touched, order, weights, v.pixel_angle, tape)
