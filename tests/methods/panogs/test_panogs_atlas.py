"""Several maps: where a camera is lost for good, and where it comes back."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.depth.bootstrap import BootstrapDepth
from panobench.methods.base import MethodContext
from panobench.methods.panogs.atlas import AtlasMethod
from panobench.testing import TinySequence, erp_camera
from panobench.types import Estimate, Frame
from tests.methods.panogs.panogs_options import configured

CAMERA = erp_camera(96)
SOON = {"mapping__iterations": 3, "start__iterations": 10, "mapping__final_iterations": 2}


def shown(images: list[np.ndarray], **options: object) -> tuple[AtlasMethod, Estimate, list[str]]:
    said: list[str] = []
    method = AtlasMethod(configured(**SOON, **options))
    method.start(CAMERA, MethodContext(make_depth=BootstrapDepth, warn=said.append))
    for i, image in enumerate(images):
        method.track(Frame(i, i / 10, image))
    return method, method.finish(), said


@pytest.mark.slow
def test_after_a_cut_into_another_room_there_is_another_map_until_the_camera_is_back() -> None:
    one, other = TinySequence(CAMERA, 30), TinySequence(CAMERA, 30, seed=99)
    images = [one.image(i) for i in range(30)] + [other.image(i) for i in range(24)]
    images += [one.image(i) for i in range(29, 9, -1)]
    method, estimate, said = shown(images, atlas__common_after_cut=6, atlas__moved_after_cut=0.1)
    assert len(method.maps) == estimate.extra["maps"] == 2
    assert estimate.extra["joined"] == 0
    assert estimate.extra["joined_by_looks"] == 1
    frames = np.round(10 * estimate.trajectory.times).astype(int)
    assert set(range(30)) <= set(frames)
    assert not any(30 <= i < 54 for i in frames)
    assert sum(i >= 54 for i in frames) >= 8
    assert "could not be joined" in said[-1]
    second = min(method.maps, key=lambda one: len(one.trajectory))
    assert sum(30 <= i < 54 for i in second.trajectory) >= 10
    truth = np.stack([one.pose_at((i if i < 30 else 83 - i) / 10) for i in frames])
    first = np.linalg.inv(truth[0]) @ truth
    found = np.linalg.inv(estimate.trajectory.T_wc[0]) @ estimate.trajectory.T_wc
    scale = (found[:, :3, 3] * first[:, :3, 3]).sum() / (found[:, :3, 3] ** 2).sum()
    assert np.abs(scale * found[:, :3, 3] - first[:, :3, 3]).max() < 0.03


def test_one_map_is_left_alone_where_others_are_not_wanted() -> None:
    one, other = TinySequence(CAMERA, 12), TinySequence(CAMERA, 12, seed=99)
    images = [one.image(i) for i in range(12)] + [other.image(i) for i in range(12)]
    method, estimate, _ = shown(images, atlas__enabled=False)
    assert len(method.maps) == 1
    assert "maps" not in estimate.extra
    assert len(estimate.trajectory.times) == 12


def test_a_camera_found_far_from_where_a_cut_lost_it_is_found_by_looks_alone() -> None:
    one, other = TinySequence(CAMERA, 30), TinySequence(CAMERA, 3, seed=99)
    there = [one.image(i) for i in range(30)]
    cut = [other.image(i) for i in range(3)]
    near, far = [one.image(i) for i in range(28, 24, -1)], [one.image(i) for i in range(4)]
    assert shown(there + cut + near)[1].extra["joined_by_looks"] == 0
    method, estimate, _ = shown(there + cut + far)
    assert estimate.extra["joined_by_looks"] == 1
    assert len(method.maps) == 1
