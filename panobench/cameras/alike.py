"""Cameras of the images of one lens, each calibrated for itself: whether they are alike, and the middle one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from panobench.cameras.base import Camera

#: Cameras whose pixels differ by less than this share of the width are one lens, estimated several times.
_ALIKE = 0.02
_ENOUGH = 1000


def middle_camera(cameras: Sequence[Camera]) -> tuple[Camera, float] | None:
    """The camera nearest to the median of all, and by how many pixels others differ from it at most.

    None where they are of different models or sizes, or differ by more than 2% of the width.
    """
    first = cameras[0]
    if any((c.kind, c.width, c.height) != (first.kind, first.width, first.height) for c in cameras):
        return None
    u, v = np.meshgrid(np.linspace(0.05, 0.95, 9) * first.width, np.linspace(0.05, 0.95, 5) * first.height)
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1)
    rays = np.stack([camera.unproject(pixels) for camera in cameras])
    seen = np.isfinite(rays).all(axis=(0, 2))
    if not seen.any():
        return None
    apart = np.linalg.norm(rays[:, seen] - np.median(rays[:, seen], axis=0), axis=-1).max(axis=1)
    middle = cameras[int(np.argmin(apart))]
    shown, _ = middle.project(rays[:, seen].reshape(-1, 3))
    difference = float(np.abs(shown.reshape(len(cameras), -1, 2) - pixels[seen]).max())
    return (middle, difference) if difference <= _ALIKE * first.width else None


def sample(found: list[Any]) -> list[Any]:
    """At most a thousand of a list, spread over it: a large reconstruction has tens of thousands of cameras."""
    return found[:: len(found) // _ENOUGH + 1]


def middle_remark(difference: float) -> str:
    """What to say of a camera that stands for several."""
    return f"images have cameras of their own, up to {difference:.2g} px apart: the middle one is taken for all"
