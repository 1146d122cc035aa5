"""Depth networks and their descriptions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mutate import Material
from target import Parse, Target, plain, text

_NETWORK = """width: 32
height: 16
projection: erp
centre_deg: 90
colour: bgr
range: 255
mean: [0.485, 0.456, 0.406]
std: [0.229, 0.224, 0.225]
layout: nchw
output: depth
meaning: inverse-distance
metric: false
scale: 1.0
far: 100.0
"""
_IMAGE_NETWORK = "width: 32\nheight: 24\nprojection: image\nmeaning: z\nmetric: true\noutput: 1\n"


def _parse_description(path: Path) -> None:
    from panobench.depth.network_description import read_description

    found = read_description(path.with_suffix(".onnx"))
    assert found.width * found.height <= 1 << 26


def _onnx_material() -> Material:
    """A small network with its weights inside, and one that keeps them in a file beside it."""
    from onnx import TensorProto, helper, numpy_helper

    documents = []
    for location in ("", "weights.bin"):
        weights = numpy_helper.from_array(np.ones((1, 3, 1, 1), np.float32), "w")
        if location:
            weights.ClearField("raw_data")
            weights.data_location = TensorProto.EXTERNAL
            for key, value in (("location", location), ("offset", "0"), ("length", "12")):
                weights.external_data.add(key=key, value=value)
        graph = helper.make_graph(
            [helper.make_node("Conv", ["image", "w"], ["c"]), helper.make_node("Relu", ["c"], ["depth"])],
            "tiny",
            [helper.make_tensor_value_info("image", TensorProto.FLOAT, (1, 3, 16, 32))],
            [helper.make_tensor_value_info("depth", TensorProto.FLOAT, (1, 1, 16, 32))],
            [weights],
        )
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
        documents.append(model.SerializeToString())
    words = b"Conv Relu Identity com.microsoft weights.bin ../weights.bin /etc/passwd location image depth w ai.onnx.ml"
    return Material(tuple(documents), tuple(words.split()))


def _onnx(folder: Path) -> Parse:
    """The look into the file, and the runtime behind it."""
    from panobench.depth.network_description import check_description
    from panobench.depth.network_model import load_model

    (folder / "weights.bin").write_bytes(np.ones(3, np.float32).tobytes())
    description = check_description({"width": 32, "height": 16}, folder / "net.yaml")
    return lambda path: load_model(path, description)


TARGETS = (
    Target("network-yaml", "net.yaml", text(_NETWORK, _IMAGE_NETWORK, words="width height erp image rgb nhwc z "
           "distance log-distance metric true"), plain(_parse_description)),
    Target("onnx", "net.onnx", _onnx_material, _onnx),
)  # fmt: skip
