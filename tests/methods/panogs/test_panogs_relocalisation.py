"""Recognising places, judging how much a map explains, and finding the camera again."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from panogs_options import configured

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.depth.simple import OracleDepth
from panobench.geometry import make_pose, so3_exp, so3_log
from panobench.inertial.rotation_prior import RotationPrior
from panobench.methods.base import MethodContext
from panobench.methods.panogs.factor_graph.place_recognition import Places, yawed
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.method import PanogsMethod
from panobench.methods.panogs.tracking.agreement import agreement
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.photometric.pyramid import F32, luma_of_frame, pyramid
from panobench.splat.gaussians import GaussianMap
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer
from panobench.testing.sequences import TinySequence, erp_camera
from panobench.types import Frame

WIDTH = 128


def luma(sequence: TinySequence, T_wc: np.ndarray, camera: Camera) -> F32:
    return luma_of_frame(sequence.image_from(T_wc, camera), camera.valid_mask())


@pytest.mark.parametrize("yaw", [0.3, -2.0, 3.1])
@pytest.mark.parametrize("latitudes", [(-90, 90), (-50, 40)])
def test_a_place_is_recognised_however_the_camera_has_yawed(yaw: float, latitudes: tuple[int, int]) -> None:
    camera = ErpCamera(WIDTH, WIDTH // 2, lat_min_deg=latitudes[0], lat_max_deg=latitudes[1])
    sequence, places = TinySequence(camera, 30), Places(camera)
    for i in range(0, 30, 5):
        places.add(places.thumbnail(luma(sequence, sequence.pose_at(0.1 * i), camera)))
    asked = places.thumbnail(luma(sequence, yawed(sequence.pose_at(1.0), yaw), camera))
    best, second = places.find(asked, 2)
    assert best.number == 2
    assert best.score > 0.95
    assert best.score > second.score + 0.05
    assert abs((best.yaw - yaw + np.pi) % (2 * np.pi) - np.pi) < np.deg2rad(1.0)
    assert places.find(asked, 1, np.arange(places.count) > 2)[0].number == 3


def test_a_yaw_is_found_though_a_mask_leaves_gaps_in_the_rows() -> None:
    seen = np.ones((WIDTH // 2, WIDTH), bool)
    seen[:, 30:40] = seen[:, 90:100] = seen[50:, :60] = False
    camera = erp_camera(WIDTH).with_mask(seen)
    sequence, places = TinySequence(camera, 30), Places(camera, gaps=True)
    one, other = (
        places.thumbnail(luma(sequence, T, camera)) for T in (sequence.pose_at(0.9), yawed(sequence.pose_at(1.0), 0.8))
    )
    (likeness, yaw), *_ = places.compare(one, other)
    assert likeness > 0.7
    assert abs(yaw - 0.8) < np.deg2rad(3.0)


def test_another_room_is_no_place_known() -> None:
    camera = erp_camera(WIDTH)
    here, there, places = TinySequence(camera, 30), TinySequence(camera, 30, seed=99), Places(camera)
    for i in range(0, 30, 5):
        places.add(places.thumbnail(luma(here, here.pose_at(0.1 * i), camera)))
    matches = places.find(places.thumbnail(luma(there, there.pose_at(1.0), camera)))
    assert matches[0].score < 0.3


@pytest.mark.parametrize("camera", [PinholeCamera.from_fov(96, 100, 70), ErpCamera(WIDTH, WIDTH // 2, hfov_deg=200)])
def test_views_that_do_not_close_are_compared_without_a_turn(camera: Camera) -> None:
    sequence, places = TinySequence(camera, 30), Places(camera)
    for i in range(0, 30, 5):
        places.add(places.thumbnail(luma(sequence, sequence.pose_at(0.1 * i), camera)))
    best = places.find(places.thumbnail(luma(sequence, sequence.pose_at(1.02), camera)))[0]
    assert best.number == 2
    assert best.score > 0.9
    assert best.yaw == 0.0


@lru_cache(maxsize=1)
def mapped() -> tuple[TinySequence, Renderer, GaussianMap]:
    """A map seeded from the first frame and its true depth, fitted to a few."""
    camera = erp_camera(WIDTH)
    sequence, renderer = TinySequence(camera, 30), Renderer(camera)
    mapper = Mapper(camera, renderer, configured(start__iterations=0), AnchoredTrajectory(), seed=0)
    depth = sequence.depth(0)
    assert depth is not None
    views = [View(i, sequence.image(i), sequence.pose_at(0.1 * i)) for i in (0, 4, 8)]
    mapper.initialise(views[0], 0.0, depth)
    mapper.optimiser.window = views
    mapper.optimiser.optimise(80, poses=False)
    return sequence, renderer, mapper.map.gaussians


def explained(image: np.ndarray) -> float:
    sequence, renderer, gaussians = mapped()
    camera = sequence.camera
    render = renderer.forward(gaussians, sequence.pose_at(0.0))
    levels = pyramid(luma_of_frame(image.astype(np.uint8), camera.valid_mask()))
    return agreement(levels, render, pixel_weights(camera, "cosine"))


def test_agreement_is_blind_to_exposure_and_sees_another_room() -> None:
    image = mapped()[0].image(0)
    assert explained(image) > 0.95
    assert explained(0.6 * image + 20) > 0.95
    assert explained(TinySequence(erp_camera(WIDTH), 30, seed=99).image(0)) < 0.3
    assert explained(np.full_like(image, 90)) == 1.0


def test_an_occluder_costs_agreement_only_its_own_share() -> None:
    image = mapped()[0].image(0).copy()
    image[:, :32] = np.random.default_rng(0).integers(0, 80, (WIDTH // 2, 32, 1))
    assert 0.65 < explained(image) < 0.85


def test_a_view_of_what_is_not_mapped_agrees_with_nothing() -> None:
    sequence, renderer, gaussians = mapped()
    render = renderer.forward(gaussians.select(slice(0, 0)), np.eye(4))
    levels = pyramid(luma_of_frame(sequence.image(0), sequence.camera.valid_mask()))
    assert agreement(levels, render, pixel_weights(sequence.camera, "cosine")) == 0.0


def shown(images: list[np.ndarray], depth: np.ndarray, camera: Camera) -> PanogsMethod:
    method = PanogsMethod(configured(mapping__iterations=3, start__iterations=10))
    method.start(camera, MethodContext(make_depth=OracleDepth))
    for i, image in enumerate(images):
        method.track(Frame(i, i / 10, image, depth=depth if i == 0 else None))
    return method


def test_a_gyroscope_holds_the_rotation_of_a_frame() -> None:
    camera = PinholeCamera.from_fov(96, 100, 70)
    sequence = TinySequence(camera, 3)
    depth = sequence.depth(0)
    assert depth is not None
    method = shown([sequence.image(i) for i in range(2)], depth, camera)
    tracker, gaussians, last = method.tracker, method.mapper.map.gaussians, method.trajectory[1]
    said = last[:3, :3] @ so3_exp([0.0, np.deg2rad(1.5), 0.0])

    def off(prior: RotationPrior | None) -> float:
        tracker.restart(last)
        found = tracker.track(sequence.image(1), gaussians, prior=prior).T_wc
        return float(np.rad2deg(np.linalg.norm(so3_log(said.T @ found[:3, :3]))))

    assert off(None) > 1.0
    assert off(RotationPrior(said, 1e-5)) < 0.1


def test_lost_frames_get_no_pose_and_the_camera_is_found_again() -> None:
    camera = erp_camera(WIDTH)
    sequence, other = TinySequence(camera, 12), TinySequence(camera, 12, seed=99)
    depth = sequence.depth(0)
    assert depth is not None
    # After the gap the camera stands elsewhere and looks the other way.
    back = [make_pose(so3_exp([0.05, 2.5 + 0.05 * k, 0.0]), [0.4, 0.1, 0.05 * k]) for k in range(3)]
    images = [sequence.image(i) for i in range(12)]
    images += [other.image(i) for i in range(4)]
    images += [np.zeros_like(images[0])] * 3
    images += [sequence.image_from(T) for T in back]
    method = shown(images, depth, camera)
    estimate = method.finish()
    assert [round(10 * t) for t in estimate.trajectory.times] == [*range(12), 19, 20, 21]
    assert all(estimate.frames[i].get("lost") for i in range(12, 16))
    first = sequence.pose_at(0.0)
    for T, truth in zip(estimate.trajectory.T_wc[-3:], back):
        assert np.linalg.norm((first @ T)[:3, 3] - truth[:3, 3]) < 0.03
        assert np.linalg.norm((first @ T)[:3, :3] - truth[:3, :3]) < 0.02
    assert not any(12 <= view.index < 16 for view in [*method.trajectory.keyframes, *method.trajectory.frames])
