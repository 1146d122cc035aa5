"""The jobs behind the tracker, as an ordered list with one rule for which runs next.

Each job takes as long as tracking a few frames, so only the first that is due runs behind a frame. A narrow view turns
away from what it saw, so there a job on the trajectory does not keep the depth of new regions waiting.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from panobench.methods.panogs.factor_graph.factors import FactorGraph
from panobench.methods.panogs.fixed_lag.stage import FixedLag
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.photometric.overlap import ViewWidth


@dataclass(frozen=True)
class Job:
    """run: gets the median depth of what the newest frame sees. trajectory: it must not wait for jobs on depth."""

    due: Callable[[], bool]
    run: Callable[[float], None]
    trajectory: bool = False


class BackgroundJobs:
    """What follows once a frame is tracked and mapped, and what is left once no frame follows."""

    def __init__(
        self, mapper: Mapper, trajectory: AnchoredTrajectory, graph: FactorGraph, lag: FixedLag, width: ViewWidth
    ) -> None:
        self.mapper, self.trajectory, self.graph, self.lag, self.width = mapper, trajectory, graph, lag, width
        self.jobs = [
            Job(lambda: graph.drifted, self.close_loop, trajectory=True),
            Job(lambda: graph.changed, self.optimise_trajectory, trajectory=True),
            Job(graph.overdue, self.make_factor, trajectory=True),
            Job(lambda: lag.can_insert, self.insert_depth),
            Job(lambda: lag.sweep_wanted, lag.sweep),
            Job(lambda: not graph.changed, self.make_factor),
        ]

    def run_next(self, scene_depth: float) -> None:
        """Run the first job that is due; in a narrow view also the first on depth after one on the trajectory."""
        ran = self._run_first([job for job in self.jobs if job.trajectory], scene_depth)
        if not ran or self.width is ViewWidth.NARROW:
            self._run_first([job for job in self.jobs if not job.trajectory], scene_depth)

    @staticmethod
    def _run_first(jobs: list[Job], scene_depth: float) -> bool:
        job = next((job for job in jobs if job.due()), None)
        if job is not None:
            job.run(scene_depth)
        return job is not None

    def finish(self) -> None:
        """Do everything that is left, once no frame follows."""
        scene_depth = self.mapper.scene_depth
        self.lag.insert()
        while (k := self.graph.due(at_end=True)) is not None:
            self._make_factor_of(k)
        if self.graph.changed:
            self.optimise_trajectory(scene_depth)
        self.close_loop(scene_depth)
        self.lag.sweep_last(scene_depth)
        self.lag.insert()
        self.mapper.optimiser.work_all()

    # -- jobs --------------------------------------------------------------------------------------------------------

    def optimise_trajectory(self, _: float) -> None:
        """Correct the poses to those that minimise the factors' costs."""
        self.trajectory.correct(self.graph.optimise(self.trajectory, self.mapper.scene_depth))

    def close_loop(self, _: float) -> None:
        """Correct all poses, and the map, once a place is recognised that they have elsewhere."""
        self.trajectory.correct(self.graph.optimise_with_revisits(self.trajectory, self.mapper.scene_depth))

    def make_factor(self, _: float) -> None:
        """Make the bundle-adjustment factor that is due, if one is."""
        k = self.graph.due()
        if k is not None:
            self._make_factor_of(k)

    def insert_depth(self, _: float) -> None:
        """Put swept depth into the map, and plan training for what it brought."""
        before = len(self.mapper.map)
        self.lag.insert()
        self.mapper.plan_for_new(before)

    def _make_factor_of(self, k: int) -> None:
        m = self.mapper
        render = m.occluded.look(m.renderer, self.trajectory[self.graph.frames[k].index], sloped=True)
        self.graph.make_factor(k, self.trajectory, render.expected_depth(0.5))
