"""First depth by structure from motion over the first frames: no network weights, and no scale.

Frames are collected until they show parallax. Initial poses (``bootstrap_starts``) are refined together with depth
(``bootstrap_solve``), and the solution is checked (``bootstrap_check``). If the check fails, the bundle-adjusted poses
of the ``sparse`` method may confirm the solution, or are the initial poses of another. After that the estimator tries
again with more frames, then from a later frame. If all attempts fail, it returns the failed solution that agrees best
with itself, or a constant depth if nothing had parallax. Both have ``ok = False``.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from panobench.cameras.base import Camera
from panobench.depth.base import DepthEstimator
from panobench.depth.bootstrap_check import check_solution, compare_poses, photometric_cost
from panobench.depth.bootstrap_solve import MEDIAN_DEPTH, OVERLAP_MIN, Solution, SolveOptions, Solver, spread_over_path
from panobench.depth.bootstrap_starts import FlatStart, PoseStart, Start, TrackStart
from panobench.geometry import invert_pose
from panobench.photometric.overlap import ViewWidth
from panobench.photometric.pyramid import F32, luma_of_frame, pyramid
from panobench.photometric.stereo import resize_panorama
from panobench.types import DepthEstimate, Frame

#: Two solutions are the same if their log depths differ by less than this in the median, after scale alignment.
SAME_DEPTH = 0.05


@dataclass(frozen=True)
class BootstrapOptions:
    """Parallax is translation over median depth, in radians.

    parallax_rad: is enough after ``frames`` frames. parallax_fast_rad: is enough after ``min_frames`` frames.
    parallax_min_rad: with less, no solution is attempted. max_frames: the solution is attempted after so many frames
    at the latest if the camera moves, max_frames_still if it does not. attempts: on one first frame.
    parallax_growth: factor on the required parallax after a failed attempt. restarts: how many later first frames are
    tried after all attempts on one have failed.

    narrow_sr: views of less solid angle are initialised from feature tracks, and do not wait for more parallax once
    they see less than min_overlap of the reference. Of their two solutions, one must have a photometric cost that is
    lower by the factor cost_ratio.
    """

    parallax_rad: float = 0.15
    parallax_fast_rad: float = 0.25
    parallax_min_rad: float = 0.02
    min_frames: int = 4
    frames: int = 14
    max_frames: int = 60
    max_frames_still: int = 150
    attempts: int = 3
    parallax_growth: float = 1.5
    restarts: int = 4
    narrow_sr: float = 2 * np.pi
    min_overlap: float = 0.6
    cost_ratio: float = 1.15
    solve: SolveOptions = field(default_factory=SolveOptions)


class BootstrapDepth(DepthEstimator):
    """Buffers frames until they show parallax, then solves for depth and poses jointly."""

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
        self.tracks: TrackStart | None = None  # a wide view's second opinion, from its first failed attempt on
        self.parallax_factor, self.problems = 1.0, list[str]()
        self.attempts, self.restarts = 0, 0
        self.failed: list[tuple[float, str, DepthEstimate]] = []  # agreement, problem, estimate

    def _start_of(self, tracks: bool) -> PoseStart:
        return TrackStart(self.camera, self.seed) if tracks else FlatStart(self.camera, self.solver)

    def add(self, frame: Frame) -> DepthEstimate | None:
        o = self.options
        self.frames.append(frame)
        valid = self.valid if frame.mask is None else self.valid & frame.mask
        levels = pyramid(luma_of_frame(frame.image, valid))
        unused = self.solver.fine.level  # levels above the fine working size are not kept
        self.pyramids.append([np.empty((0, 0), np.float32)] * unused + levels[unused:])
        self.starts.add(frame, self.pyramids)
        if self.tracks is not None:
            self.tracks.add(frame, self.pyramids)
        start, n = self.starts.start(), len(self.frames)
        if start is not None and self._has_parallax(start):
            exhausted = self.attempts + 1 >= o.attempts and not self.narrow
            return self._answer(start, last=n >= o.max_frames or exhausted)
        moved = start is not None and start.parallax() >= o.parallax_min_rad
        if n >= (o.max_frames if moved or self.narrow else o.max_frames_still):
            return self._answer(start, last=True)
        return None

    def finish(self) -> DepthEstimate | None:
        if not self.frames:
            return None
        if len(self.frames) < 3:
            return self._fallback("too few frames")
        return self._answer(self.starts.start(), last=True, final=True)

    def _has_parallax(self, start: Start) -> bool:
        """Whether the frames show enough parallax for an attempt. After a failed one, more is required."""
        o, n = self.options, len(start.T_fr)
        parallax = start.parallax() / self.parallax_factor
        if n >= o.min_frames and parallax >= o.parallax_fast_rad:
            return True
        if self.narrow:
            return n >= o.frames and start.seen[-1] < o.min_overlap and parallax >= 0.25 * o.parallax_rad
        return n >= o.frames and parallax >= o.parallax_rad

    # -- solving -------------------------------------------------------------------------------------------------

    def _answer(self, start: Start | None, *, last: bool, final: bool = False) -> DepthEstimate | None:
        """The estimate, or None if more frames are needed.

        last: more frames would not help this first frame. final: there are no more frames.
        """
        found = self._attempt(start, self.starts)
        if found is None and not self.narrow:
            tracks = self._tracks()
            found = self._attempt(tracks.start(), tracks)
        if found is None and not last:
            self._prepare_next_attempt()
            return None
        if found is None and self.narrow:
            flat = self._start_of(tracks=False)
            self._replay(flat)
            found = self._attempt(flat.start(), flat)
            flat.close()
        self._close()
        # A later first frame helps against things that move, but not if the camera stands still.
        if found is None and not final and self.failed and self.restarts < self.options.restarts:
            self._restart()
            return None
        self.pyramids = []
        return found or self._fallback("; ".join(dict.fromkeys(self.problems)))

    def _tracks(self) -> TrackStart:
        """Feature tracks of all frames so far."""
        if self.tracks is None:
            self.tracks = TrackStart(self.camera, self.seed)
            self._replay(self.tracks)
        return self.tracks

    def _replay(self, source: PoseStart) -> None:
        for k, frame in enumerate(self.frames):
            source.add(frame, self.pyramids[: k + 1])

    def _close(self) -> None:
        self.starts.close()
        if self.tracks is not None:
            self.tracks.close()
            self.tracks = None

    def _restart(self) -> None:
        """Start again with the newest frame as the first one."""
        self.restarts += 1
        self.frames, self.pyramids = self.frames[-1:], self.pyramids[-1:]
        self.parallax_factor, self.attempts = 1.0, 0
        self.starts = self._start_of(self.narrow)
        self.starts.add(self.frames[0], self.pyramids)

    def _prepare_next_attempt(self) -> None:
        """A wide view waits for more parallax. A narrow one has turned away, and starts again from the newest frame."""
        self.attempts += 1
        if not self.narrow:
            self.parallax_factor *= self.options.parallax_growth
            return
        self.starts.close()
        self.starts = self._start_of(self.narrow)
        self.starts.add(self.frames[-1], self.pyramids)

    def _attempt(self, start: Start | None, source: PoseStart) -> DepthEstimate | None:
        if start is None or len(start.T_fr) < 3:
            self.problems.append(f"no start from {source.label}")
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
        if self.narrow and isinstance(source, TrackStart):
            solution, problem = self._choose_solution(start, usable, pyramids, solution)
        check = check_solution(self.solver, pyramids, solution)
        problem = problem or check.problem()
        estimate = self._estimate(start, source, usable, solution)
        if problem is not None and not self.narrow and check.confirmable:
            opinion = compare_poses(estimate.T_wc, self._tracks().poses())
            if opinion.confirms:
                return replace(
                    estimate, message=f"{estimate.message}; {problem}, but feature tracks find the same poses"
                )
            problem = f"{problem} (feature tracks: {opinion})"
        if problem is not None:
            self.problems.append(problem)
            self.failed.append((check.agreement, problem, estimate))
            return None
        return estimate

    def _choose_solution(
        self, start: Start, usable: list[int], pyramids: list[list[F32]], solution: Solution
    ) -> tuple[Solution, str | None]:
        """The better of the solutions from two kinds of initial poses; a problem if neither is clearly better.

        Several depths can explain a narrow view.
        """
        flat = FlatStart(self.camera, self.solver)
        for k in range(len(start.T_fr)):
            flat.add(self.frames[start.reference + k], self.pyramids[start.reference : start.reference + k + 1])
        rival = self.solver.solve(pyramids, [flat.T_fr[k] for k in usable], solution.used)
        cost, rival_cost = (photometric_cost(self.solver, pyramids, s) for s in (solution, rival))
        change = np.log(rival.depth / solution.depth)[self.solver.fine.valid]
        same = float(np.median(np.abs(change - np.median(change)))) < SAME_DEPTH
        best = solution if cost <= rival_cost else rival
        if same or max(cost, rival_cost) > self.options.cost_ratio * min(cost, rival_cost):
            return best, None
        return best, "two starts end in different depths that explain the images alike"

    def _estimate(self, start: Start, source: PoseStart, usable: list[int], solution: Solution) -> DepthEstimate:
        size = (self.camera.height, self.camera.width)
        confidence = np.where(self.solver.fine.valid, solution.confidence, 0).astype(np.float32)
        poses = {self.frames[start.reference + k].index: invert_pose(T) for k, T in zip(usable, solution.T_fr)}
        if start.reference:
            before = self.pyramids[: start.reference][::-1]
            earlier = self.solver.backwards(before, [self.pyramids[start.reference + k] for k in usable], solution)
            poses |= {self.frames[start.reference - 1 - k].index: invert_pose(T) for k, T in enumerate(earlier)}
        parallax = max(float(np.linalg.norm(T[:3, 3])) for T in solution.T_fr) / MEDIAN_DEPTH
        said = [f"{len(self.frames)} frames", f"parallax {np.rad2deg(parallax):.1f} deg"]
        if start.without_parallax() >= 3:
            said.append(f"{start.without_parallax()} of them without parallax")
        if start.reference:
            said.append(f"{start.reference} before the first with depth")
        if isinstance(source, TrackStart):
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
        """The failed solution with the best agreement, or a constant depth if nothing had parallax."""
        if self.failed:
            _, problem, best = max(self.failed, key=lambda candidate: candidate[0])
            said = f"all {len(self.failed)} attempts failed their check; of the one that is used, {problem}"
            return replace(best, ok=False, message=f"bootstrap: {said}")
        depth = np.full((self.camera.height, self.camera.width), MEDIAN_DEPTH, np.float32)
        return DepthEstimate(depth, self.frames[0].index, ok=False, message=f"bootstrap: {why}; constant depth")
