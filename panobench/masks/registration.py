"""Specs of the built-in mask estimators."""

from panobench.specs import MaskSpec

MASK_ESTIMATORS: tuple[MaskSpec, ...] = (
    MaskSpec(
        "geometry",
        "what does not move as the rigid scene does while the camera moves; no weights",
        "panobench.masks.geometry:GeometryMask",
    ),
    MaskSpec(
        "network",
        "an ONNX or TorchScript segmentation network with a YAML description beside it",
        "panobench.masks.network:NetworkMask",
        argument="FILE",
        files="panobench.masks.network:network_files",
    ),
)
