"""Specs of the built-in depth estimators."""

from panobench.specs import DepthSpec

DEPTH_ESTIMATORS: tuple[DepthSpec, ...] = (
    DepthSpec(
        "bootstrap",
        "plane sweep and alignment over the first frames; no weights",
        "panobench.depth.bootstrap:BootstrapDepth",
    ),
    DepthSpec(
        "oracle",
        "the dataset's own depth (flagged in every report)",
        "panobench.depth.simple:OracleDepth",
        needs_dataset_depth=True,
    ),
    DepthSpec(
        "constant",
        "2 m everywhere with noise of 0.3 m, as in MonoGS",
        "panobench.depth.simple:ConstantDepth",
        argument="METRES",
    ),
    DepthSpec(
        "network",
        "an ONNX or TorchScript depth network with a YAML description beside it",
        "panobench.depth.network:NetworkDepth",
        argument="FILE",
        files="panobench.depth.network:network_files",
    ),
    DepthSpec(
        "rooms-net",
        "a small network that comes with the package, trained on built-in rooms",
        "panobench.depth.network:RoomsNetDepth",
        requires=("onnxruntime",),
        files="panobench.depth.network:rooms_net_files",
    ),
)
