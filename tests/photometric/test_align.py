"""Direct alignment, checked on an analytic scene: a textured sphere of radius 2 m about the world's origin."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.synthetic.disturb import Disturbances, Disturber
from panobench.geometry import invert_pose, se3_exp, se3_log, so3_exp
from panobench.inertial.rotation_prior import RotationPrior
from panobench.photometric.align import align
from panobench.photometric.pyramid import halve, luma_of_frame, pyramid
from panobench.photometric.reference import DEFAULT, AlignOptions, make_reference, reject_moving

RADIUS = 2.0
WAVES = np.random.default_rng(3).normal(size=(24, 3)) * 6.0
PHASES = np.random.default_rng(4).uniform(0, 6.28, 24)


def texture(points: np.ndarray) -> np.ndarray:
    """Smooth brightness in 0..1 of points (..., 3) on the sphere."""
    return 0.5 + 0.08 * np.sin(points @ WAVES.T / RADIUS + PHASES).sum(axis=-1) / 2


def view(camera: object, T_wc: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brightness and radial depth of the sphere's inside from a pose."""
    rays = camera.rays() @ T_wc[:3, :3].T  # type: ignore[attr-defined]
    t = T_wc[:3, 3]
    b = rays @ t
    depth = -b + np.sqrt(b * b - t @ t + RADIUS**2)
    return texture(t + rays * depth[..., None]).astype(np.float32), depth.astype(np.float32)


CAMERAS = {
    "erp": ErpCamera(256, 128),
    "erp 120 deg": ErpCamera(256, 128, hfov_deg=120.0, lat_min_deg=-50, lat_max_deg=50),
    "pinhole": PinholeCamera.from_fov(160, 100.0, 70.0),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize(("metres", "degrees"), [(0.02, 1.0), (0.08, 4.0)])
def test_recovers_a_known_motion(name: str, metres: float, degrees: float) -> None:
    camera = CAMERAS[name]
    rng = np.random.default_rng(1)
    direction, axis = rng.normal(size=3), rng.normal(size=3)
    xi = np.concatenate(
        [metres * direction / np.linalg.norm(direction), np.deg2rad(degrees) * axis / np.linalg.norm(axis)]
    )
    T_fr = se3_exp(xi)
    luma, depth = view(camera, np.eye(4))
    depth = np.where(camera.valid_mask(), depth, np.nan).astype(np.float32)
    frame, _ = view(camera, invert_pose(T_fr))
    frame = np.where(camera.valid_mask(), frame, np.nan).astype(np.float32)
    levels = pyramid(frame, 64)
    found = align(make_reference(camera, luma, depth, len(levels)), levels, np.eye(4))
    error = se3_log(found.T_fr @ invert_pose(T_fr))
    assert np.linalg.norm(error[:3]) < 1.5e-3
    assert np.rad2deg(np.linalg.norm(error[3:])) < 0.05
    assert np.linalg.eigvalsh(found.hessian).min() > 0


def test_a_gyroscope_holds_the_rotation_where_depth_is_wrong_as_far_as_it_is_sure() -> None:
    camera = CAMERAS["pinhole"]
    T_fr = se3_exp(np.array([0.2, 0.0, 0.0, 0.0, np.deg2rad(3.0), 0.0]))
    luma, depth = view(camera, np.eye(4))
    levels = pyramid(view(camera, invert_pose(T_fr))[0], 64)

    def turned(depth: np.ndarray, prior: RotationPrior | None) -> float:
        """Degrees by which the alignment turns too far."""
        found = align(make_reference(camera, luma, depth, len(levels)), levels, np.eye(4), prior=prior)
        return float(np.rad2deg(np.linalg.norm(se3_log(found.T_fr @ invert_pose(T_fr))[3:])))

    def gyroscope(off_deg: float, sigma_deg: float) -> RotationPrior:
        R = T_fr[:3, :3].T @ so3_exp(np.deg2rad([0, off_deg, 0]))
        return RotationPrior(R, np.deg2rad(sigma_deg))

    leaning = (depth * (1 + 0.3 * camera.rays()[..., 0])).astype(np.float32)
    assert turned(leaning, None) > 0.5
    assert turned(leaning, gyroscope(0.02, 0.05)) < 0.2
    assert turned(depth, gyroscope(2.0, 2.0)) < 0.2


def test_exposure_is_separated_from_motion() -> None:
    camera = CAMERAS["erp"]
    T_fr = se3_exp([0.03, 0, 0.02, 0, 0.02, 0])
    luma, depth = view(camera, np.eye(4))
    frame, _ = view(camera, invert_pose(T_fr))
    levels = pyramid((1.2 * frame - 0.05).astype(np.float32), 64)
    options = AlignOptions(exposure=True)
    found = align(make_reference(camera, luma, depth, len(levels), options), levels, np.eye(4), options)
    assert np.linalg.norm(se3_log(found.T_fr @ invert_pose(T_fr))[:3]) < 2e-3
    assert np.exp(found.gain) == pytest.approx(1.2, abs=0.02)


@pytest.mark.parametrize("apart", [2, 4])
def test_what_moves_in_front_of_a_quarter_of_the_view_does_not_pull(apart: int) -> None:
    """The occluder is in the reference too, 6 or 12 degrees away, with the wall's depth: as a map would have it."""
    camera = CAMERAS["erp"]
    occluder = Disturber(Disturbances(occluder=0.25), camera, 10)

    def seen(T_wc: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
        luma, depth = view(camera, T_wc)
        image = np.repeat(np.round(255 * luma[..., None]), 3, axis=2).astype(np.uint8)
        return luma_of_frame(occluder(image, index), camera.valid_mask()), depth

    T_fr = se3_exp(np.array([0.03, -0.01, 0.04, 0.0, np.deg2rad(1.0), 0.0]))
    luma, depth = seen(np.eye(4), 0)
    levels = pyramid(seen(invert_pose(T_fr), apart)[0], 64)
    reference = make_reference(camera, luma, depth, len(levels))
    found, pulled = (align(reference, levels, np.eye(4), options) for options in (reject_moving(camera), DEFAULT))
    error, before = (np.linalg.norm(se3_log(a.T_fr @ invert_pose(T_fr))) for a in (found, pulled))
    assert error < 5e-3
    assert error < 0.5 * before
    assert reject_moving(CAMERAS["pinhole"]) is DEFAULT


def test_a_blank_frame_changes_nothing() -> None:
    camera = CAMERAS["erp"]
    luma, depth = view(camera, np.eye(4))
    reference = make_reference(camera, luma, depth, 3)
    for value in (0.0, 1.0, np.nan):
        blank = pyramid(np.full((128, 256), value, np.float32), 64)
        found = align(reference, blank, np.eye(4))
        assert np.isfinite(found.T_fr).all()


def test_halving_averages_and_skips_unknown() -> None:
    image = np.arange(16, dtype=np.float32).reshape(4, 4)
    assert halve(image)[0, 0] == pytest.approx(2.5)
    image[0, 0] = np.nan
    assert halve(image)[0, 0] == pytest.approx((1 + 4 + 5) / 3)
    image[0, 1] = np.nan
    assert np.isnan(halve(image)[0, 0])


def test_other_latitude_weights_than_the_cosine_for_the_ablation() -> None:
    from panobench.photometric.weighting import reweighted

    luma, depth = view(CAMERAS["erp"], np.eye(4))
    reference = make_reference(CAMERAS["erp"], luma, depth, 2)
    assert reweighted(reference, "cosine") is reference
    for level in range(2):
        x, y, z = reference.levels[level].points
        lat = np.arcsin(-y / np.sqrt(x * x + y * y + z * z))
        assert np.allclose(reference.levels[level].weight, np.cos(lat), atol=1e-5)
        assert np.all(reweighted(reference, "uniform").levels[level].weight == 1)
        narrow = np.exp(-0.5 * (lat / np.deg2rad(30)) ** 2)
        assert np.allclose(reweighted(reference, "gaussian").levels[level].weight, narrow, atol=1e-5)
    flat, flat_depth = view(CAMERAS["pinhole"], np.eye(4))
    pinhole = make_reference(CAMERAS["pinhole"], flat, flat_depth, 1)
    assert reweighted(pinhole, "gaussian") is pinhole


@pytest.mark.parametrize("name", ["erp", "pinhole"])
def test_some_of_the_pixels_find_the_same_motion(name: str) -> None:
    camera = ErpCamera(256, 128) if name == "erp" else PinholeCamera.from_fov(192, 100.0, 70.0)
    T = se3_exp(np.array([0.02, -0.01, 0.015, 0.01, -0.02, 0.01]))
    image, depth = view(camera, np.eye(4))
    moved, _ = view(camera, invert_pose(T))
    whole = make_reference(camera, image, depth, 4)
    some = make_reference(camera, image, depth, 4, AlignOptions(pixels=2000))
    sizes = [len(level.value) for level in some.levels]
    assert sizes[0] < 2500
    assert sizes[0] > 0.6 * 2000 * len(whole.levels[0].value) / image.size
    assert sizes[-1] == len(whole.levels[-1].value)
    # No row and no column is left out.
    assert len(np.unique(np.round(some.levels[0].points[1] / np.linalg.norm(some.levels[0].points, axis=0), 4))) > 50
    a = align(some, pyramid(moved)[:4], np.eye(4), AlignOptions(pixels=2000))
    assert np.abs(se3_log(a.T_fr @ invert_pose(T))).max() < 2e-3
