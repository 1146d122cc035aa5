"""Masks from a segmentation network: what is hidden where, in which frames, and descriptions that are wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from panobench.bench.run.masking import choose_mask
from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.errors import InputError, UsageError
from panobench.masks.base import MaskEstimate
from panobench.masks.network import NetworkMask, check_mask_description, network_files
from panobench.testing import TinySequence

pytest.importorskip("onnxruntime")
pytest.importorskip("onnx")
SIZE = {"width": 128, "height": 64}
#: Scores of three classes: nothing, red things, green things.
SCORES = np.array([[0.0, 0.0, 0.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]], np.float32)


def write_network(path: Path, weights: np.ndarray, **values: Any) -> Path:
    """A 1x1 convolution that answers ``weights`` (classes, 3) . (r, g, b) less 0.5 for each but the first class."""
    from onnx import TensorProto, helper, numpy_helper

    offset = np.full(len(weights), -0.5, np.float32)
    offset[0] = 0.0 if len(weights) > 1 else -0.5
    tensors = [
        numpy_helper.from_array(weights.reshape(len(weights), 3, 1, 1), "w"),
        numpy_helper.from_array(offset, "b"),
    ]
    graph = helper.make_graph(
        [helper.make_node("Conv", ["image", "w", "b"], ["classes"])],
        "tiny",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, 3, "h", "w"))],
        [helper.make_tensor_value_info("classes", TensorProto.FLOAT, None)],
        tensors,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    path.with_suffix(".yaml").write_text(yaml.safe_dump({**SIZE, **values}))
    return path


class Walk(TinySequence):
    """Below stands something red all the time; something green walks by, at x = 20 in frame 0, 20 further in each."""

    def __init__(self, camera: Camera, n: int = 4) -> None:
        super().__init__(camera, n=n)

    def image(self, index: int) -> np.ndarray:
        out = np.full((self.camera.height, self.camera.width, 3), 90, np.uint8)
        out[: self.camera.height // 3] = 120
        w = self.camera.width
        at = (np.arange(w) - 20 - 20 * index + w // 2) % w - w // 2
        out[20:40, np.abs(at) < 6] = (0, 250, 0)
        out[-10:] = (250, 0, 0)
        return out


def estimate(network: Path, camera: Camera, n: int = 4) -> MaskEstimate:
    return NetworkMask(str(network)).estimate(Walk(camera, n))


def test_what_stays_is_hidden_in_all_frames_and_what_walks_in_its_own(tmp_path: Path) -> None:
    network = write_network(tmp_path / "people.onnx", SCORES, meaning="scores", hidden=[1, 2], widen_deg=0)
    found = estimate(network, ErpCamera(128, 64))
    assert not found.valid[-10:].any()
    assert found.valid[:-12].all()
    assert sorted(found.frames) == [0, 1, 2, 3]
    assert not found.frames[1][20:40, 35:46].any()
    assert found.frames[1][20:40, 50:].all()
    assert found.frames[3][20:40, 35:46].all()
    assert "people.onnx hides" in found.message
    one = write_network(tmp_path / "one.onnx", SCORES, meaning="scores", hidden=1, widen_deg=0)
    assert estimate(one, ErpCamera(128, 64)).frames == {}


def test_what_was_found_is_widened_over_the_seam(tmp_path: Path) -> None:
    network = write_network(tmp_path / "green.onnx", SCORES[2:], above=0.0, widen_deg=45 / 4)
    frame = estimate(network, ErpCamera(128, 64), n=6).frames[5]  # the green thing goes from column 115 to 125
    assert not frame[30, 112:].any()
    assert not frame[30, 0]
    assert frame[30, 4:108].all()
    bare = write_network(tmp_path / "bare.onnx", SCORES[2:], above=0.0, widen_deg=0)
    frame = estimate(bare, ErpCamera(128, 64), n=6).frames[5]
    assert not frame[30, 116:125].any()
    assert frame[30, 127]
    assert frame[30, :113].all()


def test_a_pinhole_camera_is_seen_as_it_is_or_as_part_of_a_panorama(tmp_path: Path) -> None:
    camera = PinholeCamera.from_fov(96, 90.0, 60.0)
    direct = write_network(
        tmp_path / "direct.onnx", SCORES[1:2], above=0.0, width=96, height=camera.height, projection="image"
    )
    around = write_network(tmp_path / "around.onnx", SCORES[1:2], above=0.0, width=512, height=256)
    for network in (direct, around):
        found = estimate(network, camera)
        assert not found.valid[-9:, 4:-4].any(), network.name
        assert found.valid[: -20 if network is around else -14].all(), network.name


def test_it_is_chosen_by_the_file_and_its_files_are_known(tmp_path: Path) -> None:
    network = write_network(tmp_path / "people.onnx", SCORES[1:2])
    choice = choose_mask(f"network:{network}", "rooms")
    assert (choice.source, choice.argument) == ("network", str(network))
    assert network_files(str(network)) == [network, network.with_suffix(".yaml")]
    with pytest.raises(UsageError, match="needs an ONNX"):
        choose_mask("network", "rooms")
    with pytest.raises(InputError, match="no such network"):
        choose_mask("network:there-is-none.onnx", "rooms")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"meaning": "score"}, "did you mean 'scores'"),
        ({"meaning": "labels"}, "'hidden' is missing"),
        ({"meaning": "scores", "hidden": ["person"]}, "numbers of classes"),
        ({"hidden": [-1]}, "numbers of classes"),
        ({"hidden": []}, "numbers of classes"),
        ({"widen_deg": 90}, "from 0 to 20 degrees"),
        ({"above": "half"}, "above must be a number"),
        ({"metric": True}, "unknown key 'metric'"),
        ({"height": 100}, "twice as wide as high"),
    ],
)
def test_wrong_descriptions_are_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        check_mask_description({**SIZE, **values}, Path("tiny.yaml"))
    assert str(caught.value).startswith("tiny.yaml")


@pytest.mark.parametrize(
    ("weights", "values", "message"),
    [
        (SCORES, {"meaning": "labels", "hidden": 1}, "one value a pixel is needed"),
        (SCORES, {"meaning": "scores", "hidden": 3}, "class 3 is hidden"),
        (SCORES[:1], {"meaning": "scores", "hidden": 0}, "scores are one picture for each class"),
        (SCORES, {"output": "people"}, "no output 'people'; it has classes"),
    ],
)
def test_outputs_that_are_no_mask_say_why(
    tmp_path: Path, weights: np.ndarray, values: dict[str, Any], message: str
) -> None:
    network = write_network(tmp_path / "tiny.onnx", weights, **values)
    with pytest.raises(InputError, match=message):
        estimate(network, ErpCamera(128, 64))
