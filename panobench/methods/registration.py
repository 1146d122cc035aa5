"""Specs of the built-in methods."""

from panobench.methods.monogs.config import PRESETS as MONOGS_PRESETS
from panobench.methods.panogs.config import PRESETS as PANOGS_PRESETS
from panobench.methods.photoslam.config import PRESETS as PHOTOSLAM_PRESETS
from panobench.methods.reconstruct.config import PRESETS as RECONSTRUCT_PRESETS
from panobench.specs import MethodSpec

METHODS: tuple[MethodSpec, ...] = (
    MethodSpec(
        "panogs",
        "PanoGS-SLAM: panoramic 3D Gaussian splatting SLAM on the CPU",
        "panobench.methods.panogs.method:PanogsMethod",
        cameras=("erp", "pinhole"),
        licence="GPL-3.0-or-later",
        citation="Mao et al., PanoGS-SLAM: Panoramic 3D Gaussian Splatting SLAM",
        install="built in",
        config="panobench.methods.panogs.config:PanogsConfig",
        presets=PANOGS_PRESETS,
    ),
    MethodSpec(
        "sparse",
        "feature SLAM on bearing vectors: patches on tangent faces, bundle adjustment; any central camera",
        "panobench.methods.sparse.method:SparseMethod",
        cameras=("erp", "pal", "fisheye", "pinhole", "ds", "eucm", "omni", "cubemap"),
        colour=False,
        rigs=True,
        licence="GPL-3.0-or-later",
        citation="panobench's own; Nister 2004 (five-point); Baker & Matthews 2004, Forster et al. 2014 (patches)",
        install="built in",
        config="panobench.methods.sparse.config:SparseConfig",
        presets={
            "fast": {"features": 350, "face_pixels": 300_000, "window": 6},
            "accurate": {"features": 1200, "window": 12, "final_ba": 20},
        },
    ),
    MethodSpec(
        "direct",
        "direct sparse odometry on the sphere: photometric bundle adjustment of selected pixels; any central camera",
        "panobench.methods.direct.method:DirectMethod",
        cameras=("erp", "pal", "fisheye", "pinhole", "ds", "eucm", "omni", "cubemap"),
        colour=False,
        licence="GPL-3.0-or-later",
        citation="panobench's own, after Engel et al. 2018 (DSO) and Huang & Yeung 2022 (360VO)",
        install="built in",
        config="panobench.methods.direct.config:DirectConfig",
    ),
    MethodSpec(
        "reconstruct",
        "offline Gaussian reconstruction with given poses (ground truth, or a trajectory file)",
        "panobench.methods.reconstruct.method:ReconstructMethod",
        cameras=("erp", "pinhole", "fisheye", "pal", "ds", "eucm", "omni", "cubemap"),
        needs=("rgb", "poses"),
        metric=True,
        licence="GPL-3.0-or-later",
        citation="panobench's own; the setting of ODGS (Lee et al. 2024) and OmniGS (Li et al. 2025)",
        install="built in",
        config="panobench.methods.reconstruct.config:ReconstructConfig",
        presets=RECONSTRUCT_PRESETS,
    ),
    MethodSpec(
        "monogs",
        "MonoGS as published: Gaussian splatting SLAM on pinhole images, on this package's renderer",
        "panobench.methods.monogs.method:MonogsMethod",
        cameras=("pinhole",),
        licence="GPL-3.0-or-later",
        citation="Matsuki et al., Gaussian Splatting SLAM (CVPR 2024); panobench's own code",
        install="built in",
        config="panobench.methods.monogs.config:MonogsConfig",
        presets=MONOGS_PRESETS,
    ),
    MethodSpec(
        "photoslam",
        "feature tracking (sparse) with a Gaussian map: Photo-SLAM's composition, pinhole or panorama",
        "panobench.methods.photoslam.method:PhotoslamMethod",
        cameras=("erp", "pinhole", "pal", "fisheye"),
        licence="GPL-3.0-or-later",
        citation="Huang et al., Photo-SLAM (CVPR 2024); panobench's own code",
        install="built in",
        config="panobench.methods.photoslam.config:PhotoslamConfig",
        presets=PHOTOSLAM_PRESETS,
    ),
)
