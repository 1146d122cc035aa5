"""What containers and image files say of their pictures: spherical video (boxes, XML) and Google's photo sphere XMP."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, replace
from pathlib import Path

from panobench.layouts.cells import CUBE_3X2, Packing, Panorama
from panobench.layouts.layout import WHOLE, Layout
from panobench.layouts.names import HALF

#: FFmpeg's AVSphericalMapping: projection, yaw, pitch, roll (16.16), bounds (0.32), padding.
_PROJECTIONS = ("equirectangular", "cubemap", "tiles of an equirectangular panorama", "half equirectangular")
_OTHERS = {4: "rectilinear", 5: "fisheye", 6: "parametric immersive"}
_LEFT, _UPPER = (0.0, 0.0, 0.5, 1.0), (0.0, 0.0, 1.0, 0.5)
#: FFmpeg's AVStereo3D, first field.
_SIDE_BY_SIDE, _TOP_BOTTOM = 1, 2
#: Of a file's head and its end that is searched for XMP, and the largest list of boxes that is read.
_XMP_BYTES = 1 << 20
_MAX_MOOV = 64 << 20
#: Type of the box that has the XML of spherical video, version 1.
SPHERICAL_UUID = bytes.fromhex("ffcc8263f8554a938814587a02521fdd")


@dataclass(frozen=True)
class Said:
    """layout: what the metadata describe, None if they do not say. unreadable: a projection that is not read."""

    layout: Layout | None = None
    unreadable: str = ""


def from_side_data(data: dict[str, bytes]) -> Said:
    """From what FFmpeg has beside a frame: SPHERICAL (st3d, sv3d, XML, Matroska's projection) and STEREO3D."""
    sphere, stereo = data.get("SPHERICAL", b""), _stereo(data.get("STEREO3D", b""))
    if len(sphere) < 32:
        return Said()
    projection, yaw, pitch, roll = struct.unpack_from("=Iiii", sphere)
    edges = [v / 2**32 for v in struct.unpack_from("=4I", sphere, 16)]
    turned = (yaw / 65536, pitch / 65536, roll / 65536)
    if projection in _OTHERS or projection >= len(_PROJECTIONS):
        return Said(unreadable=_OTHERS.get(projection, f"number {projection}"))
    packing: Packing = Panorama()
    if projection == 1:
        packing = CUBE_3X2
    elif projection == 3:
        packing = HALF
    elif projection == 2 and edges[0] + edges[2] < 1 and edges[1] + edges[3] < 1:
        packing = Panorama((edges[0], edges[1], 1 - edges[2], 1 - edges[3]))
    return Said(_described("its metadata", packing, stereo, turned))


def from_xml(path: Path) -> Said:
    """From the spherical video XML (version 1) in a video's track: projection, crop, stereo."""
    return from_xml_text(_track_xml(path))


def from_xml_text(text: str) -> Said:
    """As ``from_xml``."""
    values = dict(re.findall(r"<GSpherical:(\w+)>\s*([^<]{0,64}?)\s*</GSpherical:\1>", text))
    if values.get("Spherical", "").lower() != "true":
        return Said()
    projection = values.get("ProjectionType", "equirectangular").lower()
    if projection != "equirectangular":
        return Said(unreadable=projection)
    eyes = {"top-bottom": _UPPER, "left-right": _LEFT}
    part = eyes.get(values.get("StereoMode", "").lower(), WHOLE)
    return Said(_described("its metadata", _cropped(values), part, (0.0, 0.0, 0.0)))


def from_photo_sphere(path: Path) -> Said:
    """From the XMP of an image: GPano's projection, crop and pose."""
    try:
        with path.open("rb") as file:
            head = file.read(_XMP_BYTES)
            file.seek(0, 2)
            file.seek(max(len(head), file.tell() - (_XMP_BYTES >> 2)))
            data = head + file.read(_XMP_BYTES >> 2)
    except OSError:
        return Said()
    return from_xmp(data)


def from_xmp(data: bytes) -> Said:
    """As ``from_photo_sphere``, from the file's bytes."""
    if b"GPano:" not in data:
        return Said()
    start = data.index(b"GPano:")
    text = data[max(0, start - 4096) : start + (64 << 10)].decode("latin-1")
    values = dict(re.findall(r"GPano:(\w+)\s*=\s*[\"']([^\"']{0,64})[\"']", text))
    values |= dict(re.findall(r"<GPano:(\w+)>\s*([^<]{0,64}?)\s*</GPano:\1>", text))
    projection = values.get("ProjectionType", "equirectangular").lower()
    if projection != "equirectangular":
        return Said(unreadable=projection)
    tilt = tuple(_number(values.get(f"Pose{name}Degrees"), 0.0) for name in ("Pitch", "Roll"))
    return Said(_described("its metadata", _cropped(values), WHOLE, (0.0, *tilt)))  # type: ignore[arg-type]


def _stereo(data: bytes) -> tuple[float, float, float, float]:
    kind = struct.unpack_from("=i", data)[0] if len(data) >= 4 else 0
    return {_SIDE_BY_SIDE: _LEFT, _TOP_BOTTOM: _UPPER}.get(kind, WHOLE)


def _cropped(values: dict[str, str]) -> Panorama:
    """The part of the sphere of CroppedArea..., FullPano...; the whole where they make no sense."""
    full = [_number(values.get(f"FullPano{side}Pixels"), 0.0) for side in ("Width", "Height")]
    area = [_number(values.get(f"CroppedAreaImage{side}Pixels"), 0.0) for side in ("Width", "Height")]
    corner = [_number(values.get(f"CroppedArea{side}Pixels"), 0.0) for side in ("Left", "Top")]
    if min(*full, *area) < 1 or min(corner) < 0:
        return Panorama()
    left, top = corner[0] / full[0], corner[1] / full[1]
    right, bottom = left + area[0] / full[0], top + area[1] / full[1]
    if right - left > 1 + 1e-3 or bottom > 1 + 1e-3 or left >= 1 or top >= 1:
        return Panorama()
    if right - left > 1 - 1e-3 and bottom - top > 1 - 1e-3:
        return Panorama()
    return Panorama((left, top, right, min(bottom, 1.0)))


def _number(text: str | None, otherwise: float) -> float:
    try:
        value = float(text) if text is not None else otherwise
    except ValueError:
        return otherwise
    return value if abs(value) < 1e9 else otherwise


def _described(
    where: str, packing: Packing, part: tuple[float, float, float, float], turned: tuple[float, float, float]
) -> Layout:
    """A layout from metadata, and in words what was made of it."""
    words, name = [], "erp"
    if part != WHOLE:
        name = "top-bottom" if part[3] == 0.5 else "left-right"
        words.append(f"two eyes, {'one above the other' if part[3] == 0.5 else 'side by side'}: the left one is used")
    if packing == CUBE_3X2:
        name = "cube-3x2"
        words.append("a cubemap")
    elif packing == HALF:
        name = "vr180" if part != WHOLE else "half"
        words.append("180 degrees of the sphere")
    elif packing != Panorama() and isinstance(packing, Panorama):
        left, top, right, bottom = packing.crop
        words.append(f"a part of the sphere, {360 * (right - left):.0f} by {180 * (bottom - top):.0f} degrees")
    turned = tuple(0.0 if abs(t) < 0.05 else t for t in turned)  # type: ignore[assignment]
    if any(turned):
        words.append("turned upright by yaw {:.1f}, pitch {:.1f}, roll {:.1f} degrees".format(*turned))
    remark = f"as {where} say: {'; '.join(words)}" if words else ""
    return replace(Layout(name, packing, part, turned), remark=remark)


def _track_xml(path: Path) -> str:
    """The XML in the first spherical UUID box of an MP4 or MOV file; "" if there is none."""
    try:
        with path.open("rb") as file:
            end = file.seek(0, 2)
            position = 0
            for _ in range(10_000):
                file.seek(position)
                head = file.read(16)
                if len(head) < 8:
                    return ""
                size, kind = struct.unpack(">I4s", head[:8])
                skip = 8
                if size == 1 and len(head) == 16:
                    size, skip = struct.unpack(">Q", head[8:])[0], 16
                size = end - position if size == 0 else size
                if size < skip:
                    return ""
                if kind == b"moov":
                    file.seek(position + skip)
                    return xml_of_moov(file.read(min(size - skip, _MAX_MOOV)))
                position += size
    except (OSError, ValueError, OverflowError):  # a position that no file has
        pass
    return ""


def xml_of_moov(moov: bytes) -> str:
    """The spherical XML among the boxes of a film's header; "" if there is none."""
    at = moov.find(b"uuid" + SPHERICAL_UUID)
    if at < 4:
        return ""
    size = struct.unpack(">I", moov[at - 4 : at])[0]
    return moov[at + 20 : at - 4 + min(size, _XMP_BYTES)].decode("utf-8", "replace")
