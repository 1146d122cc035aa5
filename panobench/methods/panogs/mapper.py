"""The back-end: seeding, optimising, growing and pruning the Gaussian map over a window of keyframes."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.detail import EVEN, LEVELS, SeedPattern
from panobench.methods.panogs.occlusion import Occlusion
from panobench.methods.panogs.split import SplitRule, halves, too_coarse
from panobench.methods.panogs.surface import fill_depth, seed_gaussians
from panobench.methods.panogs.views import View
from panobench.splat.adam import GaussianAdam, LearningRates
from panobench.splat.gaussians import F32, GaussianMap
from panobench.splat.loss import colour_error, photometric_loss, pixel_weights
from panobench.splat.render import Render, Renderer

#: Of the swept depth: anything nearer is taken to stand in front of the surface.
_CARVE_BEFORE = 0.85
#: Of what is seen of a Gaussian, the part on wrong pixels from which it is one of the culprits.
_CARVE_SHARE = 0.25
#: With more planned steps than so many times a frame's, a frame does more.
_BACKLOG = 8
#: Of the learning rates at the start of the last steps, what they are at the end.
FINAL_RATE = 0.1
#: Standard deviation no Gaussian grows beyond, over the scene's depth.
LARGEST = 0.3


class Mapper:
    """Owns the map, its optimiser and the views it is fitted to."""

    def __init__(self, camera: Camera, renderer: Renderer, config: PanogsConfig, seed: int) -> None:
        self.camera, self.renderer, self.config = camera, renderer, config
        self.rng = np.random.default_rng(seed)
        self.weights = pixel_weights(camera, config.loss)
        self.map = GaussianMap.empty()
        self.adam = GaussianAdam(0, config.adam_beta1, config.adam_beta2)
        self.born = np.zeros(0, np.int32)  # keyframe number at which each Gaussian was inserted
        self.serial = np.zeros(0, np.int32)  # each Gaussian's own number, in ascending order
        self._serials = 0
        self.window: list[View] = []
        self.keyframes: list[View] = []
        self.frames: list[View] = []
        self.split_count = 0
        self.todo: deque[View] = deque()
        self.median_depth = 1.0
        valid = int(np.count_nonzero(camera.valid_mask()))
        self.count = max(int(valid / config.pixels_per_gaussian), 16)
        self.split_rule = SplitRule(config.split_error, config.split_size_px)
        self.pattern = SeedPattern(camera, self.count, LEVELS if config.densify else EVEN)

    # -- growing -------------------------------------------------------------------------------------------------

    def initialise(self, view: View, depth: F32) -> None:
        """First map from the first view and its depth (H, W)."""
        depth = fill_depth(depth, self.camera.kind == "erp")
        self.median_depth = float(np.nanmedian(depth))
        self._seed(view, depth, *self.pattern.seeds(view.image, None, self.rng))

    def insert(
        self, view: View, render: Render, swept: F32 | None = None, disproved: NDArray[np.bool_] | None = None
    ) -> int:
        """New Gaussians for a keyframe where the map is thin or wrong; returns how many.

        Where the opacity is low, depth is ``swept`` (H, W) from the last frames if given, else the rendered depth,
        else that of the nearest pixel that has one (across the seam) plus a small perturbation (DGIS). Without
        ``depth_guided`` it is the median depth, perturbed as MonoGS does. ``render``: of the map, at the
        view; disproved (H, W): where the swept depth also replaces what the map has.
        """
        wanted = self.thin(render)
        if swept is not None:
            wrong = self.wrong(view, render)
            if disproved is not None:
                wrong |= disproved & (self.weights > 0)
            wanted |= wrong
            if self.config.carve:
                self.carve(view, render, wrong, swept)
        pixels, spacing = self.pattern.seeds(view.image, wanted, self.rng)
        if len(pixels) == 0:
            return 0
        if swept is not None:
            return self._seed(view, swept, pixels, spacing)
        known = render.expected_depth(0.5)
        if self.config.depth_guided:
            depth, noise = fill_depth(known, self.camera.kind == "erp"), 0.02
            guessed = ~np.isfinite(known)
        else:
            depth, noise = np.full_like(known, self.median_depth), 0.15
            guessed = np.ones(known.shape, bool)
        depth = np.where(guessed, depth * (1 + noise * self.rng.standard_normal(depth.shape)), depth)
        return self._seed(view, depth.astype(np.float32), pixels, spacing)

    def carve(self, view: View, render: Render, wrong: NDArray[np.bool_], swept: F32) -> int:
        """Drop what stands well in front of the swept surface where the map is wrong; returns how many.

        New Gaussians behind such leftovers would never be seen. A large Gaussian may cover an opening from beside it,
        so what counts is where it is seen, not where its centre lies. ``render``: of the map, at ``view``.
        """
        distance = np.linalg.norm(self.map.means - view.position, axis=1)
        known = wrong & np.isfinite(swept)
        shares = np.stack([known, self.weights > 0, np.where(known, swept, 0)]).astype(np.float32)
        there, anywhere, deep = render.weighted_sums(shares).T
        behind = deep / np.maximum(there, 1e-6)
        return self.drop((there > _CARVE_SHARE * anywhere) & (there > 1e-3) & (distance < _CARVE_BEFORE * behind))

    def split(self, view: View, render: Render, known: NDArray[np.bool_] | None = None) -> int:
        """Halve what is too coarse for ``view``; returns how many.

        render: of the map, there; known (H, W): pixels where the map's surface is believed to be right. All
        splits together add at most as many Gaussians as a first image gets.
        """
        error = self._error(view, render)
        # What is thin gets new Gaussians instead; exactly no error is rare enough to mean "not looked at".
        error = np.where((self.weights > 0) & (render.opacity > 0.9), error, 0).astype(np.float32)
        if known is not None:
            error *= known
        which = too_coarse(render, self.map, view.position, error, self.split_rule)[: self.count - self.split_count]
        if len(which) == 0:
            return 0
        self.split_count += len(which)
        n = len(self.map)
        self.append(halves(self.map, which), np.tile(self.born[which], 2))
        for seen in self._counted():
            if seen.touched is not None:  # the halves are seen where the whole was
                t = np.zeros(n, np.int32)
                t[: len(seen.touched)] = seen.touched[:n]
                seen.touched = np.concatenate([t, t[which], t[which]])
        gone = np.zeros(len(self.map), bool)
        gone[which] = True
        return self.drop(gone)

    def local_depth(self, render: Render) -> float:
        """Median rendered depth, from every fourth row and column; the first map's where nothing is drawn."""
        depth = render.depth[::4, ::4][(render.opacity[::4, ::4] > 0.5) & (self.weights[::4, ::4] > 0)]
        return float(np.median(depth)) if depth.size else self.median_depth

    def thin(self, render: Render) -> NDArray[np.bool_]:
        """(H, W): valid pixels whose rendered opacity is below the insertion threshold."""
        return (render.opacity < self.config.insert_opacity) & (self.weights > 0)

    def wrong(self, view: View, render: Render) -> NDArray[np.bool_]:
        """(H, W): valid pixels whose colour the map misses by more than ``insert_error``, averaged over 5x5 pixels."""
        import cv2

        return (cv2.blur(self._error(view, render), (5, 5)) > self.config.insert_error) & (self.weights > 0)

    def unknown(self, view: View, render: Render) -> NDArray[np.bool_]:
        """(H, W): where the map is thin or wrong."""
        return self.thin(render) | self.wrong(view, render)

    @staticmethod
    def _error(view: View, render: Render) -> F32:
        """(H, W): mean absolute difference of render and image over the colours, of 1."""
        return np.asarray(colour_error(render.planes, view.image))

    def append(self, new: GaussianMap, born: NDArray[np.int32]) -> None:
        """Gaussians with a fresh optimiser; ``born`` (N,): how many keyframes there were when they came."""
        self.map = self.map.concat(new)
        self.adam.extend(len(new))
        self.born = np.concatenate([self.born, born])
        self.serial = np.concatenate([self.serial, self._serials + np.arange(len(new), dtype=np.int32)])
        self._serials += len(new)

    def _counted(self) -> list[View]:
        """The views that may count what they see of each Gaussian, each once."""
        return list({id(v): v for v in [*self.window, *self.keyframes]}.values())

    def _seed(self, view: View, depth: F32, pixels: NDArray[np.float64], spacing: NDArray[np.float64]) -> int:
        c = self.config
        new = seed_gaussians(
            self.camera, view.image, depth, pixels, view.T_wc, spacing,
            flatten=c.flatten, scale_factor=c.scale_factor, opacity=c.initial_opacity,
        )  # fmt: skip
        self.append(new, np.full(len(new), len(self.keyframes), np.int32))
        return len(new)

    def add_keyframe(self, view: View, window: list[View]) -> None:
        """``window`` is the new one; keyframes that leave it are kept like other frames."""
        for old in self.window:
            if old not in window:
                old.touched = None
                self.remember(old)
        self.keyframes.append(view)
        self.window = window

    def remember(self, view: View) -> None:
        """Keep a frame for mapping; beyond ``frame_pool`` a random one loses its image: memory is bounded."""
        self.frames.append(view)
        if len(self.frames) > self.config.frame_pool:
            gone = self.frames.pop(int(self.rng.integers(len(self.frames))))
            gone.image, gone.occlusion = gone.image[:0].copy(), Occlusion()

    # -- optimising ----------------------------------------------------------------------------------------------

    def optimise(self, iterations: int, *, poses: bool = True) -> float:
        """``iterations`` single-view steps: newest first and often, the window in turn, random other views.

        Returns the mean loss. The very first keyframe's pose stays fixed: it is the world frame.
        """
        schedule = self._schedule(iterations)
        return float(np.mean([self.step(view, refine_pose=poses) for view in schedule])) if schedule else 0.0

    def plan(self, iterations: int, *, first: bool = False) -> None:
        """So many steps more for ``work``, on the views as they are now; ``first``: before those planned earlier."""
        steps = self._schedule(iterations)
        (self.todo.extendleft if first else self.todo.extend)(steps[::-1] if first else steps)

    def work(self, steps: int) -> None:
        """Do about ``steps`` of the planned steps, more when they pile up; prune when the last one is done."""
        if not self.todo:
            return
        for _ in range(min(max(steps, len(self.todo) // _BACKLOG), len(self.todo))):
            view = self.todo.popleft()
            if view.image.size:
                self.step(view, refine_pose=True)
        if not self.todo:
            self.prune()

    def _schedule(self, iterations: int) -> list[View]:
        pool = self.frames if self.config.random_from == "frames" and self.frames else self.keyframes
        others = [v for v in pool if v not in self.window and v.image.size]
        out: list[View] = []
        while len(out) < iterations and self.window:
            round_ = [self.window[0]]
            rest = self.window[1:]
            if rest:
                round_ += [rest[i] for i in self.rng.permutation(len(rest))[:3]]
            n = min(self.config.random_views, len(others))
            round_ += [others[i] for i in self.rng.choice(len(others), n, replace=False)] if n else []
            out += round_
        return out[:iterations]

    def polish(self, iterations: int) -> None:
        """The last steps, on all views that have an image in random order, with rates that fall to ``FINAL_RATE``.

        At constant rates single-view steps never settle: what one view wants the next one takes back. Nothing is
        tracked on the map any more, so its surface is not held.
        """
        views = [v for v in {id(v): v for v in [*self.keyframes, *self.frames]}.values() if v.image.size]
        order = [int(i) for _ in range(iterations // max(len(views), 1) + 1) for i in self.rng.permutation(len(views))]
        for k, i in enumerate(order[:iterations]):
            self.step(views[i], refine_pose=False, rates=self.rates(FINAL_RATE ** (k / iterations), held=False))
        self.prune()

    def step(self, view: View, refine_pose: bool, rates: LearningRates | None = None) -> float:
        """One render, one backward pass, one Adam step, with the usual ``rates`` or these, on what the view touched."""
        least = self.config.hidden_px
        hidden = view.occlusion.hidden(self.serial) if least else None
        out = self.renderer.forward(self.map, view.T_wc, hidden=hidden, weigh=least > 0 and hidden is None)
        self.note_hidden(view, out)
        # What has no Gaussians yet must not make its neighbours spread over it.
        weights = self.weights * (out.opacity > 0.5) if self.config.sweep else self.weights
        loss, gradient, _ = photometric_loss(
            out.planes, view.image, weights, view.gain, view.offset, self.config.loss_knee
        )
        isotropy = self.config.isotropy / max(3 * len(out.order), 1)
        z = self.median_depth
        pose = self.adam.backward_step(out, gradient, rates or self.rates(), isotropy, (1e-4 * z, LARGEST * z))
        if refine_pose and self.config.refine_poses and self.keyframes and view is not self.keyframes[0]:
            sizes = (self.config.pose_rate_translation_rel * z, self.config.pose_rate_rotation)
            view.T_wc = invert_pose(view.pose_adam.step(invert_pose(view.T_wc), pose, sizes))
        return loss

    def note_hidden(self, view: View, render: Render) -> None:
        """Remember what the ``view`` can do without, if the render of the whole map, there, says so."""
        if render.weights is not None:
            view.occlusion.note(self.serial, render.weights, self.config.hidden_px)

    def rates(self, share: float = 1.0, *, held: bool = True) -> LearningRates:
        """``share`` of the usual rates; ``held``: discs are slow to leave their plane."""
        c = self.config
        lift, tilt = (c.lift, c.tilt) if held else (1.0, 1.0)
        return LearningRates(
            c.position_rate_rel * self.median_depth * share, c.scale_rate * share, c.rotation_rate * share,
            c.opacity_rate * share, c.colour_rate * share, lift, tilt,
        )  # fmt: skip

    def prune(self) -> int:
        """Drop Gaussians that faded or stopped being finite; returns how many.

        Large ones are held back (``LARGEST``), not dropped as MonoGS does: where a wall is plain they leave holes.
        """
        g = self.map
        logit = np.log(self.config.prune_opacity / (1 - self.config.prune_opacity))
        keep = g.opacity_logits > logit
        keep &= np.isfinite(g.means).all(axis=1) & np.isfinite(g.log_scales).all(axis=1)
        return self.drop(~keep)

    def drop(self, gone: NDArray[np.bool_]) -> int:
        dropped, keep = int(np.count_nonzero(gone)), ~gone
        if dropped:
            self.map, self.born, self.serial = self.map.select(keep), self.born[keep], self.serial[keep]
            self.adam.select(keep)
            for view in self._counted():
                if view.touched is not None and len(view.touched) <= len(keep):
                    view.touched = view.touched[keep[: len(view.touched)]]
        return dropped
