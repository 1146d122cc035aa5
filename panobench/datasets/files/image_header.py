"""Width, height and completeness of an image file, from its bytes, before it is decoded.

Sources: PNG specification (W3C 2003), sections 5 and 11; JPEG, ITU-T T.81 annex B; WebP container
(RFC 9649), section 2; Windows bitmap headers; TIFF 6.0, section 2; netpbm's ppm(5) and pgm(5).
"""

from __future__ import annotations

import re
import struct

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
#: JPEG start-of-frame markers (C4, C8 and CC in that range are other segments).
_SOF = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_TIFF_MAGICS = (b"II*\0", b"MM\0*")
_NETPBM = re.compile(rb"P[2356]\s")
#: Bytes that are read first to find the size; cameras write large EXIF blocks before it.
HEAD_BYTES = 1 << 16


class HeaderError(ValueError):
    """The bytes are not an image that this package reads, or they end too early."""


def image_size(data: bytes) -> tuple[int, int] | None:
    """(width, height) from the first bytes of a file; None if the header reaches beyond ``data``.

    Raises HeaderError for a format other than PNG, JPEG, WebP, TIFF, BMP, PGM or PPM.
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
    if data[:4] in _TIFF_MAGICS:
        return _tiff_size(data)
    if _NETPBM.match(data):
        return _netpbm_size(data)
    if not data:
        raise HeaderError("the file is empty")
    raise HeaderError("not a PNG, JPEG, WebP, TIFF, BMP, PGM or PPM image")


def check_complete(data: bytes) -> None:
    """Raise HeaderError for a truncated PNG, JPEG, WebP or TIFF file, of which decoders may fill the rest with grey."""
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
    if data[:4] in _TIFF_MAGICS and _tiff_end(data) > len(data):
        raise HeaderError("the TIFF is truncated")
    if data[:4] == b"RIFF" and len(data) >= 8 and len(data) < struct.unpack_from("<I", data, 4)[0] + 8:
        raise HeaderError("the WebP file is truncated")


def _two(layout: str, data: bytes, at: int) -> tuple[int, int]:
    first, second = struct.unpack_from(layout, data, at)
    return int(first), int(second)


def _tiff_tags(data: bytes) -> dict[int, tuple[int, int, int]] | None:
    """Tag -> (type, count, offset of its value or of what points to it) of the first picture; None if it lies beyond
    ``data``.
    """
    order = "<" if data[:2] == b"II" else ">"
    if len(data) < 8:
        return None
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    if at + 2 > len(data):
        return None
    (count,) = struct.unpack_from(f"{order}H", data, at)
    if at + 2 + 12 * count > len(data):
        return None
    entries = [struct.unpack_from(f"{order}HHI", data, at + 2 + 12 * k) for k in range(count)]
    return {tag: (kind, number, at + 10 + 12 * k) for k, (tag, kind, number) in enumerate(entries)}


def _tiff_values(data: bytes, tags: dict[int, tuple[int, int, int]], tag: int) -> tuple[int, ...]:
    """Whole numbers of a tag; () where it has none, or they lie beyond ``data``."""
    kind, count, at = tags.get(tag, (0, 0, 0))
    order, code = "<" if data[:2] == b"II" else ">", {3: "H", 4: "I"}.get(kind)
    if code is None:
        return ()
    size = count * struct.calcsize(code)
    if size > 4:
        (at,) = struct.unpack_from(f"{order}I", data, at)
    return struct.unpack_from(f"{order}{count}{code}", data, at) if at + size <= len(data) else ()


def _tiff_size(data: bytes) -> tuple[int, int] | None:
    tags = _tiff_tags(data)
    if tags is None:
        return None
    width, height = _tiff_values(data, tags, 256), _tiff_values(data, tags, 257)
    if not width or not height:
        raise HeaderError("the TIFF does not say its width and height")
    return width[0], height[0]


def _tiff_end(data: bytes) -> int:
    """Where the last strip or tile of the first picture ends; beyond the file where that cannot be told."""
    tags = _tiff_tags(data)
    if tags is None:
        return len(data) + 1
    starts = _tiff_values(data, tags, 273) or _tiff_values(data, tags, 324)
    sizes = _tiff_values(data, tags, 279) or _tiff_values(data, tags, 325)
    if not starts or len(starts) != len(sizes):
        return len(data) + 1
    return max(start + size for start, size in zip(starts, sizes))


def _netpbm_size(data: bytes) -> tuple[int, int] | None:
    """Comments may stand before each number."""
    numbers: list[int] = []
    for line in data[2:4096].split(b"\n"):
        for word in line.partition(b"#")[0].split():
            if not word.isdigit() or len(word) > 9:
                raise HeaderError("the PGM or PPM does not say its width and height")
            numbers.append(int(word))
            if len(numbers) == 2:
                return numbers[0], numbers[1]
    raise HeaderError("the PGM or PPM does not say its width and height")


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
