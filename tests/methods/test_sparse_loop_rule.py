"""With an IMU, sparse closes no loop that the gyroscope contradicts."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.geometry import Sim3, so3_exp
from panobench.methods.base import MethodContext
from panobench.methods.sparse import method as module
from panobench.methods.sparse.method import SparseMethod
from panobench.methods.sparse.pointmap import Keyframe, PointMap
from panobench.methods.sparse.session import Session


def close(monkeypatch: pytest.MonkeyPatch, degrees: float, knows_scale: bool) -> tuple[Session, list[str]]:
    """The session after a loop that turns the camera by so much was found, and what was said."""
    said: list[str] = []
    method = SparseMethod()
    method.start(ErpCamera(64, 32), MethodContext(log=said.append))
    if knows_scale:
        method.inertial.predictor = SimpleNamespace(initial=object())  # type: ignore[assignment]
    m = PointMap(1)
    nothing, no_bearings = np.zeros(0, np.int64), np.zeros((0, 3))
    m.keyframes = [Keyframe(k, 10 * k, np.eye(4), nothing, no_bearings) for k in range(2)]
    session = Session(m)
    turn = Sim3(1.0, so3_exp([0.0, np.radians(degrees), 0.0]), np.array([0.3, 0.0, 0.0]))
    loop = SimpleNamespace(old=0, correction=turn)
    monkeypatch.setattr(module, "detect_loop", lambda *a, **k: loop)
    monkeypatch.setattr(module, "close_loop", lambda *a: np.ones(2))
    monkeypatch.setattr(module, "adjust_window", lambda *a, **k: 0.0)
    method._close_loop(session, [], m.keyframes[1])
    method.pool.shutdown()
    return session, said


@pytest.mark.parametrize(("degrees", "loops"), [(0.5, 1), (2.9, 1), (3.1, 0), (178.0, 0)])
def test_a_loop_may_turn_the_camera_by_less_than_the_gyroscope_knows(
    monkeypatch: pytest.MonkeyPatch, degrees: float, loops: int
) -> None:
    session, said = close(monkeypatch, degrees, knows_scale=True)
    assert session.loops == loops
    assert session.last_loop == loops  # the keyframe's number: a refused loop may be followed by another at once
    assert any("is refused" in line for line in said) == (not loops)


@pytest.mark.parametrize(("degrees", "loops"), [(3.1, 1), (40.0, 1), (50.0, 0), (178.0, 0)])
def test_without_an_imu_a_loop_may_turn_the_camera_by_what_may_be_drift(
    monkeypatch: pytest.MonkeyPatch, degrees: float, loops: int
) -> None:
    session, said = close(monkeypatch, degrees, knows_scale=False)
    assert session.loops == loops
    assert any("is refused" in line for line in said) == (not loops)
