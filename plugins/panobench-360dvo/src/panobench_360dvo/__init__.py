"""360DVO: what this plugin registers."""

from __future__ import annotations

from panobench import MethodSpec, hookimpl

SPEC = MethodSpec(
    "360dvo",
    "360DVO: learned visual odometry on panoramas (CUDA)",
    "panobench_360dvo.method:Dvo360",
    cameras=("erp",),
    needs=("rgb",),
    colour=True,
    metric=False,
    licence="none stated",
    citation="Guo et al.: 360DVO (IEEE RA-L 2026)",
    install="clone and install 360DVO with its weights, then "
    "export PANOBENCH_360DVO_HOME=/path/to/360DVO PANOBENCH_360DVO_RUN_IN=conda:360dvo",
    probe="panobench_360dvo.method:Dvo360.missing",
    config="panobench_360dvo.method:Dvo360Config",
    deterministic=False,
)


@hookimpl
def register_methods() -> list[MethodSpec]:
    return [SPEC]
