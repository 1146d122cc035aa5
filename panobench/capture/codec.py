"""A stream through a video codec and back, at so many bits per pixel."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

_ENCODERS = {"h264": "libx264", "h265": "libx265"}


def through_codec(frames: Iterable[Image], codec: str, bits_per_pixel: float, rate: float) -> Iterator[Image]:
    """RGB frames (H, W, 3) as a decoder gives them back, one for one; ``codec``: "h264" or "h265"."""
    import av

    encoded = io.BytesIO()
    with av.open(encoded, "w", format="mp4") as container:
        stream = None
        for image in frames:
            if stream is None:
                height, width = image.shape[:2]
                stream = container.add_stream(_ENCODERS[codec], rate=Fraction(rate).limit_denominator(1000))
                stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
                stream.bit_rate = max(1000, round(bits_per_pixel * width * height * rate))
                stream.options = {"preset": "medium"} | ({"x265-params": "log-level=none"} if codec == "h265" else {})
            padded = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            container.mux(stream.encode(av.VideoFrame.from_ndarray(padded, format="rgb24")))
        if stream is None:
            return
        container.mux(stream.encode(None))
    encoded.seek(0)
    with av.open(encoded, "r") as container:
        for frame in container.decode(video=0):
            yield np.ascontiguousarray(frame.to_ndarray(format="rgb24")[:height, :width])
