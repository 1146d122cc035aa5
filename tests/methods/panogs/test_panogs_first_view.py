"""What of the first depth the first map is made from, where a mask hides part of the view."""

from __future__ import annotations

import numpy as np
from panogs_options import configured

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import so3_exp
from panobench.methods.base import MethodContext
from panobench.methods.panogs.first_map.view import well_seen
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.splatting.views import View
from panobench.types import DepthEstimate, Frame

PANORAMA = ErpCamera(64, 32)
COLUMN = np.broadcast_to(np.arange(64), (32, 64))
OPERATOR = COLUMN < 16  # a quarter of the view, all the way down
IMAGE = np.zeros((32, 64, 3), np.uint8)


def turning(count: int = 9) -> DepthEstimate:
    """The camera turns by 5 columns a frame and stays where it is, so that columns leave to the left."""
    T_wc = {k: np.eye(4) for k in range(count)}
    for k, T in T_wc.items():
        T[:3, :3] = so3_exp(np.array([0.0, k * 5 * 2 * np.pi / 64, 0.0]))
    return DepthEstimate(np.full((32, 64), 2.0, np.float32), 0, None, T_wc)


def frames(count: int = 9, mask: np.ndarray | None = None) -> list[Frame]:
    return [Frame(k, k / 15, IMAGE, mask=mask) for k in range(count)]


def columns(camera: Camera, estimate: DepthEstimate, given: list[Frame]) -> set[int]:
    """Columns that are left out in more than half of the rows."""
    seen = well_seen(camera, estimate, given)
    assert seen is not None
    return {int(x) for x in np.flatnonzero(seen.mean(axis=0) < 0.5)} - set(range(16))


def test_what_the_operator_soon_covers_is_left_out() -> None:
    camera = PANORAMA.with_mask(~OPERATOR)
    # Column x is where the operator is from frame (x - 15) / 5 to x / 5, three or four frames.
    assert columns(camera, turning(), frames()) == set()  # nothing is covered in more than three of eight
    assert columns(camera, turning(count=5), frames(5)) == set(range(16, 26))  # others in two of four at most


def test_masks_of_single_frames_count() -> None:
    given, covered = frames(5), frames(5, COLUMN != 40)
    still = turning(count=5)
    still.T_wc = {k: np.eye(4) for k in range(5)}
    assert columns(PANORAMA, still, [given[0], *covered[1:4], given[4]]) == {40}
    assert columns(PANORAMA, still, [given[0], covered[1], given[4]]) == set()


def test_nothing_is_left_out_where_nothing_is_hidden_or_nothing_can_tell() -> None:
    camera = PANORAMA.with_mask(~OPERATOR)
    assert well_seen(PANORAMA, turning(), frames()) is None
    assert well_seen(camera, DepthEstimate(np.full((32, 64), 2.0, np.float32)), frames()) is None
    narrow = PinholeCamera(64, 32, 40.0, 40.0, 32.0, 16.0).with_mask(COLUMN > 8)
    assert well_seen(narrow, turning(), frames()) is None


def test_the_first_map_has_no_gaussians_there() -> None:
    camera = ErpCamera(64, 32)
    method = PanogsMethod(configured(start__iterations=2))
    method.start(camera, MethodContext(seed=0))
    view = View(0, np.full((32, 64, 3), 128, np.uint8), np.eye(4))
    method.mapper.initialise(view, 0.0, np.full((32, 64), 2.0, np.float32), ~OPERATOR)
    pixels, _ = camera.project(method.mapper.map.gaussians.means.astype(np.float64))
    assert len(pixels) > 50
    assert pixels[:, 0].min() > 15
