"""Names of the columns of the arrays that kernels hand to each other: ``row[FOOTPRINT.opacity]`` instead of ``row[9]``.

Numba folds the names when it compiles a kernel, so they cost nothing.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

#: The number of a column, or its offset in a block's buffer (``kernels.block``).
Column = int | np.unsignedinteger[Any]
Pair = tuple[Column, Column]
Vector = tuple[Column, Column, Column]
Quaternion = tuple[Column, Column, Column, Column]


class ParameterColumns(NamedTuple):
    """A Gaussian's parameters, or one value for each of them, such as a gradient."""

    mean: Vector = (0, 1, 2)
    log_scale: Vector = (3, 4, 5)
    #: w, x, y, z.
    quat: Quaternion = (6, 7, 8, 9)
    #: Of the opacity.
    logit: Column = 10
    colour: Vector = (11, 12, 13)


class FootprintColumns(NamedTuple):
    """What the compositing of a tile needs to know of a Gaussian.

    At a pixel with ray r the whitened offset from the mean is t = (p1.r, p2.r) / (m.r), and
    alpha = opacity exp(-|t|^2 / 2).
    """

    p1: Vector = (0, 1, 2)
    p2: Vector = (3, 4, 5)
    #: Direction of the mean in the camera frame; (0, 0, 1) for first-order projections, whose rays are (u, v, 1).
    m: Vector = (6, 7, 8)
    opacity: Column = 9
    colour: Vector = (10, 11, 12)
    #: Distance of the mean from the camera (radial depth).
    distance: Column = 13
    #: Largest |t|^2 at which alpha is not cut.
    cut: Column = 14
    #: Pixel column of the mean, for first-order panoramas, whose columns repeat.
    u: Column = 15
    #: Cosine and sine of the angular radius.
    cos_radius: Column = 16
    sin_radius: Column = 17
    #: Change of distance per unit of t; zero unless depth is sloped.
    slope: Pair = (18, 19)


class MomentColumns(NamedTuple):
    """Sums over a Gaussian's pixels in the backward pass.

    With g = dL/d(exponent) of a pixel: sums of g, g t, g t t^T (00, 01, 11) and g |t|^2 t, then dL/d(colour) and
    dL/d(distance).
    """

    g: Column = 0
    gt: Pair = (1, 2)
    gtt: Vector = (3, 4, 5)
    gttt: Pair = (6, 7)
    colour: Vector = (8, 9, 10)
    distance: Column = 11


class CameraColumns(NamedTuple):
    """What kernels get of a camera, in pixels.

    limit_x, limit_y: bounds of |x / z| and |y / z| inside the Jacobian of the first-order pinhole, in ``splat`` alone.
    """

    width: int = 0
    height: int = 1
    fx: int = 2
    fy: int = 3
    cx: int = 4
    cy: int = 5
    limit_x: int = 6
    limit_y: int = 7


PARAMETER, FOOTPRINT, MOMENT, CAM = ParameterColumns(), FootprintColumns(), MomentColumns(), CameraColumns()
#: How many columns there are of each.
PARAMETERS, FOOTPRINT_COLUMNS, MOMENTS = 14, 20, 12


def span(columns: tuple[Column, ...]) -> slice:
    """The slice of columns that lie side by side."""
    return slice(int(columns[0]), int(columns[-1]) + 1)
