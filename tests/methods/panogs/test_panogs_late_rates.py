"""A frame is rectified once more by the motion on both sides of it."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.geometry import make_pose, so3_exp
from panobench.methods.panogs.config import RollingShutterOptions, StitchOptions
from panobench.methods.panogs.rectification.late_rates import LateRates
from panobench.methods.panogs.rectification.rectify import Rectifier
from panobench.methods.panogs.rectification.rolling_shutter import RollingShutter
from panobench.methods.panogs.rectification.seam import Seam
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View

CAMERA = ErpCamera(64, 32)
IMAGE = np.zeros((32, 64, 3), np.uint8)
DEPTH = np.full((32, 64), 2.0, np.float32)


@pytest.fixture
def late(monkeypatch: pytest.MonkeyPatch) -> LateRates:
    """Its rectifier keeps what it is asked for in ``asked``."""
    shutter = RollingShutter(CAMERA, RollingShutterOptions(readout_ms=15.0))
    rectifier = Rectifier(CAMERA, shutter, Seam(CAMERA, StitchOptions()))
    asked: list[tuple[np.ndarray, np.ndarray]] = []
    monkeypatch.setattr(rectifier, "asked", asked, raising=False)

    def rectified(image: np.ndarray, rate: np.ndarray, velocity: np.ndarray, depth_map: np.ndarray) -> np.ndarray:
        asked.append((rate, velocity))
        return image

    monkeypatch.setattr(rectifier, "rectified", rectified)
    return LateRates(rectifier, AnchoredTrajectory())


def walk(late: LateRates, indices: list[int], noise: float = 0.0) -> None:
    """Yaw t^3 and z = t^3, seen at 15 frames a second."""
    rng, first = np.random.default_rng(0), View(0, IMAGE, np.eye(4))
    late.trajectory.add_keyframe(first, 0.0)
    for i in indices:
        t = i / 15
        T = make_pose(so3_exp([0.0, t**3 + noise * rng.standard_normal(), 0.0]), [0.0, 0.0, t**3])
        late.trajectory.add(i, t, T, first)
        late.add(i, t, IMAGE, DEPTH)


@pytest.mark.parametrize("indices", [[3, 4, 5, 6, 7], [7, 6, 5, 4, 3]])
def test_the_middle_frame_is_rectified_by_the_rates_on_both_sides(late: LateRates, indices: list[int]) -> None:
    walk(late, indices)
    found = late.rectified()
    assert found is not None
    assert found[0] == 5
    rate, velocity = late.rectifier.asked[-1]  # type: ignore[attr-defined]
    t = 5 / 15
    assert np.allclose(rate, [0, 3 * t * t, 0], atol=1e-9)
    assert np.allclose(velocity, so3_exp([0.0, t**3, 0.0]).T @ [0, 0, 3 * t * t], atol=1e-9)


def test_without_five_frames_in_a_row_nothing_is_rectified(late: LateRates) -> None:
    walk(late, [1, 2, 3, 4])
    assert late.rectified() is None
    late.add(6, 6 / 15, IMAGE, DEPTH)
    assert late.rectified() is None
    walk(late, [11, 12, 13, 14, 15])
    late.forget()
    assert late.rectified() is None


def test_a_frame_that_was_lost_tells_nothing(late: LateRates) -> None:
    walk(late, [1, 2, 3, 4, 5])
    late.trajectory.pop(4)
    assert late.rectified() is None
