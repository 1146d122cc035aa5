"""The built-in rooms: exact truth, caching, determinism."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.datasets.synthetic.rooms import RoomsDataset, RoomSequence
from panobench.errors import UnknownNameError, UsageError
from panobench.geometry import invert_pose


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def _own_cache(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_CACHE", str(cache))


@pytest.fixture(scope="module")
def tiny(cache: Path) -> RoomSequence:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PANOBENCH_CACHE", str(cache))
        sequence = RoomsDataset().open("tiny", width=192)
        sequence.prepare(21)
    return sequence


def test_contract(tiny: RoomSequence) -> None:
    assert len(tiny) >= 30
    assert (np.diff(tiny.times) > 0).all()
    image, depth, truth = tiny.image(0), tiny.depth(0), tiny.groundtruth
    assert image.shape == (96, 192, 3)
    assert image.dtype == np.uint8
    assert depth is not None
    assert depth.shape == (96, 192)
    assert depth.dtype == np.float32
    assert np.isfinite(depth).all()  # a closed room: no cracks
    assert truth is not None
    assert len(truth) == len(tiny)
    R = truth.T_wc[:, :3, :3]
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=1e-12)
    start = np.linalg.norm(truth.positions[12] - truth.positions[0])
    assert 0.2 < start < 0.5


def test_depth_agrees_between_frames(tiny: RoomSequence) -> None:
    """Points of one frame, moved into another, lie at that frame's depth wherever nothing hides them."""
    truth = tiny.groundtruth
    assert truth is not None
    camera = tiny.camera
    a, b = tiny.depth(0), tiny.depth(12)
    assert a is not None
    assert b is not None
    points = (camera.rays() * a[..., None]) @ truth.T_wc[0, :3, :3].T + truth.T_wc[0, :3, 3]
    T_bw = invert_pose(truth.T_wc[12])
    local = points @ T_bw[:3, :3].T + T_bw[:3, 3]
    uv, _ = camera.project(local)
    x, y = (
        np.floor(uv[..., 0]).astype(int) % camera.width,
        np.clip(np.floor(uv[..., 1]).astype(int), 0, camera.height - 1),
    )
    # Depth differs within a pixel: compare with the range of its neighbourhood.
    around = np.stack([np.roll(b, (i, j), (0, 1))[y, x] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    r = np.linalg.norm(local, axis=-1)
    inside = (r > around.min(axis=0) - 2e-3) & (r < around.max(axis=0) + 2e-3)
    hidden = r > around.max(axis=0)
    assert (inside | hidden).mean() > 0.985
    assert inside.mean() > 0.9


def test_unknown_names() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'room1'"):
        RoomsDataset().open("rom1")
    with pytest.raises(UnknownNameError, match="variant"):
        RoomsDataset().open("tiny+blurr2")
    with pytest.raises(UsageError, match="seed"):
        RoomsDataset().open("tiny@x")


def test_cached_frames_are_the_rendered_ones(tiny: RoomSequence) -> None:
    again = RoomsDataset().open("tiny", width=192)
    np.testing.assert_array_equal(again.image(3), tiny._renderer.frame(3))


def test_any_width(tiny: RoomSequence) -> None:
    other = RoomsDataset().open("tiny", camera=ErpCamera(64, 32))
    assert other.image(0).shape == (32, 64, 3)
