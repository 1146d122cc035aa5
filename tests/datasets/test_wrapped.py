"""What sequences made from another one pass on."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.cameras.erp import ErpCamera
from panobench.datasets.base import FrameSequence
from panobench.datasets.synthetic.disturb import Disturbances
from panobench.datasets.synthetic.disturbed import DisturbedSequence
from panobench.datasets.writing.converted import ConvertedSequence
from panobench.testing import TinySequence, erp_camera


class Recorded(TinySequence):
    """A recording with a clock, names, remarks and truth without a scale."""

    start_time = 12.5
    groundtruth_scaled = False
    enlargement = 1.5
    world_up: NDArray[np.float64] = np.array([0.0, -1.0, 0.0])

    def frame_name(self, index: int) -> str:
        return f"picture-{index}"

    def remarks(self) -> list[str]:
        return ["times were assumed"]


@pytest.mark.parametrize(
    "wrap",
    [
        lambda source: ConvertedSequence(source, ErpCamera(64, 32)),
        lambda source: DisturbedSequence(source, Disturbances.parse(["noise=0.02"]), "noisy"),
    ],
)
def test_what_is_known_of_a_recording_is_passed_on(wrap: type[FrameSequence]) -> None:
    source = Recorded(erp_camera(128), n=3)
    made = wrap(source)  # type: ignore[call-arg, arg-type]
    assert made.start_time == 12.5
    assert made.frame_name(2) == "picture-2"
    assert not made.groundtruth_scaled
    assert made.world_up is source.world_up
    assert made.enlargement == max(1.0, 1.5 * made.camera.width / 128)
    assert "times were assumed" in made.remarks()
    assert made.groundtruth is not None
