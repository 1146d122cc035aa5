"""Specs of the built-in cameras."""

from panobench.specs import CameraSpec

CAMERAS = (
    CameraSpec(
        "erp",
        "equirectangular panorama, full sphere or limited field of view",
        "panobench.cameras.erp:ErpCamera",
    ),
    CameraSpec(
        "pinhole",
        "perspective, optional radial-tangential distortion",
        "panobench.cameras.pinhole:PinholeCamera",
    ),
)
