"""Which frames a video has, when each is shown and where decoding has to begin for it; made once, by demuxing.

Demuxing reads packets and decodes none. What the decoder gives for them is then looked at where it differs from what
the packets promise: at the start (a clip cut out of a longer one begins with frames that cannot be decoded), and in
the last group of pictures. Codecs with packets that show nothing, and containers without stamps, are decoded through.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import DatasetError
from panobench.video.container import bound_decoder, frames, jump, open_container, packets, picture_streams

Ints = NDArray[np.int64]
#: Frames looked at from the start, to see whether packets and frames are one to one.
_PROBED = 24
#: Codecs with packets that only hold what other frames refer to.
_SHOWS_LESS = ("vp8", "libvpx")
#: A last group of pictures larger than this is not decoded to see where it ends.
_LONG_GROUP = 300


@dataclass(frozen=True)
class FrameIndex:
    """stamps: presentation stamp of each frame, increasing, in units of ``unit_s`` seconds. keys: stamp of the keyframe
    from which each is decoded. counted: frames are told apart by their order alone, so that decoding always begins at
    the start. lost: frames that the file promises and that cannot be decoded, at its start or end. assumed_rate: frames
    per second for a file that does not say when its frames are shown.
    """

    stamps: Ints
    keys: Ints
    unit_s: float
    counted: bool = False
    lost: int = 0
    assumed_rate: float | None = None

    @property
    def times(self) -> NDArray[np.float64]:
        """(N,) seconds after the first frame."""
        return np.asarray((self.stamps - self.stamps[0]) * self.unit_s, dtype=np.float64)

    @property
    def clock(self) -> NDArray[np.float64]:
        """(N,) seconds on the file's clock, which its streams share."""
        return np.asarray(self.stamps * self.unit_s, dtype=np.float64)


def index_frames(path: Path, number: int = 0) -> FrameIndex:
    """The index of stream ``number`` (0 is the largest picture). Raises DatasetError if no frame can be decoded."""
    with open_container(path) as container:
        stream = picture_streams(container, path)[number]
        shown = _Packets.read(container, stream)
        rate = _nominal_rate(stream)
        unit, codec = float(stream.time_base or 0), stream.codec_context.name
    if not shown.seen:
        raise DatasetError("the video has no frame", path)
    index = None
    if shown.stamped and unit > 0:
        promised = _from_stamps(shown, unit)
        index = _checked(path, number, codec, promised) or _decoded_through(path, number, promised)
    return index or _counted(path, number, unit, rate)


@dataclass
class _Packets:
    """The packets that are shown, in decoding order. stamped: each has a stamp of its own, pts; key: the keyframes."""

    seen: int
    stamped: bool
    pts: Ints
    key: NDArray[np.bool_]

    @classmethod
    def read(cls, container: Any, stream: Any) -> _Packets:
        pts, key = [], []
        for packet in packets(container, stream):
            # An edit list marks packets that are only decoded for others' sake.
            if packet.size == 0 or packet.is_discard:
                continue
            pts.append(packet.pts)
            key.append(packet.is_keyframe)
        # AVI has decoding stamps alone, of which FFmpeg makes presentation stamps that are wrong for reordered frames.
        guessed = container.format.name == "avi" and stream.codec_context.has_b_frames
        stamped = bool(pts) and None not in pts and len(set(pts)) == len(pts) and not guessed
        return cls(len(pts), stamped, np.array(pts if stamped else [], np.int64), np.array(key, bool))


def _from_stamps(shown: _Packets, unit: float) -> FrameIndex:
    """Frames in order of presentation; each is decoded from the last keyframe that is shown no later than it."""
    key_at = np.flatnonzero(shown.key)
    if len(key_at) == 0 or key_at[0] != 0:
        key_at = np.concatenate([[0], key_at])
    latest = np.searchsorted(key_at, np.arange(shown.seen), side="right") - 1
    leading = shown.pts < shown.pts[key_at[latest]]
    keys = shown.pts[key_at[np.maximum(latest - leading, 0)]]
    stamps, first = np.unique(shown.pts, return_index=True)
    return FrameIndex(stamps, np.minimum(keys[first], stamps), unit)


def _checked(path: Path, number: int, codec: str, index: FrameIndex) -> FrameIndex | None:
    """The index without the frames at either end that do not decode; None if packets and frames are not one to one."""
    if codec in _SHOWS_LESS:
        return None
    start = _decoded_stamps(path, number, None, _PROBED)
    if not len(start) or (np.diff(start) <= 0).any():
        return None
    begin = int(np.searchsorted(index.stamps, start[0]))
    seen = index.stamps[begin : np.searchsorted(index.stamps, start[-1], side="right")]
    if not np.isin(seen, start).all():
        return None
    end = len(index.stamps)
    group_size = int((index.stamps[begin:] >= index.keys[-1]).sum())
    if end - begin > len(seen) and group_size <= _LONG_GROUP:
        tail = _decoded_stamps(path, number, int(index.keys[-1]), None)
        group = index.stamps[begin:] >= index.keys[-1]
        decoded = np.isin(index.stamps[begin:], tail)
        if not (group & decoded).any():
            return None
        end = begin + int(np.flatnonzero(group & decoded)[-1]) + 1
    lost = len(index.stamps) - (end - begin)
    return FrameIndex(index.stamps[begin:end], index.keys[begin:end], index.unit_s, lost=lost)


def _decoded_stamps(path: Path, number: int, key: int | None, limit: int | None) -> Ints:
    """Stamps of the frames as they come out of the decoder, from the start or a keyframe; at most ``limit``."""
    found: list[int] = []
    with open_container(path) as container:
        stream = picture_streams(container, path)[number]
        bound_decoder(stream)
        if key is not None and not jump(container, stream, key):
            return np.zeros(0, np.int64)
        for frame in frames(container, stream):
            if frame.pts is not None:
                found.append(frame.pts)
            if limit is not None and len(found) >= limit:
                break
    return np.array(found, np.int64)


def _decoded_through(path: Path, number: int, index: FrameIndex) -> FrameIndex | None:
    """The frames that really come out, all decoded once; None if their stamps are not in order."""
    stamps = _decoded_stamps(path, number, None, None)
    stamps = stamps[np.isin(stamps, index.stamps)]
    if not len(stamps) or (np.diff(stamps) <= 0).any():
        return None
    return FrameIndex(stamps, index.keys[np.searchsorted(index.stamps, stamps)], index.unit_s)


def _counted(path: Path, number: int, unit: float, rate: float) -> FrameIndex:
    """Frames by the order in which they come; with sorted stamps, or even ones where they nearly are or are too few."""
    found: list[int | None] = []
    with open_container(path) as container:
        stream = picture_streams(container, path)[number]
        bound_decoder(stream)
        for frame in frames(container, stream):
            found.append(frame.dts if frame.pts is None else frame.pts)
    count = len(found)
    if not count:
        raise DatasetError("no frame of the video can be decoded: it is damaged", path)
    stamps = np.unique(np.array([s for s in found if s is not None], np.int64))
    assumed = None
    steps = np.diff(stamps)
    if len(stamps) < count or (steps == np.median(steps)).mean() > 0.9:
        if len(stamps) > count // 2 and unit > 0:
            unit *= float(np.median(steps))
        elif 0 < rate <= 1000:
            unit, assumed = 1.0 / rate, rate
        else:
            raise DatasetError(f"the video has no time stamps and claims {rate:g} frames per second", path)
        stamps = np.arange(count, dtype=np.int64)
    return FrameIndex(stamps, np.full(count, stamps[0]), unit, counted=True, assumed_rate=assumed)


def _nominal_rate(stream: Any) -> float:
    """Frames per second as the container says; 0 if it does not."""
    return float(stream.average_rate or stream.guessed_rate or stream.base_rate or 0)
