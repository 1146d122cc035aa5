"""What contradicts the map over an area, and what does not count as such."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.methods.splatting.transients import Transients
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Render

CAMERA = ErpCamera(192, 96)


def transients(share: float = 0.01) -> Transients:
    return Transients(pixel_weights(CAMERA), error=0.16, share=share, wrap=True)


def render(grey: float = 0.5) -> Render:
    """An even picture of a map that covers everything."""
    shape = (CAMERA.height, CAMERA.width)
    planes = np.full((3, *shape), grey, np.float32)
    return Render(
        planes, np.ones(shape, np.float32), np.ones(shape, np.float32), None, np.zeros(0, np.int32), None, 0.03, None
    )


def frame(rows: slice, columns: list[int], grey: int = 230) -> np.ndarray:
    image = np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)
    image[rows, columns] = grey
    return image


def test_an_area_is_found_and_its_border_goes_with_it() -> None:
    found = transients().contradicted(frame(slice(40, 60), list(range(80, 100))), render())
    assert found[40:60, 80:100].all()
    assert found.sum() < 28 * 28


def test_an_area_across_the_seam_is_found_whole() -> None:
    columns = [*range(182, 192), *range(10)]
    found = transients().contradicted(frame(slice(40, 60), columns), render())
    assert found[40:60, columns].all()


def test_a_line_and_a_faint_area_are_no_contradiction() -> None:
    assert not transients().contradicted(frame(slice(40, 41), list(range(192))), render()).any()
    assert not transients().contradicted(frame(slice(40, 60), list(range(80, 100)), grey=150), render()).any()


def test_what_the_map_does_not_know_cannot_be_contradicted() -> None:
    unknown = render()
    unknown.opacity[:] = 0.2
    assert not transients().contradicted(frame(slice(40, 60), list(range(80, 100))), unknown).any()


@pytest.mark.parametrize(("size", "changed", "active"), [(8, 1.0, False), (40, 0.0, False), (40, 1.0, True)])
def test_nothing_is_left_out_until_enough_has_moved(size: int, changed: float, active: bool) -> None:
    subject = transients(share=0.02)
    image = frame(slice(30, 30 + size), list(range(80, 80 + size)))
    for _ in range(4):
        assert subject.look(image, render(), lambda where: changed) is None
    found = subject.look(image, render(), lambda where: changed)
    assert (found is not None) == active == subject.active


def test_what_a_mask_hides_contradicts_nothing() -> None:
    image = frame(slice(20, 70), list(range(60, 130)), grey=0)
    visible = image[..., 0] > 0
    assert not transients().contradicted(image, render(), visible).any()
    subject = transients(share=0.02)
    assert [subject.look(image, render(), lambda where: 1.0, visible) for _ in range(6)] == [None] * 6
    assert not subject.active
    image[40:60, 140:160] = 230
    found = transients().contradicted(image, render(), visible)
    assert found[40:60, 140:160].all()
    assert not found[:, 60:125].any()
