"""COLMAP: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "colmap",
    "structure from motion by COLMAP, natively on panoramas; offline, pseudo ground truth for videos",
    "panobench_colmap.method:Colmap",
    cameras=("erp", "pinhole", "fisheye"),
    colour=False,
    licence="BSD-3-Clause",
    citation="Schoenberger, Frahm: Structure-from-Motion Revisited (CVPR 2016)",
    install='pip install "pycolmap>=4"',
    probe="panobench_colmap.method:Colmap.missing",
    config="panobench_colmap.method:ColmapConfig",
    presets={"exhaustive": {"matcher": "exhaustive"}},
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
