"""Training the map: single-view steps that are planned at keyframes and worked off frame by frame."""

from __future__ import annotations

from collections import deque

import numpy as np

from panobench.cameras.base import Camera
from panobench.geometry import invert_pose
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapping.sharpness import Sharpness
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.culling import VisibilityCulling
from panobench.methods.splatting.trainable_map import TrainableMap
from panobench.methods.splatting.transients import Transients
from panobench.methods.splatting.views import View
from panobench.splat.adam import LearningRates, Target
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Render, Renderer

#: Least standard deviation of a Gaussian, in median depths.
SMALLEST = 1e-4
#: One of so many views is left out of the last steps where their pictures decide when to stop.
LEFT_OUT = 10


class MapOptimiser:
    """Steps on the newest keyframe, the window and random other views.

    window: keyframes that are optimised together, newest first. scene_depth: median depth of the first map, the unit
    of rates and sizes.
    """

    def __init__(
        self,
        camera: Camera,
        renderer: Renderer,
        config: PanogsConfig,
        trainable: TrainableMap,
        trajectory: AnchoredTrajectory,
        rng: np.random.Generator,
    ) -> None:
        self.renderer, self.map, self.trajectory, self.rng = renderer, trainable, trajectory, rng
        self.config, self.options = config, config.mapping
        self.weights = pixel_weights(camera, config.rendering.weights)
        m = config.moving
        self.transients = Transients(self.weights, m.error, m.share if m.enabled else 1.0, camera.kind == "erp")
        self.sharpness = Sharpness(camera, config.mapping.blurred_below)
        self.window: list[View] = []
        self.scene_depth = 1.0
        self._planned: deque[View] = deque()

    # -- planning ------------------------------------------------------------------------------------------------------

    def plan(self, iterations: int, *, first: bool = False) -> None:
        """So many more steps for ``work``, on the views there are now; ``first``: before those planned earlier."""
        steps = self._schedule(iterations)
        (self._planned.extendleft if first else self._planned.extend)(steps[::-1] if first else steps)

    def work(self, steps: int) -> None:
        """Do about ``steps`` planned steps, more of them when many are planned; prune after the last one."""
        if not self._planned:
            return
        for _ in range(min(max(steps, len(self._planned) // self.options.backlog), len(self._planned))):
            view = self._planned.popleft()
            if view.image.size:
                self.step(view, refine_pose=True)
        if not self._planned:
            self.prune()

    def work_for_a_frame(self) -> None:
        """The planned steps that one frame has time for; all of them if steps are not spread over frames."""
        self.work(self.options.steps_per_frame or len(self._planned))

    def work_all(self) -> None:
        """Do every planned step."""
        self.work(len(self._planned))

    def optimise(self, iterations: int, *, poses: bool = True) -> float:
        """``iterations`` steps at once; returns their mean loss. poses: refine the views' poses too."""
        schedule = self._schedule(iterations)
        return float(np.mean([self.step(view, refine_pose=poses) for view in schedule])) if schedule else 0.0

    def _schedule(self, iterations: int) -> list[View]:
        """The newest keyframe first and often, three more of the window, and random other views."""
        o, frames = self.options, self.trajectory.frames
        pool = frames if o.random_from == "frames" and frames else self.trajectory.keyframes
        others = [v for v in pool if v not in self.window and v.image.size]
        shares = np.array([self.sharpness.share(v.index) for v in others])
        chances = shares / shares.sum() if (shares < 1).any() else None
        out: list[View] = []
        while len(out) < iterations and self.window:
            round_ = [self.window[0]]
            rest = self.window[1:]
            if rest:
                round_ += [rest[i] for i in self.rng.permutation(len(rest))[:3]]
            round_ = self._fewer_blurred(round_)
            n = min(o.random_views, len(others))
            round_ += [others[i] for i in self.rng.choice(len(others), n, replace=False, p=chances)] if n else []
            out += round_
        return out[:iterations]

    def _fewer_blurred(self, views: list[View]) -> list[View]:
        """``views`` without some of those that are blurred."""
        shares = [self.sharpness.share(v.index) for v in views]
        return [v for v, share in zip(views, shares) if share == 1 or self.rng.random() < share]

    def finish(self) -> None:
        """The last steps, in one or more rounds.

        With more than one, every tenth view is left out of them: each round is twice as long as the one before, and
        the last is the one that no longer brings the pictures of those views ``final_gain``.
        """
        views, o = self.views(), self.options
        iterations = o.final_iterations * len(self.trajectory.keyframes)
        if o.final_rounds <= 1:
            self.polish(iterations, views)
            return
        unseen = views[LEFT_OUT // 2 :: LEFT_OUT]
        trained = [v for v in views if not any(v is u for u in unseen)]
        before = -np.inf
        for round_ in range(o.final_rounds):
            self.polish(iterations << round_, trained)
            now = self._psnr(unseen)
            if not now >= before + o.final_gain:
                return
            before = now

    def views(self) -> list[View]:
        """Keyframes and other frames that have an image, each once."""
        every = {id(v): v for v in [*self.trajectory.keyframes, *self.trajectory.frames]}.values()
        return [v for v in every if v.image.size]

    def _psnr(self, views: list[View]) -> float:
        """Mean PSNR of the map's pictures of ``views`` in dB; NaN without views."""
        found = []
        for view in views:
            render = self.renderer.forward(self.map.gaussians, view.T_wc)
            image = np.exp(-view.gain) * (view.image / np.float32(255) - view.offset)
            squared = ((np.clip(render.colour, 0, 1) - image) ** 2).mean(axis=2)
            weights = self.weights if view.visible is None else self.weights * view.visible
            found.append(-10 * np.log10(float((weights * squared).sum() / max(weights.sum(), 1e-12)) + 1e-12))
        return float(np.mean(found)) if found else float("nan")

    def polish(self, iterations: int, views: list[View] | None = None) -> None:
        """Steps on ``views`` (all that have an image) in random order, with falling rates.

        At constant rates single-view steps never converge: what one view wants, the next one takes back. Nothing is
        tracked on the map any more, so discs may leave their plane freely.
        """
        views = self.views() if views is None else views
        views = self._fewer_blurred(views) or views
        order = [int(i) for _ in range(iterations // max(len(views), 1) + 1) for i in self.rng.permutation(len(views))]
        for k, i in enumerate(order[:iterations]):
            share = self.options.final_rate ** (k / iterations)
            self.step(views[i], refine_pose=False, rates=self.rates(share, hold_plane=False))
        self.prune()

    # -- stepping ------------------------------------------------------------------------------------------------------

    def step(self, view: View, refine_pose: bool, rates: LearningRates | None = None) -> float:
        """One render, one backward pass and one Adam step on the Gaussians that the view touches; returns the loss.

        The first keyframe's pose stays: it is the world frame.
        """
        o, z = self.options, self.scene_depth
        hidden = view.culling.hidden(self.map.ids) if o.culling_px else None
        render = self.renderer.forward(
            self.map.gaussians, view.T_wc, culled=hidden, sum_weights=o.culling_px > 0 and hidden is None
        )
        self.update_culling(view, render)
        # Where there are no Gaussians yet, the loss would make the neighbours spread.
        opaque = 0.5 if self.config.fixed_lag.sweep else None
        weights = self.weights if view.visible is None else self.weights * view.visible
        if self.transients.active:
            weights = weights * ~self.transients.contradicted(view.image, render, view.visible)
        target = Target(view.image, weights, view.gain, view.offset, self.config.rendering.knee, opaque)
        isotropy = o.isotropy / max(3 * render.drawn, 1)
        sizes = (SMALLEST * z, self.config.density.largest * z)
        loss, pose = self.map.adam.photometric_step(render, target, rates or self.rates(), isotropy, sizes)
        keyframes = self.trajectory.keyframes
        if refine_pose and o.refine_poses and keyframes and view is not keyframes[0]:
            pose_rates = (self.config.rates.pose_translation * z, self.config.rates.pose_rotation)
            view.T_wc = invert_pose(view.pose_adam.step(invert_pose(view.T_wc), pose, pose_rates))
        return loss

    def update_culling(self, view: View, render: Render) -> None:
        """Remember what ``view`` can leave out, if ``render`` is of the whole map at the view and has weights."""
        if render.weights is not None:
            view.culling.update(self.map.ids, render.weights, self.options.culling_px)

    def forget_image(self, view: View) -> None:
        """Drop a view's image; no step is done on it any more."""
        view.image, view.culling = view.image[:0].copy(), VisibilityCulling()

    def rates(self, share: float = 1.0, *, hold_plane: bool = True) -> LearningRates:
        """``share`` of the usual rates; ``hold_plane``: discs are slow to leave their plane."""
        r = self.config.rates
        lift, tilt = (r.lift, r.tilt) if hold_plane else (1.0, 1.0)
        return LearningRates(
            r.position * self.scene_depth * share, r.scale * share, r.rotation * share, r.opacity * share,
            r.colour * share, lift, tilt,
        )  # fmt: skip

    def prune(self) -> int:
        """Drop Gaussians that faded or stopped being finite; returns how many.

        Large ones keep a bounded size instead of being dropped as in MonoGS: where a wall is plain they leave holes.
        """
        g, p = self.map.gaussians, self.config.density.prune_opacity
        keep = g.opacity_logits > np.log(p / (1 - p))
        keep &= np.isfinite(g.means).all(axis=1) & np.isfinite(g.log_scales).all(axis=1)
        return self.map.drop(~keep)
