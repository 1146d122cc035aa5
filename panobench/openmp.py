"""How long OpenMP's workers spin between kernels. ``prepare`` runs when panobench is imported; nothing heavy is loaded.

Workers would otherwise spin for milliseconds: they burn a core while a method rests, and they stall each other when
several runs share a machine. Not spinning at all costs 60 us per kernel, about as long as many kernels take. libgomp is
therefore told to spin for about 0.2 ms.
"""

from __future__ import annotations

import os


def prepare() -> None:
    """Set libgomp's waiting policy where the user has not. Torch and Numba each load a libgomp of their own.

    A libgomp reads the variables once, when it is loaded: a program that imports torch first should import panobench
    before it.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    os.environ.setdefault("GOMP_SPINCOUNT", "5000")
