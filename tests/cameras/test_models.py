"""What every camera model promises, checked on random cameras of each."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from camera_strategies import EXAMPLES, QUICK, STRATEGIES
from hypothesis import given, settings
from hypothesis import strategies as st

from panobench.cameras.base import Camera
from panobench.cameras.factory import camera_from_dict
from panobench.errors import CalibrationError
from panobench.plugins import load_registry
from panobench.specs import CameraSpec

MODELS = sorted(STRATEGIES)


def unit_points(seed: int, n: int = 200) -> np.ndarray:
    p = np.random.default_rng(seed).normal(size=(n, 3))
    return p / np.linalg.norm(p, axis=1, keepdims=True)


@pytest.mark.parametrize("model", MODELS)
def test_pixels_survive_the_round_trip(model: str) -> None:
    @QUICK
    @given(STRATEGIES[model], st.integers(0, 2**32 - 1))
    def check(camera: Camera, seed: int) -> None:
        pixels = np.random.default_rng(seed).uniform(0, [camera.width, camera.height], (200, 2))
        rays = camera.unproject(pixels)
        known = np.isfinite(rays).all(axis=-1)
        assert np.allclose(np.linalg.norm(rays[known], axis=-1), 1, atol=1e-12)
        again, valid = camera.project(rays[known] * 3.7)
        # A limited panorama keeps the rays of the pixels it declares invalid.
        assert valid.all() or model == "erp"
        assert np.abs(again - pixels[known]).max(initial=0) < 1e-6
        assert known.any()

    check()


@pytest.mark.parametrize("model", MODELS)
def test_points_survive_the_round_trip(model: str) -> None:
    @QUICK
    @given(STRATEGIES[model], st.integers(0, 2**32 - 1))
    def check(camera: Camera, seed: int) -> None:
        points = unit_points(seed)
        pixels, valid = camera.project(points)
        assert (pixels[valid] >= 0).all()
        assert (np.floor(pixels[valid]) < [camera.width, camera.height]).all()
        # The image of a ray fixes it to 1e-6 px; where a lens squeezes the rim, that is a coarser angle.
        again, still = camera.project(camera.unproject(pixels[valid]))
        assert still.all()
        assert np.abs(again - pixels[valid]).max(initial=0) < 1e-6
        # Two different rays may not share a pixel: going back must return the same one.
        rays = camera.unproject(pixels[valid])
        assert np.abs(rays - points[valid]).max(initial=0) < 1e-4

    check()


@pytest.mark.parametrize("model", MODELS)
def test_jacobian_matches_finite_differences(model: str) -> None:
    @QUICK
    @given(STRATEGIES[model], st.integers(0, 2**32 - 1), st.floats(0.2, 20))
    def check(camera: Camera, seed: int, distance: float) -> None:
        points = unit_points(seed) * distance
        J = camera.jacobian(points)
        assert J.shape == (len(points), 2, 3)
        step = 1e-6 * distance
        columns, smooth = [], camera.project(points)[1]
        for axis in np.eye(3):
            above, ok_above = camera.project(points + step * axis)
            below, ok_below = camera.project(points - step * axis)
            # Across the seam or a cube's edge the pixel jumps: no derivative there.
            smooth &= ok_above & ok_below & (np.abs(above - below).max(axis=-1) < 0.2)
            columns.append((above - below) / (2 * step))
        numeric = np.stack(columns, axis=-1)
        scale = 1 + np.abs(J[smooth])
        assert (np.abs(J[smooth] - numeric[smooth]) / scale).max(initial=0) < 2e-4

    check()


@pytest.mark.parametrize("model", MODELS)
def test_jacobian_on_the_optical_axis_is_finite(model: str) -> None:
    @QUICK
    @given(STRATEGIES[model])
    def check(camera: Camera) -> None:
        on_axis = camera.jacobian([0.0, 0.0, 2.0])
        beside = camera.jacobian([1e-7, -1e-7, 2.0])
        assert np.isfinite(on_axis).all()
        assert np.abs(on_axis - beside).max() < 1e-3 * (1 + np.abs(on_axis).max())

    check()


@pytest.mark.parametrize("model", MODELS)
def test_plain_values_describe_the_camera(model: str) -> None:
    @QUICK
    @given(STRATEGIES[model])
    def check(camera: Camera) -> None:
        values = camera.to_dict()
        assert values["model"] == model
        assert camera_from_dict(values) == camera
        assert type(camera).from_dict(values) == camera
        with pytest.raises(CalibrationError, match="colour"):
            camera_from_dict({**values, "colour": 3})
        with pytest.raises(CalibrationError, match="width"):
            camera_from_dict({k: v for k, v in values.items() if k != "width"})
        with pytest.raises(CalibrationError):
            camera_from_dict({**values, "height": float("nan")})

    check()


@pytest.mark.parametrize("model", MODELS)
def test_scaling_keeps_the_view(model: str) -> None:
    @QUICK
    @given(STRATEGIES[model], st.integers(2, 4), st.integers(0, 2**32 - 1))
    def check(camera: Camera, factor: int, seed: int) -> None:
        large = camera.scaled(camera.width * factor)
        assert (large.width, large.height) == (camera.width * factor, camera.height * factor)
        points = unit_points(seed)
        a, valid = camera.project(points)
        b, also = large.project(points)
        both = valid & also
        wrapped = np.abs(b - a * factor)[both]
        if model == "cubemap":  # a point within rounding of an edge may change sides of a pixel border
            assert (wrapped < 1e-6).all()
        assert wrapped.max(initial=0) < 1e-6
        assert (valid == also).mean() > 0.98
        assert large.scaled(camera.width).project(points)[0][both] == pytest.approx(a[both], abs=1e-6)

    check()


@pytest.mark.parametrize("model", MODELS)
def test_solid_angles_sum_to_the_coverage(model: str) -> None:
    """Against the share of uniformly random directions that the camera sees."""

    @settings(QUICK, max_examples=8)
    @given(STRATEGIES[model])
    def check(camera: Camera) -> None:
        # Fine enough that the pixels cut by the rim are few, however small the drawn camera is.
        fine = camera.scaled(camera.width * max(2, -(-480 // camera.width)))
        area = fine.solid_angle()
        assert area.shape == (fine.height, fine.width)
        assert (area >= 0).all()
        assert ((area > 0) == fine.valid_mask()).mean() > 0.97
        _, seen = fine.project(unit_points(7, 100_000))
        # 3 sigma of the random share, and the pixels cut by the rim of the field of view.
        assert area.sum() / (4 * np.pi) == pytest.approx(seen.mean(), abs=0.0045 + 0.03 * seen.mean())

    check()


def test_full_panorama_and_cubemap_cover_the_sphere_exactly() -> None:
    from panobench.cameras.cubemap import CubemapCamera
    from panobench.cameras.erp import ErpCamera

    for camera in (ErpCamera(128, 64), CubemapCamera(96, 16)):
        assert camera.solid_angle().sum() == pytest.approx(4 * np.pi, rel=1e-12)


@pytest.mark.parametrize("model", MODELS)
def test_mask_and_immutability(model: str) -> None:
    @settings(QUICK, max_examples=5)
    @given(STRATEGIES[model])
    def check(camera: Camera) -> None:
        mask = np.zeros((camera.height, camera.width), dtype=bool)
        mask[:, : camera.width // 2] = True
        masked = camera.with_mask(mask)
        mask[:] = False
        assert masked.mask is not None
        assert masked.mask[:, 0].all()
        assert np.array_equal(masked.valid_mask(), camera.valid_mask() & masked.mask)
        assert masked != camera
        assert masked.with_mask(None) == camera
        assert hash(masked.with_mask(None)) == hash(camera)
        assert masked.scaled(camera.width * 2).mask is not None
        with pytest.raises(ValueError, match="read-only"):
            masked.mask[0, 0] = False
        with pytest.raises(dataclasses.FrozenInstanceError):
            camera.width = 3  # type: ignore[misc]
        with pytest.raises(CalibrationError, match="mask is"):
            camera.with_mask(np.ones((camera.height + 1, camera.width), dtype=bool))

    check()


@pytest.mark.parametrize("model", MODELS)
def test_nothing_comes_from_nan_or_the_centre(model: str) -> None:
    @settings(QUICK, max_examples=5)
    @given(STRATEGIES[model])
    def check(camera: Camera) -> None:
        points = np.array([[np.nan, 0, 1], [0.0, 0.0, 0.0], [np.inf, 0, 1]])
        assert not camera.project(points)[1][:2].any()
        assert np.isnan(camera.unproject([np.nan, 1.0])).all()
        assert np.isnan(camera.unproject([[1.0, -5.0 - camera.height]])).all() or model not in ("erp", "cubemap")

    check()


def test_every_registered_model_is_tested() -> None:
    assert set(load_registry(entry_points=False).specs(CameraSpec)) == set(STRATEGIES)


@pytest.mark.parametrize("model", MODELS)
def test_every_parameter_is_documented(model: str) -> None:
    page = (Path(__file__).parents[2] / "docs" / "cameras" / f"{model}.md").read_text(encoding="utf-8")
    missing = [f.name for f in dataclasses.fields(EXAMPLES[model]) if f.name != "mask" and f"`{f.name}`" not in page]
    assert missing == []
    assert "Source" in page
