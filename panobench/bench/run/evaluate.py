"""Score a finished run with every registered metric, and judge whether it counts as tracked."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from panobench.bench.records.record import METRIC_NAMES
from panobench.errors import PanobenchError
from panobench.metrics.base import FAILED_ATE_M, MIN_TRACKED, MetricInput
from panobench.plugins import registry
from panobench.specs import MetricSpec
from panobench.types import RunStatus
from panobench.writing import is_disk_full


@dataclass
class Scores:
    """What a run scored. notes: metric or key -> why it is None. status and message are the run's."""

    status: RunStatus
    message: str
    metrics: dict[str, float | None] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    evaluation_s: float = 0.0


def evaluate(data: MetricInput, status: RunStatus, message: str, log: Callable[[str], None]) -> Scores:
    """Compute every metric of a run that went through or was interrupted, and only the coverage of a failed one.

    A metric that raises leaves its keys None, with a note, and never changes the run's status. Only a full disk is
    raised, as the run could not be stored then.
    """
    begin = time.perf_counter()
    scores = Scores(status, message, dict.fromkeys(METRIC_NAMES))
    scored = status in (RunStatus.OK, RunStatus.INTERRUPTED)
    try:
        for spec in registry().specs(MetricSpec).values() if scored else ():
            scores.metrics.update(_measure(spec, data, scores.notes, log))
    except KeyboardInterrupt:
        scores.status, scores.message = RunStatus.INTERRUPTED, "interrupted while it was scored"
    scores.notes.update(data.notes)
    scores.metrics["tracked"] = len(data.estimate.trajectory) / len(data.frames) if data.frames else 0.0
    if scores.status is RunStatus.OK:
        scores.status, scores.message = judge(scores.metrics, 0.0 if data.keyframes_only else MIN_TRACKED)
    scores.evaluation_s = time.perf_counter() - begin
    return scores


@dataclass(frozen=True)
class BrokenLimit:
    """A limit of the protocol that a run broke. short: in a few words, for tables."""

    short: str
    message: str


def judge(
    metrics: Mapping[str, float | None], min_tracked: float = MIN_TRACKED, failed_ate_m: float = FAILED_ATE_M
) -> tuple[RunStatus, str]:
    """Apply the protocol's limits on coverage and error: OK, or LOST with the reason."""
    broken = broken_limit(metrics, min_tracked, failed_ate_m)
    return (RunStatus.OK, "") if broken is None else (RunStatus.LOST, broken.message)


def broken_limit(
    metrics: Mapping[str, float | None], min_tracked: float = MIN_TRACKED, failed_ate_m: float = FAILED_ATE_M
) -> BrokenLimit | None:
    """The first limit on coverage or error that the metrics break.

    A method that says its scale is metric is held to its error without scale alignment as well: Sim(3) shrinks a
    trajectory that diverged by kilometres to a point near the truth's centre.
    """
    tracked, ate = metrics.get("tracked"), metrics.get("ate_rmse_m")
    ate_se3 = metrics.get("ate_se3_rmse_m")  # measured for metric methods only
    if tracked is not None and tracked < min_tracked:
        return BrokenLimit(
            f"tracked {tracked:.0%}", f"tracked {tracked:.1%} of the frames, the protocol asks for {min_tracked:.0%}"
        )
    if ate is not None and ate > failed_ate_m:
        return BrokenLimit(f"ATE over {failed_ate_m:g} m", f"ATE {ate:.2f} m is over the protocol's {failed_ate_m:g} m")
    if ate_se3 is not None and ate_se3 > failed_ate_m:
        reason = f"ATE without scale alignment {ate_se3:.2f} m is over the protocol's {failed_ate_m:g} m"
        return BrokenLimit(f"metric ATE over {failed_ate_m:g} m", f"{reason}; the method says its scale is metric")
    return None


def _measure(
    spec: MetricSpec, data: MetricInput, notes: dict[str, str], log: Callable[[str], None]
) -> dict[str, float | None]:
    nothing: dict[str, float | None] = dict.fromkeys(spec.keys)
    reason = spec.unavailable()
    if reason:
        notes[spec.name] = f"n/a: {reason}"
        return nothing
    try:
        values = spec.load()(data)
    except Exception as error:  # a plugin's metric or a renderer failed; the run is stored all the same
        if is_disk_full(error):
            raise
        if isinstance(error, PanobenchError):
            notes[spec.name] = str(error)
            return nothing
        notes[spec.name] = f"{type(error).__name__}: {error}"
        log(f"metric {spec.name} failed: {type(error).__name__}: {error}")
        return nothing
    unknown = sorted(set(values) - set(spec.keys))
    if unknown:
        notes[spec.name] = f"returned {', '.join(unknown)}, which its spec does not name"
    return {**nothing, **{k: None if v is None else float(v) for k, v in values.items() if k in spec.keys}}
