"""The options of panogs with changes, for tests."""

from __future__ import annotations

from typing import Any

from panobench.bench.run.config import override
from panobench.methods.panogs.config import PanogsConfig


def configured(**options: Any) -> PanogsConfig:
    """The defaults with changes; an option's dot is written as two underscores."""
    return override(PanogsConfig(), {name.replace("__", "."): value for name, value in options.items()}, "option")
