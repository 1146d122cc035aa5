"""Panoramas of two lenses: their parallax is undone where depth is known; the seam is left out where it is large."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.two_lenses import TwoLenses
from panobench.methods.panogs.config import RollingShutterOptions, StitchOptions
from panobench.methods.panogs.rectification.rectify import Rectifier
from panobench.methods.panogs.rectification.rolling_shutter import RollingShutter
from panobench.methods.panogs.rectification.seam import Seam

CAMERA = ErpCamera(256, 128)
RADIUS = 1.2


def world(d: np.ndarray) -> np.ndarray:
    """A smooth picture of the surroundings: colour by direction (..., 3)."""
    x, y, z = np.moveaxis(d, -1, 0)
    waves = [np.sin(7 * x + 3 * y), np.cos(6 * y - 4 * z), np.sin(5 * z + 6 * x * y)]
    return np.stack([128 + 110 * w for w in waves], axis=-1)


def panorama(lenses: TwoLenses) -> np.ndarray:
    """In the middle of a painted sphere of radius RADIUS, each half (H, W, 3) as its own lens sees it."""
    rays = CAMERA.rays()
    o, u = lenses.origins(rays), lenses.seen(rays)
    along = (o * u).sum(axis=-1, keepdims=True)
    hit = o + (np.sqrt(along**2 + RADIUS**2 - np.square(o).sum(axis=-1, keepdims=True)) - along) * u
    return np.clip(world(hit / RADIUS), 0, 255).astype(np.uint8)


def seam_of(most_px: float = 1.0) -> Seam:
    return Seam(CAMERA, StitchOptions(baseline_mm=80, distance_m=3, most_px=most_px))


def test_parallax_is_undone_where_depth_is_known() -> None:
    seam = seam_of()
    rectifier = Rectifier(CAMERA, RollingShutter(CAMERA, RollingShutterOptions()), seam)
    assert not rectifier.enabled
    seam.place(metres=0.5, distance_m=3.0)  # a unit of the map is half a metre: so are the lenses 0.16 of it apart
    assert rectifier.enabled
    image, centre = panorama(TwoLenses(0.16, 1 / 6)), panorama(TwoLenses(0.0, 0.0)).astype(float)
    depth_map = np.full((128, 256), RADIUS, np.float32)
    found = rectifier.rectified(image, np.zeros(3), np.zeros(3), depth_map)
    beside = np.abs(CAMERA.rays()[..., 2]) > np.sin(np.deg2rad(8))
    before, after = (np.abs(i.astype(float) - centre)[beside].mean() for i in (image, found))
    assert before > 4
    assert after < 0.6  # half a level is rounding
    unknown = rectifier.rectified(image, np.zeros(3), np.zeros(3), np.zeros_like(depth_map))
    np.testing.assert_array_equal(unknown, image)


def test_the_seam_is_left_out_where_things_are_plainly_seen_twice() -> None:
    seam = seam_of()
    depth_map = np.full((128, 256), 0.4, np.float32)
    assert seam.visible(depth_map, None) is None  # nobody knows the scale yet
    seam.place(metres=1.0, distance_m=3.0)
    depth_map[:, 128:] = 3.0
    visible = seam.visible(depth_map, None)
    assert visible is not None
    assert visible[:, 128:].all()
    left_out = ~visible[60:68, :128]
    across = np.abs(CAMERA.rays()[60:68, :128, 2])
    assert left_out.any()
    assert across[left_out].max() < 0.1
    mask = np.ones((128, 256), bool)
    mask[:10] = False
    both = seam.visible(depth_map, mask)
    assert both is not None
    np.testing.assert_array_equal(both, mask & visible)


@pytest.mark.parametrize("seam", [Seam(CAMERA, StitchOptions()), seam_of(most_px=0.0)])
def test_without_two_lenses_or_without_a_limit_nothing_is_left_out(seam: Seam) -> None:
    if seam.stitched:
        seam.place(metres=1.0, distance_m=3.0)
    assert seam.visible(np.full((128, 256), 0.4, np.float32), None) is None
