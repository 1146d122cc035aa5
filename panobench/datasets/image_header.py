"""Width, height and completeness of an image file, from its bytes, before it is decoded.

Sources: PNG specification (W3C 2003), sections 5 and 11; JPEG, ITU-T T.81 annex B; WebP container
(RFC 9649), section 2; Windows bitmap headers.
"""

from __future__ import annotations

import struct

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
#: JPEG start-of-frame markers (C4, C8 and CC in that range are other segments).
_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
#: Bytes that are read first to find the size; cameras write large EXIF blocks before it.
HEAD_BYTES = 1 << 16


class HeaderError(ValueError):
    """The bytes are not an image that this package reads, or they end too early."""


def image_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) from the first bytes of a file; None if the header reaches beyond ``data``.

    Raises HeaderError for a format other than PNG, JPEG, WebP or BMP.
    """
    if data[:8] == _PNG_MAGIC:
        if len(data) < 24:
            return None
        if data[12:16] != b"IHDR":
            raise HeaderError("PNG without an IHDR chunk")
        return _two(">II", data, 16)
    if data[:2] == b"\xff\xd8":
        return _jpeg_size(data)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _webp_size(data)
    if data[:2] == b"BM":
        if len(data) < 26:
            return None
        width, height = _two("<ii", data, 18)
        return abs(width), abs(height)
    if not data:
        raise HeaderError("the file is empty")
    raise HeaderError("not a PNG, JPEG, WebP or BMP image")


def check_complete(data: bytes) -> None:
    """Raise HeaderError for a truncated PNG, JPEG or WebP file, of which decoders may fill the rest with grey."""
    if data[:8] == _PNG_MAGIC:
        at = 8
        while at + 12 <= len(data):
            (length,) = struct.unpack_from(">I", data, at)
            if data[at + 4 : at + 8] == b"IEND":
                return
            at += 12 + length
        raise HeaderError("the PNG is truncated or damaged: its IEND chunk is not found")
    if data[:2] == b"\xff\xd8":
        scan = _jpeg_scan_start(data)
        # Inside the scan FF is always followed by 00 or a restart marker, so FFD9 there is the true end.
        if scan is None or data.find(b"\xff\xd9", scan) < 0:
            raise HeaderError("the JPEG is truncated: it has no end marker")
        return
    if data[:4] == b"RIFF" and len(data) >= 8 and len(data) < struct.unpack_from("<I", data, 4)[0] + 8:
        raise HeaderError("the WebP file is truncated")


def _two(layout: str, data: bytes, at: int) -> tuple[int, int]:
    first, second = struct.unpack_from(layout, data, at)
    return int(first), int(second)


def _jpeg_segments(data: bytes) -> list[tuple[int, int]]:
    """(marker, offset of its length field) of the segments up to the first scan or the end of ``data``."""
    found: list[tuple[int, int]] = []
    at = 2
    while at + 4 <= len(data):
        if data[at] != 0xFF:
            raise HeaderError("the JPEG's segments are damaged")
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        if marker == 0x01 or 0xD0 <= marker <= 0xD8:  # markers without a length
            at += 2
            continue
        found.append((marker, at + 2))
        if marker in (0xDA, 0xD9):
            break
        at += 2 + int(struct.unpack_from(">H", data, at + 2)[0])
    return found


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    for marker, at in _jpeg_segments(data):
        if marker in _SOF:
            if at + 7 > len(data):
                return None
            height, width = _two(">HH", data, at + 3)
            return width, height
        if marker in (0xDA, 0xD9):
            raise HeaderError("the JPEG has no frame header")
    return None


def _jpeg_scan_start(data: bytes) -> int | None:
    return next((at for marker, at in _jpeg_segments(data) if marker == 0xDA), None)


def _webp_size(data: bytes) -> tuple[int, int] | None:
    if len(data) < 30:
        return None
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(data[21:25], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        width, height = _two("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    raise HeaderError("unknown kind of WebP file")
