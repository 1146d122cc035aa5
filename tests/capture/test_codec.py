"""Streams through a codec: one frame out for each one in, in order, worse with fewer bits."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.capture.codec import through_codec


def stream(count: int = 12) -> list[np.ndarray]:
    u, v = np.meshgrid(np.arange(128), np.arange(64))
    rng = np.random.default_rng(0)
    texture = rng.integers(0, 60, (64, 128))
    frames = []
    for i in range(count):
        grey = 90 + 60 * np.sin((u + 3 * i) / 9) * np.cos(v / 7) + np.roll(texture, -3 * i, axis=1) / 2
        frames.append(np.uint8(np.repeat(grey[..., None], 3, axis=-1)))
    return frames


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_frames_come_back_in_order_and_worse_with_fewer_bits(codec: str) -> None:
    frames = stream()
    errors = []
    for bits in (2.0, 0.05):
        back = list(through_codec(frames, codec, bits, 15.0))
        assert [f.shape for f in back] == [f.shape for f in frames]
        table = [[np.abs(a.astype(float) - b).mean() for b in frames] for a in back]
        errors.append(np.diag(table).mean())
        if bits == 2.0:
            assert np.argmin(table, axis=1).tolist() == list(range(len(frames)))
    assert errors[0] < 4 < errors[1]


def test_odd_sizes_keep_their_size() -> None:
    back = list(through_codec([f[:63, :127] for f in stream(3)], "h264", 1.0, 15.0))
    assert [f.shape for f in back] == [(63, 127, 3)] * 3
