"""Choosing a camera must not cost what rendering with one does."""

from __future__ import annotations

import subprocess
import sys


def test_models_and_options_load_without_heavy_packages() -> None:
    code = (
        "import sys, panobench.cameras.registration, panobench.cameras.factory, panobench.cameras.erp, "
        "panobench.cameras.views; from panobench.cameras.factory import parse_fov; parse_fov('120x60'); "
        "print([m for m in ('torch', 'numba', 'cv2', 'scipy', 'plotly', 'yaml', 'evo') if m in sys.modules])"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.strip() == "[]"
