"""Bundle adjustment of one reference when some of its depths are wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.geometry import invert_pose
from panobench.photometric.bundle import Bundle, BundleOptions, refine
from panobench.photometric.pyramid import F32, luma_of_frame
from panobench.photometric.stereo import WorkingScale

FRAMES, REFERENCE = range(0, 40, 2), 20
Array = NDArray[np.float64]


@pytest.fixture(scope="module")
def room() -> tuple[WorkingScale, list[F32], F32, Array]:
    """Working scale, luma of the others and of the reference, its depth, and T_fr of the others."""
    sequence = RoomsDataset().open("tiny", width=512)
    assert sequence.groundtruth is not None
    scale = WorkingScale.of(sequence.camera, 512)
    others = [i for i in FRAMES if i != REFERENCE]
    luma = [luma_of_frame(sequence.image(i), scale.valid) for i in [*others, REFERENCE]]
    depth = sequence.depth(REFERENCE)
    assert depth is not None
    T_wc = sequence.groundtruth.T_wc
    return scale, luma, np.nan_to_num(depth).astype(np.float32), invert_pose(T_wc[others]) @ T_wc[REFERENCE]


def adjusted(room: tuple[WorkingScale, list[F32], F32, Array], depth: F32, options: BundleOptions) -> Bundle:
    """From the right poses: what wrong depths make of them."""
    scale, luma, _, truth = room
    return refine(luma[-1], scale.rays, depth, np.stack(luma[:-1]), truth, scale.code, scale.cam, options)


def off_mm(bundle: Bundle, truth: Array) -> float:
    """RMS of the frames' positions after the best scale, in mm."""
    a, b = (-(np.swapaxes(T[:, :3, :3], 1, 2) @ T[:, :3, 3:])[..., 0] for T in (bundle.T_fr, truth))
    return 1e3 * float(np.sqrt(np.mean(np.sum((a * (a * b).sum() / (a * a).sum() - b) ** 2, axis=1))))


def one_side_nearer(depth: F32, factor: float) -> F32:
    """What a young map has of a room seen through a door."""
    wrong = depth.copy()
    wrong[:, : depth.shape[1] // 3] *= np.float32(factor)
    return wrong


PLAIN = BundleOptions(cell_px=4, iterations=6)


def test_the_nearest_frames_first_and_trimming_forgive_wrong_depths(room) -> None:  # type: ignore[no-untyped-def]
    depth, truth = one_side_nearer(room[2], 0.8), room[3]
    plain, near, both = (
        adjusted(room, depth, replace(PLAIN, near=n, trim=t)) for n, t in ((0, 0.0), (8, 0.0), (8, 0.6))
    )
    assert near.ok
    assert off_mm(near, truth) < 0.8 * off_mm(plain, truth)
    assert off_mm(both, truth) < 0.6 * off_mm(plain, truth)
    assert off_mm(both, truth) < 0.5


def test_with_right_depths_neither_does_harm(room) -> None:  # type: ignore[no-untyped-def]
    truth = room[3]
    plain, both = (adjusted(room, room[2], replace(PLAIN, near=n, trim=t)) for n, t in ((0, 0.0), (8, 0.6)))
    assert off_mm(plain, truth) < 0.6
    assert off_mm(both, truth) < 1.1 * off_mm(plain, truth)


def test_pixels_hidden_in_some_frames_are_not_taken_for_wrong_ones(room) -> None:  # type: ignore[no-untyped-def]
    scale, luma, depth, truth = room
    hidden = [image.copy() for image in luma]
    for image in hidden[:-1:3]:  # what comes before the camera hides what has the right depth
        image[:, scale.camera.width // 3 :] = np.nan
    options = replace(PLAIN, near=8, trim=0.6)
    bundle = adjusted((scale, hidden, depth, truth), one_side_nearer(depth, 0.8), options)
    assert off_mm(bundle, truth) < 1.2


def test_too_little_to_see_leaves_the_poses(room) -> None:  # type: ignore[no-untyped-def]
    bundle = adjusted(room, np.zeros_like(room[2]), replace(PLAIN, near=8, trim=0.6))
    assert not bundle.ok
    np.testing.assert_array_equal(bundle.T_fr, room[3])
