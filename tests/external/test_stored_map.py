"""A map that a program stored is kept byte for byte, counted and rendered."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.errors import InputError
from panobench.external.stored_map import StoredMap, read_stored_map
from panobench.splat.ply import write_ply
from panobench.testing import pinhole_camera


@pytest.fixture
def stored(tmp_path: Path) -> StoredMap:
    """One large red Gaussian two metres ahead."""
    quaternion = [[1.0, 0.0, 0.0, 0.0]]
    write_ply(tmp_path / "map.ply", [[0.0, 0.0, 2.0]], [[-1.0, -1.0, -1.0]], quaternion, [6.0], [[1.0, 0.0, 0.0]])
    return read_stored_map(tmp_path / "map.ply")


def test_it_is_written_as_it_was(stored: StoredMap, tmp_path: Path) -> None:
    assert len(stored) == 1
    stored.write_ply(tmp_path / "again.ply")
    assert (tmp_path / "again.ply").read_bytes() == (tmp_path / "map.ply").read_bytes()


def test_it_is_seen_from_a_pose(stored: StoredMap) -> None:
    camera = pinhole_camera(64, 90, 70)
    ahead = stored.render(camera, np.eye(4))
    assert ahead.shape == (camera.height, camera.width, 3)
    assert ahead[camera.height // 2, 32, 0] > 0.9
    assert ahead[..., 1:].max() < 0.05
    behind = np.diag([-1.0, 1.0, -1.0, 1.0])
    assert stored.render(camera, behind).max() == 0


def test_what_is_no_map_is_said_when_it_is_rendered(tmp_path: Path) -> None:
    (tmp_path / "x.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nend_header\n0\n1\n")
    stored = read_stored_map(tmp_path / "x.ply")
    assert len(stored) == 2
    with pytest.raises(InputError):
        stored.render(pinhole_camera(), np.eye(4))
