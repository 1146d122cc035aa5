"""Photometric kernels on a rig's panorama, whose rays begin in the lenses' centres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.rig_panorama import LensPictures, RigPanorama
from panobench.geometry import invert_pose, make_pose, so3_exp, so3_log
from panobench.photometric.align import align
from panobench.photometric.bundle import BundleOptions, refine
from panobench.photometric.pyramid import F32, luma_of_frame, pyramid
from panobench.photometric.reference import make_reference
from panobench.photometric.stereo import WorkingScale, multi_view_depth
from panobench.photometric.warp import camera_code, parameters_at_level
from panobench.testing import TinySequence, two_lenses

#: Lenses far enough apart for their parallax to be pixels.
RIG = two_lenses(136, 0.2)


def pose(t: float) -> np.ndarray:
    return make_pose(so3_exp([0.05 * np.sin(3 * t), 0.6 * t, 0.0]), [0.3 * t, 0.05 * np.sin(2 * t), 0.1 * t])


@dataclass
class Seen:
    camera: RigPanorama
    poses: np.ndarray
    pyramids: list[list[F32]]
    depth: F32

    def relative(self, k: int) -> np.ndarray:
        return invert_pose(self.poses[k]) @ self.poses[0]


@pytest.fixture(scope="module")
def seen() -> Seen:
    sequence = TinySequence(ErpCamera(256, 128), 8, pose=pose, rig=RIG)
    camera = RigPanorama.of(RIG, ErpCamera(256, 128))
    assert camera.lenses is not None
    camera.lenses.units_per_metre = 1.0
    pictures = LensPictures(RIG, camera)
    images = [pictures.image(sequence.lens_images(k)) for k in range(8)]
    pyramids = [pyramid(luma_of_frame(image, camera.valid_mask())) for image in images]
    poses = np.stack([pose(float(t)) for t in sequence.times])
    depth = np.zeros((128, 256), np.float32)
    for number, lens in enumerate(RIG.lenses):
        T = poses[0] @ make_pose(np.eye(3), lens.T_rig_lens[:3, 3])
        distance, _ = sequence._hits(T, camera.rays())
        depth[camera.lens == number] = distance[camera.lens == number]
    return Seen(camera, poses, pyramids, depth)


def test_parameters_go_on_with_the_lenses_and_only_pixels_are_divided(seen: Seen) -> None:
    _, whole = camera_code(seen.camera)
    _, plain = camera_code(ErpCamera(256, 128))
    np.testing.assert_array_equal(whole[0], plain)
    half = parameters_at_level(whole, 1)
    np.testing.assert_array_equal(half[0], parameters_at_level(plain, 1))
    np.testing.assert_array_equal(half[1:], whole[1:])
    np.testing.assert_allclose(whole[2:, 3:], [[0, 0, 0.1], [0, 0, -0.1]], atol=1e-6)


def test_alignment_finds_the_rigs_pose_and_one_centre_does_not(seen: Seen) -> None:
    levels, frame, truth = seen.pyramids[0], seen.pyramids[5], seen.relative(5)
    depth = np.where(seen.camera.valid_mask(), seen.depth, np.nan).astype(np.float32)
    found = align(make_reference(seen.camera, levels[0], depth, len(levels)), frame, seen.relative(4))
    plain = ErpCamera(256, 128).with_mask(seen.camera.valid_mask())
    central = align(make_reference(plain, levels[0], depth, len(levels)), frame, seen.relative(4))
    own, other = (np.linalg.norm((a.T_fr @ invert_pose(truth))[:3, 3]) for a in (found, central))
    assert own < 1.5e-3
    assert other > 5 * own
    assert np.linalg.norm(so3_log(found.T_fr[:3, :3] @ truth[:3, :3].T)) < 1e-3


@pytest.mark.parametrize("believed", [0.7, 1.0, 1.3])
def test_a_bundle_measures_how_far_the_lenses_are_apart(seen: Seen, believed: float) -> None:
    assert seen.camera.lenses is not None
    seen.camera.lenses.units_per_metre = believed
    scale = WorkingScale.of(seen.camera, 256)
    T = np.stack([seen.relative(k) for k in range(1, 8)])
    images = np.stack([p[0] for p in seen.pyramids[1:]])
    known = np.where(scale.valid, seen.depth, 0).astype(np.float32)
    bundle = refine(seen.pyramids[0][0], scale.rays, known, images, T, scale.code, scale.cam, BundleOptions())
    seen.camera.lenses.units_per_metre = 1.0
    assert bundle.units is not None
    units, sigma = bundle.units
    # What is not linear in the distance is left for the next round.
    assert abs(units - 1) < 0.03 + 0.25 * abs(believed - 1)
    assert 1e-4 < sigma < 0.03


def test_swept_depth_is_that_from_each_lens(seen: Seen) -> None:
    scale = WorkingScale.of(seen.camera, 256)
    T = np.stack([seen.relative(k) for k in range(1, 8)])
    images = np.stack([p[0] for p in seen.pyramids[1:]])
    found, _ = multi_view_depth(seen.pyramids[0][0], scale, images, T, 0.7, 6.0)
    plain = WorkingScale.of(ErpCamera(256, 128).with_mask(seen.camera.valid_mask()), 256)
    central, _ = multi_view_depth(seen.pyramids[0][0], plain, images, T, 0.7, 6.0)
    off, other = (np.median(np.abs(np.log(d / seen.depth))[scale.valid]) for d in (found, central))
    assert off < 0.02
    assert other > 1.5 * off
