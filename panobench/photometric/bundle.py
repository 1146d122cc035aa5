"""Photometric bundle adjustment: poses of frames and depths of a reference's pixels, refined together.

Refining poses and depths in alternation creeps along the directions in which both compensate each other, such as a
rotation of all frames against a tilt of the whole scene; solving for both at once does not. Each pixel has a single
unknown, its log depth, which the Schur complement eliminates (Engel et al., "Direct sparse odometry", 2018, without
its sliding window). The scale of the scene is a free gauge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.geometry import renormalise, se3_exp
from panobench.photometric.bundle_kernels import residuals
from panobench.photometric.lens_centres import UNITS, origins_of
from panobench.photometric.pyramid import F32

#: Runs of pixels that are summed separately. They do not depend on the number of threads, and so neither do the sums.
_RUNS = 8
#: An iteration that lowers the cost by less than this share is the last.
_CONVERGED = 1e-4
#: Iterations with the nearest frames alone, and before the pixels that fit worst are left out.
_NEAR_ITERATIONS, _BEFORE_TRIMMING = 6, 2
#: Share of the frames, over those that see the best seen pixel, that must see one for it to be told how it fits.
_SEEN_MIN = 0.15
Pose = NDArray[np.float64]


@dataclass(frozen=True)
class BundleOptions:
    """Options of ``refine``. Residuals are of 1, the range of luma.

    cell_px: one pixel, that with the largest gradient, is selected in each cell of this size.
    gradient_min: least gradient of a selected pixel, of 1 per pixel.
    latitude_limit_deg, depth_edge: as in ``AlignOptions``.
    iterations: most iterations of Levenberg-Marquardt.
    huber, cut: Huber's threshold, and the residual above which a pixel does not count (an occlusion, say); both in
    robust standard deviations of the residuals at the start.
    sigma_min: least standard deviation assumed, of 1.
    trim: share of the pixels, those that fit worst, that is left out.
    near: this many nearest frames are adjusted alone first; 0 for none.
    """

    cell_px: int = 3
    gradient_min: float = 0.01
    latitude_limit_deg: float = 75.0
    iterations: int = 15
    huber: float = 1.0
    cut: float = 20.0
    sigma_min: float = 0.002
    depth_edge: float = 1.1
    trim: float = 0.0
    near: int = 0


@dataclass(frozen=True)
class Bundle:
    """The result of ``refine``.

    T_fr (F, 4, 4): refined poses, frame from reference camera, at the scale of the depth given. cost: mean robust cost,
    inf if nothing could be refined.
    information (6F, 6F), gradient (6F,): what is left of the cost once the depths are eliminated: a quadratic over left
    twists (translation, rotation) of T_fr, in units of the residuals' variance. A common scale of all translations
    does not change it.
    units: of a rig, how many units of the map a metre has and the standard deviation of that, infinite where nothing
    tells it. Half of a residual's variance is that of the reference's pixel, which all frames share; the rest is
    independent. None for one centre.
    """

    T_fr: NDArray[np.float64]
    cost: float
    information: NDArray[np.float64]
    gradient: NDArray[np.float64]
    units: tuple[float, float] | None = None

    @property
    def ok(self) -> bool:
        return bool(np.isfinite(self.cost))


def select_pixels(
    luma: F32, rays: F32, depth: F32, options: BundleOptions
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns (n,) of the pixel with the largest gradient in each cell; luma, depth (H, W), rays (H, W, 3)."""
    gx = 0.5 * (np.roll(luma, -1, axis=1) - np.roll(luma, 1, axis=1))
    gy = np.zeros_like(luma)
    gy[1:-1] = 0.5 * (luma[2:] - luma[:-2])
    strength = np.nan_to_num(np.hypot(gx, gy))
    usable = np.isfinite(luma) & np.isfinite(depth) & (depth > 0)
    usable &= np.abs(rays[..., 1]) < np.sin(np.deg2rad(options.latitude_limit_deg))
    strength = np.where(usable & (strength >= options.gradient_min), strength, 0)
    near, far = cv2.erode(depth, np.ones((3, 3))), cv2.dilate(depth, np.ones((3, 3)))
    strength = np.where(far < options.depth_edge * near, strength, 0)
    c = options.cell_px
    h, w = luma.shape[0] // c * c, luma.shape[1] // c * c
    cells = strength[:h, :w].reshape(h // c, c, w // c, c).transpose(0, 2, 1, 3).reshape(h // c, w // c, c * c)
    best, top = cells.argmax(axis=-1), cells.max(axis=-1)
    cy, cx = np.nonzero(top > 0)
    return cy * c + best[cy, cx] // c, cx * c + best[cy, cx] % c


@dataclass(frozen=True)
class _Problem:
    """What is adjusted: the reference's pixels as seen in F frames.

    value (n,), rays (n, 3): luma and unit ray. start (n,): log depths to start from. frames (F, H, W). code, cam: as
    from ``camera_code``. huber, cut: of 1.
    """

    value: F32
    rays: F32
    start: NDArray[np.float64]
    frames: F32
    code: int
    cam: F32
    huber: float = 10.0
    cut: float = 10.0

    def linearise(self, T: Pose, s: NDArray[np.float64]) -> _System:
        """Normal equations at poses T (F, 4, 4) and log depths s (n,)."""
        F, n = len(self.frames), len(self.value)
        Hpd, bp, Hpp = np.empty((F, 6, n)), np.zeros((_RUNS, F, 6)), np.zeros((_RUNS, F, 6, 6))
        Hdd, bd, costs, size = np.zeros(n), np.zeros(n), np.zeros(n), np.empty((F, n), np.float32)
        R, t = T[:, :3, :3].astype(np.float32), T[:, :3, 3].astype(np.float32)
        points = (self.rays.T * np.exp(s)).astype(np.float32)
        several = self.cam.ndim == 2
        origins = origins_of(self.rays, self.cam) if several else np.empty((3, 0), np.float32)
        if several:
            points += self.cam[UNITS, 0] * origins
        Hsp, Hsd, Hss = np.zeros((_RUNS, F, 6)), np.zeros(n if several else 0), np.zeros((_RUNS, 2))
        limits = np.float32(self.huber), np.float32(self.cut)
        residuals(
            self.value, points, origins, self.frames, R, t, self.code, self.cam, *limits, Hpd, Hdd, bd, Hpp, bp, costs,
            size, Hsp, Hsd, Hss,
        )  # fmt: skip
        unit = _UnitRow(Hsp.sum(axis=0).ravel(), Hsd, *Hss.sum(axis=0)) if several else None
        return _System(Hpd.reshape(6 * F, n), Hdd, bd, Hpp.sum(axis=0), bp.sum(axis=0).ravel(), costs, size, unit)

    def with_thresholds(self, T: Pose, s: NDArray[np.float64], options: BundleOptions) -> tuple[_Problem, float] | None:
        """The problem with thresholds that follow its residuals, and their robust standard deviation (of 1).

        None if no frame sees any pixel.
        """
        size = self.linearise(T, s).size
        if not np.isfinite(size).any():
            return None
        sigma = max(1.4826 * float(np.nanmedian(size)), options.sigma_min)
        return replace(self, huber=options.huber * sigma, cut=options.cut * sigma), sigma

    def fair_costs(self, now: _System) -> NDArray[np.float64]:
        """(n,): how badly each pixel fits, by the frames that see it; infinite where few of them do.

        A pixel that something hides in some frames does not fit worse for that, nor better if the frames that are left
        are near, in which all pixels fit well: its cost in a frame is compared with the mean of what the frame sees.
        """
        seen = np.isfinite(now.size)
        if seen.all():
            return now.costs
        size = np.where(seen, np.minimum(now.size, self.cut), 0.0)
        costs = np.where(size > self.huber, self.huber * (size - 0.5 * self.huber), 0.5 * size**2)
        means = costs.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)
        often = seen.sum(axis=0)
        above = np.where(seen, costs - means[:, None], 0.0).sum(axis=0) / np.maximum(often, 1)
        return np.where(often >= _SEEN_MIN * often.max(), above, np.inf)

    def select(self, keep: NDArray[np.bool_]) -> _Problem:
        """The problem of the pixels that ``keep`` (n,) marks."""
        return replace(self, value=self.value[keep], rays=self.rays[keep], start=self.start[keep])

    def minimise(self, T: Pose, s: NDArray[np.float64], iterations: int) -> tuple[Pose, NDArray[np.float64], _System]:
        """Levenberg-Marquardt from poses T (F, 4, 4) and log depths s (n,): the new ones, and the system there."""
        now, damping = self.linearise(T, s), 1e-3
        for _ in range(iterations):
            x, ds = now.step(damping)
            T_new, s_new = renormalise(se3_exp(x.reshape(-1, 6)) @ T), s + np.clip(ds, -0.3, 0.3)
            trial = self.linearise(T_new, s_new)
            if trial.cost < now.cost:
                small = now.cost - trial.cost < _CONVERGED * now.cost
                T, s, now = T_new, s_new, trial
                damping = max(damping * 0.3, 1e-6)
                if small:
                    break
            else:
                damping *= 10
                if damping > 1e2:
                    break
        return T, s, now


def refine(
    luma: F32,
    rays: F32,
    depth: F32,
    frames: F32,
    T_fr: Pose,
    code: int,
    cam: F32,
    options: BundleOptions = BundleOptions(),
) -> Bundle:
    """Refine the poses T_fr (F, 4, 4) of ``frames`` (F, H, W), together with the depth of a reference's pixels.

    luma (H, W), of 1, rays (H, W, 3) and radial depth (H, W) are the reference's; luma and depth NaN where unknown.
    code, cam: as from ``camera_code``. With too few usable pixels the poses come back as they were, and not ``ok``.
    """
    ys, xs = select_pixels(luma, rays, depth, options)
    F = len(frames)
    nothing = Bundle(T_fr, np.inf, np.zeros((6 * F, 6 * F)), np.zeros(6 * F))
    if len(ys) < 100:
        return nothing
    s, T = np.log(depth[ys, xs].astype(np.float64)), T_fr.copy()
    problem = _Problem(luma[ys, xs], np.ascontiguousarray(rays[ys, xs]), s, frames, code, cam)
    if 0 < options.near < F:
        T, s = _from_near(problem, T, s, options)
    found = problem.with_thresholds(T, s, options)
    if found is None:
        return nothing
    problem, sigma = found
    if options.trim:
        T, s, now = problem.minimise(T, s, _BEFORE_TRIMMING)
        costs = problem.fair_costs(now)
        keep = costs <= np.quantile(costs[np.isfinite(costs)], 1 - options.trim)
        problem, s = problem.select(keep), s[keep]
    T, s, now = problem.minimise(T, s, options.iterations)
    scale = _gauge_scale(s - problem.start, now)
    units = None
    if now.unit is not None:
        change, deviation = now.unit_step(T)
        units = (scale * (float(cam[UNITS, 0]) + change), scale * deviation * sigma * float(np.sqrt((1 + F) / 2)))
    T[:, :3, 3] *= scale
    A, b, _ = now.schur_complement(0.0)
    unit = np.tile(np.repeat([1.0 / scale, 1.0], 3), F)
    return Bundle(T, now.cost / now.size.size, A * unit[:, None] * unit / sigma**2, b * unit / sigma**2, units)


def _from_near(
    problem: _Problem, T: Pose, s: NDArray[np.float64], options: BundleOptions
) -> tuple[Pose, NDArray[np.float64]]:
    """Poses and log depths after an adjustment of the nearest frames alone.

    A wrong depth moves a pixel less in near frames, by less than the reach of the image's gradient; in far frames by
    more.
    """
    near = np.argsort(np.linalg.norm(T[:, :3, 3], axis=1))[: options.near]
    found = replace(problem, frames=problem.frames[near]).with_thresholds(T[near], s, options)
    if found is None:
        return T, s
    T = T.copy()
    T[near], s, now = found[0].minimise(T[near], s, _NEAR_ITERATIONS)
    scale = _gauge_scale(s - problem.start, now)
    T[near, :3, 3] *= scale
    return T, s + np.log(scale)


def _gauge_scale(change: NDArray[np.float64], now: _System) -> float:
    """The factor on all depths and translations that restores the scale of the depths given, which is a free gauge.

    It undoes the median change (n,) of the log depths, weighted by how well each of them is determined.
    """
    by_size, weights = np.argsort(change), np.maximum(now.Hdd, 0)
    half = np.searchsorted(np.cumsum(weights[by_size]), 0.5 * weights.sum())
    return float(np.exp(-change[by_size[min(half, len(change) - 1)]]))


@dataclass(frozen=True)
class _UnitRow:
    """The row of the normal equations of the map's units in a metre: with poses (6F,), depths (n,), itself, and b."""

    Hsp: NDArray[np.float64]
    Hsd: NDArray[np.float64]
    Hss: float
    bs: float


@dataclass(frozen=True)
class _System:
    """Normal equations of n pixels in F frames, as ``residuals`` writes them, with its runs of pixels summed.

    Hpd (6F, n), Hdd, bd, costs (n,), Hpp (F, 6, 6), bp (6F,), size (F, n). unit: of a rig.
    """

    Hpd: NDArray[np.float64]
    Hdd: NDArray[np.float64]
    bd: NDArray[np.float64]
    Hpp: NDArray[np.float64]
    bp: NDArray[np.float64]
    costs: NDArray[np.float64]
    size: F32
    unit: _UnitRow | None = None

    @property
    def cost(self) -> float:
        return float(self.costs.sum())

    def schur_complement(self, damping: float) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """H (6F, 6F) and b (6F,) over the poses once the depths are eliminated, and the inverse of Hdd (n,)."""
        F = len(self.Hpp)
        H = np.zeros((F, 6, F, 6))
        H[np.arange(F), :, np.arange(F), :] = self.Hpp + np.triu(self.Hpp, 1).swapaxes(1, 2)
        A = H.reshape(6 * F, 6 * F)
        A[np.diag_indices(6 * F)] *= 1 + damping
        inverse = 1.0 / (self.Hdd * (1 + damping) + 1e-6)
        whitened = self.Hpd * np.sqrt(inverse)
        return A - whitened @ whitened.T, self.bp - self.Hpd @ (inverse * self.bd), inverse

    def step(self, damping: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The step: left twists (6F,) of the poses, and changes (n,) of the log depths."""
        A, b, inverse = self.schur_complement(damping)
        A[np.diag_indices(len(A))] += 1e-9 * np.trace(A) / len(A)
        x = np.asarray(np.linalg.solve(A, -b), np.float64)
        return x, -inverse * (self.bd + self.Hpd.T @ x)

    def unit_step(self, T: Pose) -> tuple[float, float]:
        """The step of a rig's units in a metre, and its standard deviation in that of the residuals.

        Poses T (F, 4, 4) and depths may take a step of their own with it, but for the scale of all translations, of
        which a step would be the same as one of the units.
        """
        assert self.unit is not None
        A, b, inverse = self.schur_complement(0.0)
        row = self.unit.Hsp - self.Hpd @ (inverse * self.unit.Hsd)
        H = self.unit.Hss - float(self.unit.Hsd @ (inverse * self.unit.Hsd))
        g = self.unit.bs - float(self.unit.Hsd @ (inverse * self.bd))
        along = np.zeros((len(T), 6))
        along[:, :3] = T[:, :3, 3]
        grown = along.ravel() / max(float(np.linalg.norm(along)), 1e-12)
        size = float(np.trace(A)) / max(len(A), 1)
        A = A + 1e3 * size * np.outer(grown, grown) + 1e-9 * size * np.eye(len(A))
        solved = np.linalg.solve(A, np.column_stack([row, b]))
        H, g = H - float(row @ solved[:, 0]), g - float(row @ solved[:, 1])
        return (-g / H, float(1 / np.sqrt(H))) if H > 0 else (0.0, float("inf"))
