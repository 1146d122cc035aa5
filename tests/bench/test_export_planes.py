"""Depth that is made flat where planes explain the frames: a box with patterned walls, a plain one, and a ball."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from panoramas_of_a_box import BOX, cast, points

from panobench.bench.export.plane_alignment import align
from panobench.bench.export.plane_depth import corrected_depths
from panobench.bench.export.planes import Plane, find_planes
from panobench.bench.export.posed_panoramas import PosedPanoramas
from panobench.cameras.erp import ErpCamera
from panobench.photometric.stereo import WorkingScale

Array = NDArray[np.float64]


def offset(plane: Plane) -> float:
    """How far the plane is from the nearest wall of the box, metres, judged where that wall is."""
    axis = int(np.abs(plane.normal).argmax())
    wall = np.zeros(3)
    wall[axis] = np.sign(plane.normal[axis] * plane.offset) * BOX[axis]
    return float(abs(plane.normal @ wall - plane.offset))


def test_planes_are_found_and_the_frames_put_them_right(bulging: PosedPanoramas) -> None:
    generator = np.random.default_rng(0)
    found = find_planes(bulging, generator)[:6]
    axes = [int(np.abs(p.normal).argmax()) for p in found]
    assert {(axis, p.normal[axis] * p.offset > 0) for axis, p in zip(axes, found)} == {
        (axis, side) for axis in range(3) for side in (False, True)
    }
    aligned = [align(plane, bulging, generator) for plane in found]
    assert all(plane is not None for plane in aligned)
    before, after = [offset(p) for p in found], [offset(p) for p in aligned if p is not None]
    assert np.median(before) > 0.004, "as far as the depths are wrong"
    assert max(after) < 0.003
    assert all(np.abs(p.normal).max() > np.cos(0.005) for p in aligned if p is not None)


def test_plain_walls_become_flat_and_the_ball_stays_round(truth: PosedPanoramas, bulging: PosedPanoramas) -> None:
    made = corrected_depths(bulging, bulging.depth)
    known = np.isfinite(made)
    error, before = np.abs(made - truth.depth), np.abs(bulging.depth - truth.depth)
    plain = np.stack([points(truth, k)[..., 0] for k in range(len(truth))]) > BOX[0] - 0.01
    assert (before[plain] > 0.02).mean() > 0.2
    assert known[plain].mean() > 0.95
    assert (error[plain & known] > 0.02).mean() < 0.5 * (before[plain] > 0.02).mean()
    assert np.median(error[plain & known]) < 0.003 < 0.01 < np.median(before[plain])
    ball = np.stack([cast(truth.rays(k), truth.T_wc[k, :3, 3])[1] for k in range(len(truth))])
    assert known[ball].mean() > 0.6
    assert np.median(error[ball & known]) < 0.7 * np.median(before[ball])
    assert (error[ball & known] > 0.07).mean() < 0.1, "along its outline"


def test_without_parallax_the_depth_is_the_maps(truth: PosedPanoramas) -> None:
    still = replace(truth, T_wc=np.repeat(truth.T_wc[:1], len(truth), axis=0))
    assert (corrected_depths(still, still.depth) == still.depth).all()


def test_what_the_frames_do_not_show_keeps_the_maps_depth(bulging: PosedPanoramas) -> None:
    seen = np.arange(128)[:, None].repeat(256, axis=1) < 90
    scale = WorkingScale.of(ErpCamera(256, 128).with_mask(seen), 256)
    luma = np.where(seen, bulging.luma, np.float32(np.nan))
    made = corrected_depths(replace(bulging, luma=luma, scale=scale), bulging.depth)
    assert np.array_equal(made[:, ~seen], bulging.depth[:, ~seen])
    assert (made != bulging.depth)[:, seen].mean() > 0.8
