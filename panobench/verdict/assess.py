"""The verdict on a run, from everything that can be known about it without ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from panobench.types import Estimate
from panobench.verdict import estimate as own
from panobench.verdict import trajectory as path
from panobench.verdict.base import TRUSTED, Evidence, Verdict, decide
from panobench.verdict.height import steady_height

#: The name under which a method that goes through the frames backwards is asked: it is not another one.
BACKWARDS = "backwards"
#: Trust in a second method's opinion from which it confirms the path.
CONFIRMED = 0.9


def assess(
    estimate: Estimate,
    given: int,
    metrics: Mapping[str, float | None] | None = None,
    others: Mapping[str, Estimate] | None = None,
    rejected: str = "",
    not_rigid: float = 0.0,
    enlargement: float = 1.0,
) -> Verdict:
    """The verdict on an estimate for ``given`` frames.

    metrics: what the run's own map scored at the frames themselves. others: by name, what other methods say of the
    same frames. rejected: why the run does not count anyway ("" if it does); the verdict is then "failed".
    not_rigid: the share of the view that does not move as a rigid scene, where it is too much to hide.
    enlargement: how much larger than recorded the frames were, see ``FrameSequence.enlargement``.
    """
    asked = others or {}
    opinions = [
        path.second_method(estimate.trajectory, e.trajectory, name, given, unsure=_unsure(e, enlargement))
        for name, e in asked.items()
    ]
    agreeing = [e for e, opinion in zip(asked.values(), opinions) if opinion is not None and opinion.trust > CONFIRMED]
    agreement = own.agreement(estimate)
    agrees = agreement is not None and agreement.trust == 1.0
    found: list[Evidence | None] = [
        path.coverage(len(estimate.trajectory), given),
        path.steadiness(estimate.trajectory, [e.trajectory for e in agreeing]),
        own.first_depth(estimate, confirmed=bool(agreeing)),
        agreement,
        own.reprojection(estimate, enlargement),
        own.rigid_scene(not_rigid),
        steady_height(estimate),
        own.inertial(estimate),
        own.joined_maps(estimate, followed=any(_unbroken(e, given) for e in agreeing)),
        own.map_pictures(metrics or {}, moving=estimate.extra.get("moving") is True, agrees=agrees),
    ]
    doubts_itself = any(e is not None and e.trust < TRUSTED for e in found)
    found += opinions
    if rejected:
        found.append(Evidence("status", 0.0, rejected))
    verdict = decide([e for e in found if e is not None])
    better = _better(asked, given, enlargement) if doubts_itself and not not_rigid else None
    return verdict if better is None else replace(verdict, advice=(better, *verdict.advice))


def _unbroken(other: Estimate, given: int) -> bool:
    """Whether a method says that it followed the camera through all frames, in one map, and never looked for it."""
    whole = path.coverage(len(other.trajectory), given).trust == 1.0
    return whole and other.extra.get("maps") == 1 and other.extra.get("relocalised") == 0


def _better(asked: Mapping[str, Estimate], given: int, enlargement: float) -> str | None:
    """Advice to take another method that was asked, if nothing that it says of itself is against it."""
    for name, other in asked.items():
        track = other.trajectory
        about = [path.coverage(len(track), given), path.steadiness(track), own.reprojection(other, enlargement)]
        if name != BACKWARDS and all(e is None or e.trust >= CONFIRMED for e in about):
            return (
                f"try '{name}' (--method {name}): it has {len(track)} of {given} frames, and nothing in its own path "
                "speaks against it"
            )
    return None


def _unsure(other: Estimate, enlargement: float) -> bool:
    """Whether a second method's own features do not fit its path."""
    fit = own.reprojection(other, enlargement)
    return fit is not None and fit.trust < TRUSTED
