"""The pytest fixtures: import them in your ``conftest.py`` from ``panobench.testing``."""

from __future__ import annotations

import pytest

from panobench.cameras.base import Camera
from panobench.testing.cameras import FakeCamera
from panobench.testing.sequences import TinySequence, rotating_pose


@pytest.fixture
def tiny_sequence() -> TinySequence:
    """Eight 128x64 panoramas of a textured room along a smooth path, with exact truth."""
    return TinySequence()


@pytest.fixture
def rotating_sequence() -> TinySequence:
    """The same room, the camera only rotating."""
    return TinySequence(pose=rotating_pose)


@pytest.fixture
def fake_camera() -> Camera:
    """A 64x48 fisheye that no built-in model knows."""
    return FakeCamera()
