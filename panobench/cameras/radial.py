"""Derivatives that rotationally symmetric models share: their image radius depends only on the polar angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from panobench.cameras.base import Array


class RadialPartials(NamedTuple):
    """(x', y') = rho (x, y) / h with h = hypot(x, y): the factor rho/h and the partials by x, y and z."""

    factor: Array
    dx: tuple[Array, Array, Array]
    dy: tuple[Array, Array, Array]


def radial_partials(
    x: Array, y: Array, rho: Array, drho_dh: Array, drho_dz: Array, on_axis: Array | float
) -> RadialPartials:
    """Derivatives of the image point given rho(h, z) and its partials; ``on_axis`` is rho/h where h = 0."""
    h = np.hypot(x, y)
    tiny = h < 1e-12
    safe = np.where(tiny, 1.0, h)
    s = np.where(tiny, on_axis, rho / safe)
    cx, cy = np.where(tiny, 0.0, x / safe), np.where(tiny, 0.0, y / safe)
    t = np.where(tiny, 0.0, drho_dh - s)
    return RadialPartials(
        s,
        (s + t * cx * cx, t * cx * cy, cx * drho_dz),
        (t * cx * cy, s + t * cy * cy, cy * drho_dz),
    )
