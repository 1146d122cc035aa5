"""PanoGS with its map on a device: the same frames give nearly the same poses and pictures as on the CPU."""

from __future__ import annotations

import numpy as np
import pytest
from cuda_devices import DEVICES
from panogs_options import configured

from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.depth.simple import OracleDepth
from panobench.gpu.device import Device
from panobench.methods.base import MethodContext
from panobench.methods.panogs.method import PanogsMethod
from panobench.types import Estimate, Frame

CONFIG = configured(mapping__iterations=4, start__iterations=8, mapping__steps_per_frame=1, mapping__final_iterations=2)


def run(device: Device | None) -> tuple[PanogsMethod, Estimate]:
    sequence = RoomsDataset().open("tiny", width=64)
    method = PanogsMethod(CONFIG)
    method.start(sequence.camera, MethodContext(make_depth=OracleDepth, device=device))
    for i in range(4):
        method.track(Frame(i, float(sequence.times[i]), sequence.image(i), depth=sequence.depth(0) if i == 0 else None))
    return method, method.finish()


@pytest.mark.slow
@pytest.mark.parametrize("name", list(DEVICES))
def test_a_run_on_a_device_is_that_of_the_cpu(name: str) -> None:
    device = DEVICES[name]()
    (method, mine), (_, cpus) = run(device), run(None)
    assert method.device is device
    assert method.mapper.map.gaussians.device is device  # type: ignore[attr-defined]
    np.testing.assert_allclose(mine.trajectory.T_wc, cpus.trajectory.T_wc, atol=2e-3)
    assert mine.map is not None
    assert cpus.map is not None
    assert type(mine.map) is type(cpus.map)
    assert abs(len(mine.map.means) - len(cpus.map.means)) < 0.02 * len(cpus.map.means)


def test_a_camera_that_the_device_cannot_draw_is_drawn_by_the_cpu() -> None:
    said: list[str] = []
    method, device = PanogsMethod(CONFIG), DEVICES["emulated"]()
    camera = PinholeCamera(64, 48, fx=40.0, fy=40.0, cx=32.0, cy=24.0)
    method.start(camera, MethodContext(device=device, warn=said.append))
    assert method.device is None
    assert said == ["the GPU draws panoramas of one centre on the sphere alone: this run uses the CPU"]
