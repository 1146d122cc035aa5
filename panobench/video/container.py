"""Opening a video file with FFmpeg (PyAV), choosing its pictures, and stepping through packets and frames.

Everything FFmpeg raises about a file becomes a DatasetError of one line here, or is counted as damage by the caller.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from panobench.datasets.files.images import MAX_PIXELS
from panobench.errors import DatasetError

#: Demuxers that are read. Playlists, image lists and scripts are not: they name other files.
_FORMATS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,live_flv,asf,ogg,gif,h264,hevc,av1,ivf,obu,nut,mxf,"
    "m4v,vob,wtv,gxf,dv,rm"
)
#: Frames that decode at the same time may hold this much memory together, besides those a codec refers back to.
_THREAD_BYTES = 128 << 20
_MAX_THREADS = 8


def open_container(path: Path) -> Any:
    """The file as a PyAV container. Raises DatasetError for a file that is missing, empty or no video."""
    import av

    try:
        if path.stat().st_size == 0:
            raise DatasetError("the video is empty", path)
        options = {"format_whitelist": _FORMATS, "protocol_whitelist": "file"}
        return av.open(_source(path), options=options, metadata_errors="replace")
    except (av.error.FFmpegError, ValueError) as error:
        if isinstance(error, OSError) and error.errno in _SYSTEM_ERRORS:
            raise DatasetError(f"the video cannot be read ({error.strerror})", path) from None
        raise DatasetError("the video cannot be opened: not a video, truncated, or an unknown codec", path) from None
    except OSError as error:
        raise DatasetError(f"the video cannot be read ({error.strerror})", path) from None


#: ENOENT, EIO, EACCES, EISDIR: said as the system says them.
_SYSTEM_ERRORS = (2, 5, 13, 21)


def _source(path: Path) -> Any:
    """What av.open takes: an absolute name (which is never taken for a URL), or a file where FFmpeg cannot name it."""
    name = os.path.abspath(path)
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return open(name, "rb")
    return name


def picture_streams(container: Any, path: Path) -> list[Any]:
    """Streams of moving pictures that can be decoded, the largest picture first; cover art does not count.

    Raises DatasetError for a file with sound alone, or in a codec there is no decoder for.
    """
    from av.stream import Disposition

    still = Disposition.attached_pic | Disposition.timed_thumbnails | Disposition.still_image
    streams = [s for s in container.streams.video if not s.disposition & still]
    usable = [s for s in streams if s.codec_context is not None and s.codec_context.width > 0]
    if not usable:
        if streams:
            raise DatasetError("the video is in a codec that cannot be decoded here; convert it to H.264", path)
        what = "the file has sound but no video" if container.streams.audio else "the file has no video"
        raise DatasetError(what, path)
    return sorted(usable, key=lambda s: -s.codec_context.width * s.codec_context.height)


def bound_decoder(stream: Any) -> None:
    """Let the decoder use several cores, fewer for large pictures (each thread holds a frame of its own), and refuse
    pictures over the limits for images, whatever the stream claims.
    """
    context = stream.codec_context
    frame_bytes = max(1, context.width * context.height * 3 // 2)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    context.options = {"max_pixels": str(MAX_PIXELS)}
    context.thread_type = "AUTO"
    context.thread_count = max(1, min(cores, _MAX_THREADS, _THREAD_BYTES // frame_bytes))


def jump(container: Any, stream: Any, key: int) -> bool:
    """Go to the keyframe with the stamp ``key``, or one before it; whether the container can."""
    import av

    try:
        container.seek(key, stream=stream)
    except (av.error.FFmpegError, OSError):
        return False
    return True


def packets(container: Any, stream: Any) -> Iterator[Any]:
    """The stream's packets in decoding order, with the empty one that ends them; reading ends where the file does.

    A packet without a presentation stamp gets its decoding stamp where the codec does not reorder frames.
    """
    import av

    reorders = bool(getattr(stream.codec_context, "has_b_frames", True))
    source = container.demux(stream)
    while True:
        try:
            packet = next(source, None)
        except (av.error.FFmpegError, OSError):  # the container's structure is broken from here on
            return
        if packet is None:
            return
        if packet.pts is None and packet.dts is not None and not reorders:
            packet.pts = packet.dts
        yield packet


def frames(container: Any, stream: Any) -> Iterator[Any]:
    """Decoded frames in presentation order from where the container stands. Packets that do not decode are skipped."""
    import av

    for packet in packets(container, stream):
        if packet.size == 0 and packet.dts is not None:
            continue  # a frame that was not recorded; the decoder would take it for the end
        try:
            yield from packet.decode()
        except (av.error.FFmpegError, OSError):
            continue


def side_data(frame: Any) -> dict[str, bytes]:
    """What the container says beside a decoded frame, by FFmpeg's name for it: DISPLAYMATRIX, SPHERICAL, STEREO3D."""
    try:
        return {item.type.name: bytes(item) for item in frame.side_data}
    except ValueError:  # a kind newer than PyAV's list of kinds hides them all
        return {}
