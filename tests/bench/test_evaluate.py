"""Whether a scored run counts as tracked."""

from __future__ import annotations

import dataclasses

import pytest

from panobench.bench.run.evaluate import evaluate, judge
from panobench.testing import TinySequence, made_up_run
from panobench.types import Estimate, RunStatus, Trajectory


@pytest.mark.parametrize(
    ("metrics", "status", "reason"),
    [
        ({"tracked": 1.0, "ate_rmse_m": 0.1}, RunStatus.OK, ""),
        ({"tracked": 0.89, "ate_rmse_m": 0.1}, RunStatus.LOST, "tracked 89.0%"),
        ({"tracked": 1.0, "ate_rmse_m": 3.1}, RunStatus.LOST, "ATE 3.10 m"),
        ({"tracked": 1.0, "ate_rmse_m": 0.7, "ate_se3_rmse_m": 105.0}, RunStatus.LOST, "without scale alignment 105"),
        ({"tracked": 1.0, "ate_rmse_m": 0.7, "ate_se3_rmse_m": 0.8}, RunStatus.OK, ""),
        ({"tracked": 1.0, "ate_rmse_m": None, "ate_se3_rmse_m": None}, RunStatus.OK, ""),
    ],
)
def test_the_limits_of_the_protocol(metrics: dict[str, float | None], status: RunStatus, reason: str) -> None:
    found, message = judge(metrics)
    assert found is status
    assert message.startswith(reason) or reason in message
    assert bool(message) == (status is not RunStatus.OK)


def test_a_metric_run_that_diverged_is_lost_although_its_shape_fits() -> None:
    sequence = TinySequence(n=8)
    truth = sequence.groundtruth
    assert truth is not None
    T = truth.T_wc.copy()
    T[:, :3, 3] *= 1500.0
    for metric, status in ((True, RunStatus.LOST), (False, RunStatus.OK)):
        estimate = Estimate(Trajectory(truth.times, T), metric=metric)
        data = dataclasses.replace(made_up_run(sequence), estimate=estimate, render=None)
        scores = evaluate(data, RunStatus.OK, "", lambda _: None)
        assert scores.metrics["ate_rmse_m"] < 1e-6
        assert scores.status is status, scores.message
