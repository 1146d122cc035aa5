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
    CameraSpec(
        "pal",
        "panoramic annular lens, catadioptric or fisheye by polynomials (Scaramuzza, OCamCalib)",
        "panobench.cameras.scaramuzza:ScaramuzzaCamera",
    ),
    CameraSpec(
        "fisheye",
        "fisheye with four angular coefficients (Kannala-Brandt, OpenCV, Kalibr equidistant)",
        "panobench.cameras.kannala_brandt:KannalaBrandtCamera",
    ),
    CameraSpec("ds", "double sphere (Usenko)", "panobench.cameras.double_sphere:DoubleSphereCamera"),
    CameraSpec("eucm", "enhanced unified camera model (Khomutenko)", "panobench.cameras.eucm:EucmCamera"),
    CameraSpec("omni", "unified omnidirectional with lens distortion (Mei)", "panobench.cameras.mei:MeiCamera"),
    CameraSpec("cubemap", "six 90 degree faces in a strip", "panobench.cameras.cubemap:CubemapCamera"),
)
