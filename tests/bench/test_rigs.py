"""What methods get of data with several lenses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from panobench.bench.records.results import rig_remark
from panobench.bench.run.views import ChosenFrames, FrameReader, MethodSequence
from panobench.cameras.rig import Rig
from panobench.errors import DatasetError
from panobench.testing import TinySequence, erp_camera, two_lenses


def chosen() -> ChosenFrames:
    return ChosenFrames(TinySequence(erp_camera(64), n=6, rig=two_lenses(48)), every=2)


def test_frames_carry_a_picture_for_each_lens_if_they_are_asked_for() -> None:
    frames = chosen()
    assert FrameReader(frames)(1).lenses == ()
    pictures = FrameReader(frames, lenses=True)(1).lenses
    rig = frames.rig
    assert rig is not None
    for k, lens in enumerate(rig.lenses):
        valid = lens.camera.valid_mask()
        np.testing.assert_array_equal(pictures[k][valid], frames.lens_images(1)[k][valid])
        assert not pictures[k][~valid].any()


def test_a_batch_method_gets_them_with_the_rig_alone() -> None:
    frames = chosen()
    assert MethodSequence(frames).lens_images(0) == ()
    assert MethodSequence(frames).rig is None
    given = MethodSequence(frames, rig=frames.rig)
    assert len(given.lens_images(0)) == 2
    assert given.rig is frames.rig


def test_what_a_mask_hides_is_hidden_from_the_lenses_too() -> None:
    frames = chosen()
    hidden = np.zeros((32, 64), dtype=bool)
    hidden[24:] = True
    frames.hide(hidden)
    shown = np.ones((32, 64), dtype=bool)
    shown[:8] = False
    frames.hide_in_frames({1: shown})
    rig = frames.rig
    assert rig is not None
    read = FrameReader(frames, lenses=True)
    for k, lens in enumerate(rig.lenses):
        rays = lens.camera.rays() @ lens.T_rig_lens[:3, :3].T
        below, above = (rays[..., 1] > 0.78), (rays[..., 1] < -0.78)
        assert not lens.camera.valid_mask()[below].any()
        assert not read(0).lenses[k][below].any()
        assert read(0).lenses[k][above].any()
        assert not read(1).lenses[k][above].any()


def test_pictures_of_another_size_are_an_error_that_names_the_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = chosen()
    small = tuple(np.zeros((9, 9, 3), np.uint8) for _ in range(2))
    monkeypatch.setattr(TinySequence, "lens_images", lambda self, index: small)
    with pytest.raises(DatasetError, match="the lenses' pictures are"):
        FrameReader(frames, lenses=True)(0)


def remark(rigs: bool, rig: Rig | None) -> list[str]:
    setup: Any = SimpleNamespace(spec=SimpleNamespace(name="m", rigs=rigs), sequence=SimpleNamespace(rig=rig))
    return rig_remark(setup)


def test_a_method_that_takes_one_centre_says_that_it_got_a_stitched_panorama() -> None:
    assert remark(False, two_lenses()) == [
        "m takes one centre of projection: the pictures of 2 lenses, 41 mm apart, are stitched to a panorama for it"
    ]
    assert remark(True, two_lenses()) == remark(False, None) == []
