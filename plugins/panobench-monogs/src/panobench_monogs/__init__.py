"""MonoGS: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "monogs-original",
    "the original MonoGS (CUDA)",
    "panobench_monogs.method:MonoGs",
    cameras=("pinhole",),
    needs=("rgb",),
    colour=True,
    metric=False,
    licence="non-commercial (Imperial College London)",
    citation="Matsuki et al.: Gaussian Splatting SLAM (CVPR 2024)",
    install="clone and install MonoGS, then "
    "export PANOBENCH_MONOGS_HOME=/path/to/MonoGS PANOBENCH_MONOGS_RUN_IN=conda:MonoGS",
    probe="panobench_monogs.method:MonoGs.missing",
    config="panobench_monogs.method:MonoGsConfig",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
