"""What files say of how their pictures hold the sphere: photo sphere XMP, spherical video's XML and boxes."""

from __future__ import annotations

import struct
from pathlib import Path

from mutate import Material
from target import Target, plain, text

_XMP = (
    '<x:xmpmeta><rdf:Description GPano:ProjectionType="equirectangular" GPano:FullPanoWidthPixels="4000" '
    'GPano:FullPanoHeightPixels="2000" GPano:CroppedAreaImageWidthPixels="3000" '
    'GPano:CroppedAreaImageHeightPixels="1000" GPano:CroppedAreaLeftPixels="500" GPano:CroppedAreaTopPixels="500" '
    'GPano:PosePitchDegrees="3.5" GPano:PoseRollDegrees="-2"/></x:xmpmeta>'
)
_XML = (
    "<rdf:SphericalVideo><GSpherical:Spherical>true</GSpherical:Spherical>"
    "<GSpherical:ProjectionType>equirectangular</GSpherical:ProjectionType>"
    "<GSpherical:StereoMode>top-bottom</GSpherical:StereoMode>"
    "<GSpherical:FullPanoWidthPixels>4000</GSpherical:FullPanoWidthPixels>"
    "<GSpherical:FullPanoHeightPixels>2000</GSpherical:FullPanoHeightPixels>"
    "<GSpherical:CroppedAreaImageWidthPixels>3000</GSpherical:CroppedAreaImageWidthPixels>"
    "<GSpherical:CroppedAreaImageHeightPixels>1000</GSpherical:CroppedAreaImageHeightPixels>"
    "<GSpherical:CroppedAreaLeftPixels>9</GSpherical:CroppedAreaLeftPixels></rdf:SphericalVideo>"
)
_SIZE = (64, 32)


def _moov() -> Material:
    from panobench.layouts.metadata import SPHERICAL_UUID

    xml = _XML.encode()
    box = struct.pack(">I4s", 24 + len(xml), b"uuid") + SPHERICAL_UUID + xml
    moov = struct.pack(">I4s", 8 + len(box), b"moov") + box
    large = struct.pack(">I4sQ", 1, b"moov", 16 + len(box)) + box
    head = struct.pack(">I4s8s", 16, b"ftyp", b"isommp42")
    return Material((head + moov, head + large), (b"uuid", b"moov", b"\0\0\0\1", b"\xff\xff\xff\xff"))


def _side_data() -> Material:
    sphere = [
        struct.pack("=4i5I", kind, 30 << 16, -10 << 16, 5 << 16, 1 << 30, 0, 1 << 29, 0, 2) for kind in (0, 1, 2, 3)
    ]
    return Material(tuple(s + struct.pack("=3i", eyes, 0, 0) for s in sphere for eyes in (0, 1, 2)), ())


def _used(found: object) -> None:
    """Whatever metadata describe has to be usable: places in the picture, the panorama's size.

    Raises DatasetError where they describe nothing that is read.
    """
    from panobench.errors import DatasetError
    from panobench.layouts.metadata import Said

    assert isinstance(found, Said)
    if found.layout is None:  # a recording without metadata is looked at instead
        raise DatasetError(found.unreadable or "they say nothing")
    layout = found.layout.fitted(_SIZE)
    width, height = layout.panorama_size(*_SIZE)
    assert 0 < width == 2 * height <= 1 << 14
    assert layout.seen((32, 16)).shape == (16, 32)


def _parse_xmp(path: Path) -> None:
    from panobench.layouts.metadata import from_photo_sphere

    _used(from_photo_sphere(path))


def _parse_xml(path: Path) -> None:
    from panobench.layouts.metadata import from_xml, from_xml_text

    data = path.read_bytes()
    _used(from_xml_text(data.decode("utf-8", "replace")) if data[:1] == b"<" else from_xml(path))


def _parse_side_data(path: Path) -> None:
    from panobench.layouts.metadata import from_side_data

    data = path.read_bytes()
    _used(from_side_data({"SPHERICAL": data[:-12], "STEREO3D": data[-12:]}))


TARGETS = (
    Target("photo-sphere", "a.jpg", text(_XMP, words="GPano: cylindrical nan -1 1e9 0"), plain(_parse_xmp)),
    Target("spherical-xml", "a.xml", text(_XML, words="cubemap mesh false left-right 0 -1 1e9 nan"), plain(_parse_xml)),
    Target("spherical-boxes", "a.mp4", _moov, plain(_parse_xml)),
    Target("spherical-side-data", "a.bin", _side_data, plain(_parse_side_data)),
)
