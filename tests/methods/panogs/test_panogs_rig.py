"""panogs on a rig: through each lens from its own centre, in metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig import Rig
from panobench.cameras.rig_panorama import LensCentres
from panobench.cameras.stitching import Stitcher
from panobench.depth.bootstrap import BootstrapDepth
from panobench.geometry import make_pose, so3_exp, umeyama
from panobench.methods.base import MethodContext
from panobench.methods.panogs.config import PanogsConfig, RigOptions, RollingShutterOptions
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.panogs.rigs.frames import RigFrames
from panobench.methods.panogs.rigs.scale import RigScale
from panobench.testing import TinySequence, erp_camera, two_lenses
from panobench.types import Estimate, Frame

RIG = two_lenses(136, 0.12)


class Stitched(TinySequence):
    """Its panoramas are stitched from the lenses' pictures for things two metres away."""

    def image(self, index: int) -> np.ndarray:
        return Stitcher(RIG, self.camera, distance_m=2.0).image(self.lens_images(index))


def pose(t: float) -> np.ndarray:
    R = so3_exp([0.1 * np.sin(1.7 * t), 0.7 * np.sin(0.9 * t), 0.06 * np.sin(1.1 * t)])
    return make_pose(R, [0.6 * np.sin(0.8 * t), 0.15 * np.sin(1.4 * t), 0.5 * np.sin(1.1 * t + 1)])


@pytest.fixture(scope="module")
def sequence() -> Stitched:
    return Stitched(erp_camera(256), 22, pose=pose, rig=RIG)


def run(sequence: Stitched, enabled: bool) -> tuple[Estimate, list[str]]:
    said: list[str] = []
    method = PanogsMethod(PanogsConfig(rig=RigOptions(enabled)))
    context = MethodContext(make_depth=BootstrapDepth, rig=sequence.rig, log=said.append, warn=said.append)
    method.start(sequence.camera, context)
    for k, time in enumerate(sequence.times):
        method.track(Frame(k, float(time), sequence.image(k), lenses=sequence.lens_images(k)))
    return method.finish(), said


def errors(estimate: Estimate, sequence: Stitched) -> tuple[float, float]:
    """ATE after Sim(3) in metres, and the scale by which the estimate would have to grow."""
    assert len(estimate.trajectory) == len(sequence)
    truth = sequence.groundtruth
    assert truth is not None
    S = umeyama(estimate.trajectory.positions, truth.positions)
    e = S.apply_points(estimate.trajectory.positions) - truth.positions
    return float(np.sqrt((e**2).sum(axis=1).mean())), S.scale


def test_each_lens_from_its_own_centre_beats_the_stitched_panorama_and_is_in_metres(sequence: Stitched) -> None:
    estimate, said = run(sequence, enabled=True)
    ate, scale = errors(estimate, sequence)
    stitched, _ = run(sequence, enabled=False)
    other, _ = errors(stitched, sequence)
    assert ate < 0.2 * other
    assert estimate.metric
    assert not estimate.gravity_aligned
    assert not stitched.metric
    sigma = estimate.extra["scale_sigma_percent"]
    assert abs(scale - 1) < 0.05
    assert abs(scale - 1) < 0.03 * sigma  # three of the standard deviations that it states
    assert sigma < 10
    assert any("by the lenses' distance" in line for line in said)


def test_measurements_are_weighted_and_their_scatter_counts() -> None:
    lenses = LensCentres(np.array([[0.0, 0, 0.02], [0, 0, -0.02]]), np.array([[0.0, 0, 1], [0, 0, -1]]))
    scale = RigScale(lenses, 2.0, lambda line: None)
    assert scale.sigma(0.01, 2.0) == float("inf")
    assert scale.held() is None
    scale.add(0, (1.0, 0.01))
    scale.add(8, (float("nan"), float("inf")))  # tells nothing
    assert lenses.units_per_metre == 1.0
    alone = scale.sigma(1e-6, 2.0)
    assert alone == pytest.approx(0.01, rel=0.05)
    scale.add(8, (1.2, 0.02))
    assert lenses.units_per_metre == pytest.approx((4 * 1.0 + 1.2) / 5)
    assert scale.sigma(1e-6, 2.0) > 3 * alone  # they contradict one another
    scale.add(8, (1.0, 0.02))  # the same frame again replaces the first
    assert lenses.units_per_metre == 1.0
    assert scale.sigma(0.02, 2.0) > 0.03  # 0.02 pixels of bias are a share of a parallax of half a pixel


def test_what_holds_the_scale_follows_the_map_and_allows_for_scatter() -> None:
    lenses = LensCentres(np.array([[0.0, 0, 0.02], [0, 0, -0.02]]), np.array([[0.0, 0, 1], [0, 0, -1]]))
    scale = RigScale(lenses, 4.0, lambda line: None)
    scale.add(0, (1.0, 0.1))
    scale.add(8, (1.1, 0.1))
    held = scale.held()
    assert held is not None
    assert held.units == pytest.approx(1.05)
    assert held.inflation == pytest.approx(2.0)  # each frame is in four bundles
    scale.add(8, (1.1, 0.1), 1.2)
    assert lenses.units_per_metre == pytest.approx((1.0 / 0.1**2 + 1.32 / 0.12**2) / (1 / 0.1**2 + 1 / 0.12**2))
    held = scale.held()
    assert held is not None
    assert held.inflation > 2.5
    scale.follow({0: 1.32, 16: 2.0})  # all that was measured agrees now; 16 never was
    held = scale.held()
    assert held is not None
    assert held.units == pytest.approx(1.32)
    assert held.inflation == pytest.approx(2.0)


@pytest.mark.parametrize(("stated", "given", "used"), [(None, 0.0, 0.0), (0.02, 0.0, 20.0), (0.02, 7.0, 7.0)])
def test_a_readout_that_the_rig_states_is_used_where_none_is_given(
    stated: float | None, given: float, used: float
) -> None:
    rig = Rig(tuple(replace(lens, readout_s=stated) for lens in RIG.lenses))
    frames = RigFrames(rig, ErpCamera(128, 64), 6.0, MethodContext())
    assert frames.rolling_shutter(RollingShutterOptions(readout_ms=given)).readout_ms == used
