"""The built-in plugins keep the contract that is asked of others."""

from __future__ import annotations

import pytest

from panobench.plugins import load_registry
from panobench.specs import CameraSpec, DepthSpec, MethodSpec, MetricSpec
from panobench.testing import check_spec
from panobench.testing.conformance import Check, Options

BUILT_IN = load_registry(entry_points=False)
#: Methods whose defaults are too slow for a test.
PRESETS = {"monogs": "fast", "photoslam": "fast", "reconstruct": "fast"}


def failed(checks: list[Check]) -> list[str]:
    return [f"{c.name}: {c.message}" for c in checks if c.outcome == "fail"]


@pytest.mark.parametrize("name", BUILT_IN.specs(CameraSpec))
def test_cameras(name: str) -> None:
    assert failed(check_spec(BUILT_IN.get(CameraSpec, name))) == []


@pytest.mark.parametrize("name", BUILT_IN.specs(MetricSpec))
def test_metrics(name: str) -> None:
    assert failed(check_spec(BUILT_IN.get(MetricSpec, name))) == []


@pytest.mark.parametrize("name", ["constant", "oracle"])
def test_depth_estimators(name: str) -> None:
    assert failed(check_spec(BUILT_IN.get(DepthSpec, name))) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", BUILT_IN.specs(MethodSpec))
def test_methods(name: str) -> None:
    assert failed(check_spec(BUILT_IN.get(MethodSpec, name), Options(preset=PRESETS.get(name, "")))) == []
