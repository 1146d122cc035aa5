"""Small clips whose frames say their own number, with the time stamps that are asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

SIZE = (128, 64)
_BITS = 9
TICKS = 90_000


def numbered(index: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """RGB (H, W, 3): bright and dark bars that are the bits of ``index``."""
    width, height = size
    image = np.full((height, width, 3), 60, np.uint8)
    bar = width // _BITS
    for bit in range(_BITS):
        if index >> bit & 1:
            image[height // 8 : -height // 8, bit * bar : (bit + 1) * bar - 2] = 220
    return image


def number(image: np.ndarray) -> int:
    """The number in a picture made by ``numbered``, whatever its size."""
    height, width = image.shape[:2]
    bar = width / _BITS
    middle = image[height // 2 - 2 : height // 2 + 2]
    return sum(1 << bit for bit in range(_BITS) if middle[:, int((bit + 0.45) * bar)].mean() > 140)


def clip(
    path: Path,
    times: Sequence[float],
    *,
    codec: str = "libx264",
    pixels: str = "yuv420p",
    size: tuple[int, int] = SIZE,
    frame: Callable[[int, tuple[int, int]], np.ndarray] = numbered,
    rate: int | None = None,
    **options: object,
) -> Path:
    """Write a clip. ``rate``: stamps count frames at that rate, for codecs and containers that know no other."""
    unit = Fraction(1, rate or TICKS)
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=rate or 30)
        stream.width, stream.height = size
        stream.pix_fmt = pixels
        stream.time_base = stream.codec_context.time_base = unit
        fixed = {"sc_threshold": "0"} if codec == "libx264" else {}  # keyframes where ``g`` says, and nowhere else
        stream.codec_context.options = {**fixed, **{name: str(value) for name, value in options.items()}}
        for index, time in enumerate(times):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame(index, size)), format="rgb24")
            picture.pts, picture.time_base = round(time / unit), unit
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def copied(
    source: Path,
    target: Path,
    keep: Callable[[int], bool] = lambda index: True,
    spoil: Callable[[int, bytes], bytes] | None = None,
) -> Path:
    """The packets of ``source`` for whose number ``keep`` is true, their bytes changed by ``spoil``."""
    with av.open(str(source)) as container, av.open(str(target), "w") as out:
        stream = container.streams.video[0]
        copy = out.add_stream_from_template(stream)
        for index, packet in enumerate(p for p in container.demux(stream) if p.size):
            if not keep(index):
                continue
            if spoil is not None:
                data = bytes(packet)
                changed = spoil(index, data)
                if changed != data:
                    spoilt = av.Packet(changed)
                    spoilt.pts, spoilt.dts, spoilt.time_base = packet.pts, packet.dts, packet.time_base
                    spoilt.is_keyframe = packet.is_keyframe
                    packet = spoilt
            packet.stream = copy
            out.mux(packet)
    return target
