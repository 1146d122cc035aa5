"""The verdict on a run, from everything that can be known about it without ground truth."""

from __future__ import annotations

from collections.abc import Mapping

from panobench.types import Estimate
from panobench.verdict import estimate as own
from panobench.verdict import trajectory as path
from panobench.verdict.base import TRUSTED, Evidence, Verdict, decide
from panobench.verdict.height import steady_height

#: Trust in a second method's opinion from which it confirms the path.
CONFIRMED = 0.9


def assess(
    estimate: Estimate,
    given: int,
    metrics: Mapping[str, float | None] | None = None,
    others: Mapping[str, Estimate] | None = None,
    rejected: str = "",
    not_rigid: float = 0.0,
) -> Verdict:
    """The verdict on an estimate for ``given`` frames.

    metrics: what the run's own map scored at the frames themselves. others: by name, what other methods say of the
    same frames. rejected: why the run does not count anyway ("" if it does); the verdict is then "failed".
    not_rigid: the share of the view that does not move as a rigid scene, where it is too much to hide.
    """
    asked = others or {}
    opinions = [
        path.second_method(estimate.trajectory, e.trajectory, name, given, unsure=_unsure(e))
        for name, e in asked.items()
    ]
    agreeing = [
        e.trajectory
        for e, opinion in zip(asked.values(), opinions)
        if opinion is not None and opinion.trust > CONFIRMED
    ]
    found: list[Evidence | None] = [
        path.coverage(len(estimate.trajectory), given),
        path.steadiness(estimate.trajectory, agreeing),
        own.first_depth(estimate, confirmed=bool(agreeing)),
        own.agreement(estimate),
        own.reprojection(estimate),
        own.rigid_scene(not_rigid),
        steady_height(estimate),
        own.inertial(estimate),
        own.joined_maps(estimate),
        own.map_pictures(metrics or {}, moving=estimate.extra.get("moving") is True),
        *opinions,
    ]
    if rejected:
        found.append(Evidence("status", 0.0, rejected))
    return decide([e for e in found if e is not None])


def _unsure(other: Estimate) -> bool:
    """Whether a second method's own features do not fit its path."""
    fit = own.reprojection(other)
    return fit is not None and fit.trust < TRUSTED
