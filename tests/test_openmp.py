"""OpenMP's workers are told not to spin before any of its runtimes is loaded."""

from __future__ import annotations

import os
import subprocess
import sys

SCRIPT = "import panobench, os, sys; print(os.environ['GOMP_SPINCOUNT'], {'torch', 'numba'} & set(sys.modules))"


def imported(**given: str) -> str:
    environment = {k: v for k, v in os.environ.items() if k not in ("GOMP_SPINCOUNT", "OMP_WAIT_POLICY")}
    return subprocess.run(
        [sys.executable, "-c", SCRIPT], env={**environment, **given}, capture_output=True, text=True, check=True
    ).stdout


def test_importing_panobench_sets_it_before_torch_and_numba_are_loaded() -> None:
    assert imported() == "5000 set()\n"


def test_the_users_own_setting_stays() -> None:
    assert imported(GOMP_SPINCOUNT="7").startswith("7 ")
