"""The score of the Hilti x Trimble x Oxford 360 visual-inertial challenge of 2026.

After alignment without scale a pose with a position error of e metres has 100 exp(-c e) points, c = ln(100) / 10: 100
without error, 1 at 10 m. The score is the mean over the poses, and 0 where less than 99% of the true poses have an
estimate ("Scoring Metric", https://github.com/Hilti-Research/hilti-trimble-slam-challenge-2026).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from panobench.metrics.alignment import match
from panobench.metrics.base import MetricInput
from panobench.metrics.trajectory import align

#: Of whose sequences the score is measured.
DATASET = "hilti-360"
#: Per metre, to the organisers' digits.
DECAY = 0.46051701859880917
#: A smaller share of the true poses that have an estimate scores 0.
LEAST_COVERAGE = 0.99


def challenge_metrics(data: MetricInput) -> dict[str, float | None]:
    """The score, 0..100, of runs on the challenge's data set, whether or not the method knows its scale."""
    truth = data.sequence.groundtruth
    if data.sequence.dataset != DATASET or truth is None:
        return {}
    matched = match(data.estimate.trajectory, truth)
    coverage = 0.0 if matched is None else len(matched) / len(truth)
    if matched is None or coverage < LEAST_COVERAGE:
        data.notes["challenge_score"] = f"{coverage:.1%} of the true poses have an estimate; under 99% scores 0"
        return {"challenge_score": 0.0}
    aligned = align(matched, "se3")
    if aligned is None:
        return {}
    return {"challenge_score": score(aligned.errors()[0])}


def score(errors: NDArray[np.float64]) -> float:
    """Mean points of position errors (N,) in metres, at most 100."""
    return min(100.0, float(np.mean(100.0 * np.exp(-DECAY * np.abs(errors)))))
