"""Depth of a first frame from the first frames themselves: no weights, no scale.

Frames are collected until they have parallax; rough poses (``bootstrap_starts``) become depth and poses
(``bootstrap_solve``), which are judged (``bootstrap_check``). What fails is tried again with more frames, then from the
other kind of start, then from a later frame. In the end the answer is the best of what failed, or a constant without
any parallax; both say that they are not to be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from panobench.cameras.base import Camera
from panobench.depth.base import DepthEstimator
from panobench.depth.bootstrap_check import judge, photometric_cost
from panobench.depth.bootstrap_solve import MEDIAN_DEPTH, OVERLAP_MIN, Solution, SolveOptions, Solver, spread_over_path
from panobench.depth.bootstrap_starts import FlatStart, PoseStart, Start, TrackStart
from panobench.geometry import invert_pose
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pyramid import F32, luma_of_frame, pyramid
from panobench.photometric.stereo import resize_panorama
from panobench.types import DepthEstimate, Frame

#: Median difference of log depths, the scale taken out, below which two solutions are one.
SAME_DEPTH = 0.05


@dataclass(frozen=True)
class BootstrapOptions:
    """parallax_rad: translation over depth that ends the wait after ``frames`` frames; parallax_fast_rad: already after
    min_frames. parallax_min_rad: below it nothing is tried. wait: frames after which what there is has to do, if the
    camera moved; patience: the same if it did not. more: factor on the parallax asked for after a failure.
    restarts: later first frames tried after all starts from one have failed.
    narrow_sr: views of less solid angle start from feature tracks, and do not wait while they lose the reference from
    view (leaving: share still seen); of two solutions for them one must be better by the factor clear.
    """

    parallax_rad: float = 0.15
    parallax_fast_rad: float = 0.25
    parallax_min_rad: float = 0.02
    min_frames: int = 4
    frames: int = 14
    wait: int = 60
    patience: int = 150
    tries: int = 3
    more: float = 1.5
    restarts: int = 4
    narrow_sr: float = 2 * np.pi
    leaving: float = 0.6
    clear: float = 1.15
    solve: SolveOptions = field(default_factory=SolveOptions)


class BootstrapDepth(DepthEstimator):
    """Buffers frames until they have parallax, then solves for depth and poses together."""

    def __init__(self, argument: str = "", options: BootstrapOptions = BootstrapOptions()) -> None:
        super().__init__(argument)
        self.options = options

    def start(self, camera: Camera, seed: int = 0) -> None:
        self.camera, self.seed, self.wrap = camera, seed, camera.kind == "erp"
        self.valid = camera.valid_mask()
        self.solver = Solver(camera, self.options.solve)
        self.narrow = ViewWidth.of(camera, self.options.narrow_sr) is ViewWidth.NARROW
        self.frames: list[Frame] = []
        self.pyramids: list[list[F32]] = []
        self.starts: PoseStart = self._start_of(self.narrow)
        self.demand, self.problems = 1.0, list[str]()
        self.tries, self.restarts = 0, 0
        self.failed: list[tuple[float, str, DepthEstimate]] = []  # share of the depth agreed on, problem

    def _start_of(self, tracks: bool) -> PoseStart:
        return TrackStart(self.camera, self.seed) if tracks else FlatStart(self.camera, self.solver)

    def add(self, frame: Frame) -> DepthEstimate | None:
        o = self.options
        self.frames.append(frame)
        levels = pyramid(luma_of_frame(frame.image, self.valid))
        unused = self.solver.fine.level  # levels larger than the fine working size: not worth their memory
        self.pyramids.append([np.empty((0, 0), np.float32)] * unused + levels[unused:])
        self.starts.add(frame, self.pyramids)
        start, n = self.starts.start(), len(self.frames)
        if start is not None and self._enough(start):
            tired = self.tries + 1 >= o.tries and not self.narrow
            return self._answer(start, last=n >= o.wait or tired)
        moved = start is not None and start.parallax() >= o.parallax_min_rad
        if n >= (o.wait if moved or self.narrow else o.patience):
            return self._answer(start, last=True)
        return None

    def finish(self) -> DepthEstimate | None:
        if not self.frames:
            return None
        if len(self.frames) < 3:
            return self._fallback("too few frames")
        return self._answer(self.starts.start(), last=True, final=True)

    def _enough(self, start: Start) -> bool:
        """Parallax for a try; after a failure more of it."""
        o, n = self.options, len(start.T_fr)
        parallax = start.parallax() / self.demand
        if n >= o.min_frames and parallax >= o.parallax_fast_rad:
            return True
        if self.narrow:
            return n >= o.frames and start.seen[-1] < o.leaving and parallax >= 0.25 * o.parallax_rad
        return n >= o.frames and parallax >= o.parallax_rad

    # -- answering -----------------------------------------------------------------------------------------------

    def _answer(self, start: Start | None, *, last: bool, final: bool = False) -> DepthEstimate | None:
        """A depth that passes its check; None: more frames, please.

        last: more frames would not help this first frame. final: no more will come.
        """
        found = self._attempt(start, self.starts)
        if found is None and not last:
            self._again()
            return None
        self.starts.close()
        if found is None:
            other = self._start_of(not self.narrow)
            for k, frame in enumerate(self.frames):
                other.add(frame, self.pyramids[: k + 1])
            found = self._attempt(other.start(), other)
            other.close()
        # A later start helps against what moves in the scene, not against a camera that does not move.
        if found is None and not final and self.failed and self.restarts < self.options.restarts:
            self._begin_later()
            return None
        self.pyramids = []
        return found or self._fallback("; ".join(dict.fromkeys(self.problems)))

    def _begin_later(self) -> None:
        """The newest frame is the first one from here on."""
        self.restarts += 1
        self.frames, self.pyramids = self.frames[-1:], self.pyramids[-1:]
        self.demand, self.tries = 1.0, 0
        self.starts = self._start_of(self.narrow)
        self.starts.add(self.frames[0], self.pyramids)

    def _again(self) -> None:
        """After a failure: more parallax on a wide view; a narrow one has turned away, and begins anew from here."""
        self.tries += 1
        if not self.narrow:
            self.demand *= self.options.more
            return
        self.starts.close()
        self.starts = self._start_of(self.narrow)
        self.starts.add(self.frames[-1], self.pyramids)

    def _attempt(self, start: Start | None, way: PoseStart) -> DepthEstimate | None:
        if start is None or len(start.T_fr) < 3:
            self.problems.append(f"no start from {way.label}")
            return None
        if start.parallax() < self.options.parallax_min_rad:
            self.problems.append(f"no parallax in {len(self.frames)} frames")
            return None
        usable = [0] + [k for k in range(1, len(start.T_fr)) if start.seen[k] >= OVERLAP_MIN]
        if len(usable) < 3:
            self.problems.append("the view turned away too fast")
            return None
        pyramids = [self.pyramids[start.reference + k] for k in usable]
        T_fr = [start.T_fr[k] for k in usable]
        solution = self.solver.solve(pyramids, T_fr, spread_over_path(T_fr, self.options.solve.frames))
        problem = None
        if self.narrow and isinstance(way, TrackStart):
            solution, problem = self._settled(start, usable, pyramids, solution)
        verdict = judge(self.solver, pyramids, solution)
        problem = problem or verdict.problem()
        estimate = self._estimate(start, way, usable, solution)
        if problem is not None:
            self.problems.append(problem)
            self.failed.append((verdict.agreement, problem, estimate))
            return None
        return estimate

    def _settled(
        self, start: Start, usable: list[int], pyramids: list[list[F32]], solution: Solution
    ) -> tuple[Solution, str | None]:
        """The better of two starts, and a problem if it is not clear: many depths may explain a narrow view."""
        flat = FlatStart(self.camera, self.solver)
        for k in range(len(start.T_fr)):
            flat.add(self.frames[start.reference + k], self.pyramids[start.reference : start.reference + k + 1])
        rival = self.solver.solve(pyramids, [flat.T_fr[k] for k in usable], solution.used)
        cost, rival_cost = (photometric_cost(self.solver, pyramids, s) for s in (solution, rival))
        change = np.log(rival.depth / solution.depth)[self.solver.fine.valid]
        same = float(np.median(np.abs(change - np.median(change)))) < SAME_DEPTH
        best = solution if cost <= rival_cost else rival
        if same or max(cost, rival_cost) > self.options.clear * min(cost, rival_cost):
            return best, None
        return best, "two starts end in different depths that explain the images alike"

    def _estimate(self, start: Start, way: PoseStart, usable: list[int], solution: Solution) -> DepthEstimate:
        size = (self.camera.height, self.camera.width)
        confidence = np.where(self.solver.fine.valid, solution.confidence, 0).astype(np.float32)
        poses = {self.frames[start.reference + k].index: invert_pose(T) for k, T in zip(usable, solution.T_fr)}
        if start.reference:
            before = self.pyramids[: start.reference][::-1]
            earlier = self.solver.backwards(before, [self.pyramids[start.reference + k] for k in usable], solution)
            poses |= {self.frames[start.reference - 1 - k].index: invert_pose(T) for k, T in enumerate(earlier)}
        parallax = max(float(np.linalg.norm(T[:3, 3])) for T in solution.T_fr) / MEDIAN_DEPTH
        said = [f"{len(self.frames)} frames", f"parallax {np.rad2deg(parallax):.1f} deg"]
        if start.turning() >= 3:
            said.append(f"{start.turning()} of them without parallax waited out")
        if start.reference:
            said.append(f"{start.reference} before the first with depth")
        if isinstance(way, TrackStart):
            said.append("from feature tracks")
        if self.problems:
            said.append(f"attempt {len(self.problems) + 1}: {'; '.join(self.problems)}")
        return DepthEstimate(
            resize_panorama(solution.depth, size, self.wrap),
            self.frames[start.reference].index,
            resize_panorama(confidence, size, self.wrap),
            poses,
            message="bootstrap: " + ", ".join(said),
        )

    def _fallback(self, why: str) -> DepthEstimate:
        """What failed its check by least; a constant if nothing had parallax."""
        if self.failed:
            _, problem, best = max(self.failed, key=lambda candidate: candidate[0])
            said = f"all {len(self.failed)} attempts failed their check; of the one that is used, {problem}"
            return replace(best, ok=False, message=f"bootstrap: {said}")
        depth = np.full((self.camera.height, self.camera.width), MEDIAN_DEPTH, np.float32)
        return DepthEstimate(depth, self.frames[0].index, ok=False, message=f"bootstrap: {why}; constant depth")
