"""Depth from network files: cameras, conventions, and files that strangers made."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.factory import parse_camera_option
from panobench.cameras.pinhole import PinholeCamera
from panobench.depth.network import MEDIAN_DEPTH, NetworkDepth
from panobench.depth.network_description import check_description
from panobench.depth.network_model import TRUST_VARIABLE
from panobench.errors import InputError, UsageError
from panobench.types import DepthEstimate, Frame

pytest.importorskip("onnxruntime")
onnx = pytest.importorskip("onnx")

#: The networks here answer WEIGHTS . (r, g, b) + OFFSET per pixel.
WEIGHTS, OFFSET = (1.0, 2.0, 4.0), 0.5
SIZE = {"width": 128, "height": 64}


def write_onnx(path: Path, *, last: str = "", shape: tuple[Any, ...] = ("n", 3, "h", "w"), **tensor: Any) -> Path:
    """A 1x1 convolution, then the operator ``last``; ``tensor`` overrides fields of its weights."""
    from onnx import TensorProto, helper, numpy_helper

    weights = numpy_helper.from_array(np.array(WEIGHTS, np.float32).reshape(1, 3, 1, 1), "w")
    offset = numpy_helper.from_array(np.array([OFFSET], np.float32), "b")
    for key, value in tensor.items():
        if key == "location":
            weights.ClearField("raw_data")
            weights.data_location = TensorProto.EXTERNAL
            weights.external_data.add(key="location", value=value)
    domain = last.partition("::")[0] if "::" in last else ""
    nodes = [helper.make_node("Conv", ["image", "w", "b"], ["conv"])]
    nodes.append(helper.make_node(last.rpartition("::")[2] or "Identity", ["conv"], ["depth"], domain=domain))
    graph = helper.make_graph(
        nodes,
        "tiny",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info("depth", TensorProto.FLOAT, None)],
        [weights, offset],
    )
    opsets = [helper.make_opsetid("", 17)] + ([helper.make_opsetid(domain, 1)] if domain else [])
    model = helper.make_model(graph, opset_imports=opsets, ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def describe(network: Path, **values: Any) -> Path:
    import yaml

    network.with_suffix(".yaml").write_text(yaml.safe_dump({**SIZE, **values}))
    return network


def picture(camera: Camera) -> np.ndarray:
    """A smooth image: the colour of a pixel is its ray in an upright camera's axes."""
    from panobench.cameras.views import upright_rotation

    rays = np.nan_to_num(camera.rays()) @ upright_rotation(camera).T
    image = np.round(127.5 + 110 * rays).astype(np.uint8)
    image[~camera.valid_mask()] = 0
    return image


def answer(network: Path, camera: Camera) -> DepthEstimate:
    estimator = NetworkDepth(str(network))
    estimator.start(camera)
    estimate = estimator.add(Frame(3, 0.1, picture(camera)))
    assert estimate.frame_index == 3
    return estimate


def expected(camera: Camera) -> np.ndarray:
    values = picture(camera) / 255.0 @ np.array(WEIGHTS) + OFFSET
    return np.where(camera.valid_mask(), values, np.nan)


CAMERAS = {
    "erp": ErpCamera(256, 128),
    "erp-limited": ErpCamera(128, 64, hfov_deg=200.0, lat_min_deg=-50.0),
    "pinhole": PinholeCamera.from_fov(96, 100.0, 70.0),
    "pal": parse_camera_option("pal", ErpCamera(256, 128), 160).camera,
}


@pytest.mark.parametrize("name", CAMERAS)
def test_every_camera_gets_its_depth_where_it_sees(tmp_path: Path, name: str) -> None:
    camera = CAMERAS[name]
    network = describe(write_onnx(tmp_path / "tiny.onnx"), metric=True, centre_deg=90.0)
    estimate = answer(network, camera)
    assert estimate.metric
    assert estimate.depth.dtype == np.float32
    truth = expected(camera)
    assert not np.isfinite(estimate.depth[~camera.valid_mask()]).any()
    # The rim is unknown: the panorama's pixels there are only partly covered.
    assert np.isfinite(estimate.depth[camera.valid_mask()]).mean() > 0.8
    error = np.abs(estimate.depth / truth - 1)
    assert np.nanmedian(error) < 0.01
    assert np.nanpercentile(error, 99) < 0.05


def test_what_is_known_up_to_scale_gets_the_usual_median(tmp_path: Path) -> None:
    camera = CAMERAS["erp"]
    estimate = answer(describe(write_onnx(tmp_path / "tiny.onnx")), camera)
    assert not estimate.metric
    assert np.nanmedian(estimate.depth) == pytest.approx(MEDIAN_DEPTH)
    ratio = estimate.depth / expected(camera)
    assert np.nanstd(ratio) < 0.01 * np.nanmean(ratio)


@pytest.mark.parametrize(
    ("meaning", "last"), [("distance", ""), ("inverse-distance", "Reciprocal"), ("log-distance", "Log")]
)
def test_meanings_of_the_output(tmp_path: Path, meaning: str, last: str) -> None:
    camera = CAMERAS["erp"]
    network = describe(write_onnx(tmp_path / "tiny.onnx", last=last), metric=True, meaning=meaning, scale=2.0)
    assert np.nanmedian(np.abs(answer(network, camera).depth / (2 * expected(camera)) - 1)) < 0.01


def test_z_depth_of_a_perspective_network_becomes_radial(tmp_path: Path) -> None:
    camera = CAMERAS["pinhole"]
    network = write_onnx(tmp_path / "tiny.onnx")
    describe(network, width=camera.width, height=camera.height, projection="image", meaning="z", metric=True)
    assert np.allclose(answer(network, camera).depth, expected(camera) / camera.rays()[..., 2], rtol=1e-3)


def test_normalisation_colour_order_and_far(tmp_path: Path) -> None:
    camera = CAMERAS["erp"]
    network = write_onnx(tmp_path / "tiny.onnx", shape=("n", 3, 64, 128))
    describe(
        network, metric=True, colour="bgr", range=255, mean=[10.0, 20.0, 30.0], std=[100.0, 100.0, 100.0],
        output="depth", far=9.0,
    )  # fmt: skip
    bgr = picture(camera)[..., ::-1].astype(float)
    truth = (bgr - [10, 20, 30]) / 100 @ np.array(WEIGHTS) + OFFSET
    depth = answer(network, camera).depth
    assert np.nanmax(depth) <= 9.0
    assert np.nanmedian(np.abs(depth / truth - 1)) < 0.01
    assert np.isnan(depth[truth > 9.2]).all()


def test_torchscript_needs_trust_then_answers_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    class Tiny(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> dict[str, torch.Tensor]:
            return {"pred_depth": x[:, 0] + 2.0 * x[:, 1] + 4.0 * x[:, 2] + 0.5}

    path = tmp_path / "tiny.pt"
    torch.jit.script(Tiny()).save(str(path))
    describe(path, metric=True, output="pred_depth")
    monkeypatch.delenv(TRUST_VARIABLE, raising=False)
    with pytest.raises(UsageError, match=TRUST_VARIABLE):
        NetworkDepth(str(path))
    monkeypatch.setenv(TRUST_VARIABLE, "1")
    camera = CAMERAS["erp"]
    other = describe(write_onnx(tmp_path / "other.onnx"), metric=True)
    assert np.allclose(answer(path, camera).depth, answer(other, camera).depth, rtol=1e-5, equal_nan=True)
    torch.save(Tiny().state_dict(), path)
    with pytest.raises(InputError, match="weights without a network"):
        answer(path, camera)
    path.write_bytes(b"not a zip")
    with pytest.raises(InputError, match="not a TorchScript archive"):
        answer(path, camera)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"widht": 128}, "did you mean 'width'"),
        ({"width": "128"}, "width must be a whole number"),
        ({"width": 1 << 40}, "width must be a whole number"),
        ({"height": 100}, "twice as wide as high"),
        ({"meaning": "disparity"}, "unknown meaning 'disparity'"),
        ({"meaning": "z"}, "no sense on a panorama"),
        ({"std": [1, 0, 1]}, "std must be positive"),
        ({"mean": [1, 2]}, "three numbers"),
        ({"metric": "yes"}, "true or false"),
        ({"output": True}, "name, or its position"),
        ({"far": float("nan")}, "far must be a number"),
        ({"scale": 10**400}, "scale must be a number"),
    ],
)
def test_wrong_descriptions_are_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        check_description({**SIZE, **values}, Path("tiny.yaml"))
    assert str(caught.value).startswith("tiny.yaml")


def test_a_missing_description_and_unknown_files_are_named(tmp_path: Path) -> None:
    network = write_onnx(tmp_path / "tiny.onnx")
    with pytest.raises(InputError, match=r"tiny\.yaml: the description of tiny\.onnx is missing"):
        NetworkDepth(str(network))
    with pytest.raises(InputError, match="there is no such network"):
        NetworkDepth(str(tmp_path / "other.onnx"))
    with pytest.raises(InputError, match="ends in one of"):
        NetworkDepth(str(tmp_path / "weights.pth"))
    with pytest.raises(UsageError, match="needs an ONNX"):
        NetworkDepth("")


@pytest.mark.parametrize(
    ("options", "values", "message"),
    [
        ({"shape": ("n", 3, 32, 64)}, {}, "input is nx3x32x64, its description says 1x3x64x128"),
        ({"last": "Sqrt"}, {"mean": [2.0, 2.0, 2.0]}, r"NaN.* in 100% of the view"),
        ({"last": "GlobalAveragePool"}, {}, "aspect ratio|one value a pixel"),
        ({}, {"output": "dpeth"}, "no output 'dpeth'; it has depth"),
        ({"last": "evil.corp::Run"}, {}, "custom operators.*evil.corp::Run"),
        ({"location": "../secret.bin"}, {}, "outside its folder"),
        ({"location": "/etc/passwd"}, {}, "outside its folder"),
        ({"location": "linked.bin"}, {}, "outside its folder"),
        ({"location": "missing.bin"}, {}, "not beside it"),
        ({"last": "NoSuchOperator"}, {}, "onnxruntime cannot load it"),
    ],
)
def test_networks_that_cannot_be_used_say_why(
    tmp_path: Path, options: dict[str, Any], values: dict[str, Any], message: str
) -> None:
    (tmp_path / "secret.bin").write_bytes(bytes(64))
    folder = tmp_path / "net"
    folder.mkdir()
    (folder / "linked.bin").symlink_to(tmp_path / "secret.bin")
    network = describe(write_onnx(folder / "tiny.onnx", **options), **values)
    with pytest.raises(InputError, match=message) as caught:
        answer(network, CAMERAS["erp"])
    assert "\n" not in str(caught.value)


def test_damaged_onnx_files_give_one_clean_error(tmp_path: Path) -> None:
    network = describe(write_onnx(tmp_path / "tiny.onnx"))
    whole = network.read_bytes()
    rng = np.random.default_rng(0)
    camera = ErpCamera(32, 16)
    failed = 0
    for _ in range(60):
        data = np.frombuffer(whole, np.uint8).copy()
        data[rng.integers(len(data), size=3)] = rng.integers(256, size=3)
        network.write_bytes(data.tobytes()[: int(rng.integers(len(data) // 2, len(data) + 1))])
        try:
            answer(network, camera)
        except InputError as error:
            failed += "\n" not in str(error)
    assert failed > 30


def test_the_runtime_prints_nothing_about_a_file_it_cannot_load(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    network = describe(write_onnx(tmp_path / "tiny.onnx"))
    refused = 0
    for name in (b"conv", b"depth", b"image", b"tiny", b"Identity"):
        whole = write_onnx(network).read_bytes()
        network.write_bytes(whole.replace(name, b"\x97" + name[1:]))
        try:
            answer(network, ErpCamera(32, 16))
        except InputError:
            refused += 1
    assert refused > 1
    assert capsys.readouterr().out == ""


def test_a_large_file_is_refused_unread(tmp_path: Path) -> None:
    network = describe(tmp_path / "huge.onnx")
    with network.open("wb") as file:
        file.truncate((2 << 30) + 1)
    with pytest.raises(InputError, match="too large"):
        answer(network, CAMERAS["erp"])


def test_the_network_that_comes_along_beats_a_constant_by_far() -> None:
    from panobench.datasets.synthetic.rooms import RoomsDataset
    from panobench.depth.network import RoomsNetDepth

    sequence = RoomsDataset().open("tiny", width=64)
    truth = sequence.depth(0)
    assert truth is not None
    estimator = RoomsNetDepth()
    estimator.start(sequence.camera)
    errors = []
    for depth in (estimator.add(Frame(0, 0.0, sequence.image(0))).depth, np.ones_like(truth)):
        ratio = depth / truth
        errors.append(float(np.nanmedian(np.abs(ratio / np.nanmedian(ratio) - 1))))
    assert errors[0] < 0.3 * errors[1]
