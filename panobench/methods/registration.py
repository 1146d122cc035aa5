"""Specs of the built-in methods."""

from panobench.specs import MethodSpec

METHODS: tuple[MethodSpec, ...] = (
    MethodSpec(
        "sparse",
        "feature SLAM on bearing vectors: patches on tangent faces, bundle adjustment; any central camera",
        "panobench.methods.sparse.method:SparseMethod",
        cameras=("erp", "pal", "fisheye", "pinhole"),
        colour=False,
        licence="GPL-3.0-or-later",
        citation="panobench's own; five-point: Nister 2004; patch alignment: Baker & Matthews 2004, Forster et al. 2014",
        install="built in",
        config="panobench.methods.sparse.config:SparseConfig",
        presets={
            "fast": {"features": 350, "face_pixels": 300_000, "window": 6},
            "accurate": {"features": 1200, "window": 12, "final_ba": 20},
        },
    ),
)
