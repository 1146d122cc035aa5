"""The text of the kernels: one translation unit, whatever compiles it."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent / "kernels"
#: In an order in which everything is declared before it is used.
FILES = (
    "vectors.cu", "shape.cu", "bounds.cu", "project.cu", "blend.cu", "loss.cu", "chain.cu", "adam.cu",
    "align.cu",
)  # fmt: skip
_KERNEL = re.compile(r'extern "C" __global__ void\s+(?:__launch_bounds__\([^)]*\)\s+)?(\w+)\s*\(')


@cache
def source() -> str:
    """All kernels; errors of a compiler name the file and the line."""
    parts = []
    for name in FILES:
        parts += [f'#line 1 "{name}"', (FOLDER / name).read_text(encoding="utf-8")]
    return "\n".join(parts)


@cache
def kernel_names() -> tuple[str, ...]:
    """The kernels that can be launched."""
    return tuple(_KERNEL.findall(source()))
