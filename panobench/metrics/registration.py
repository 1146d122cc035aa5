"""Specs of the built-in metrics."""

from panobench.specs import MetricSpec

METRICS: tuple[MetricSpec, ...] = ()
