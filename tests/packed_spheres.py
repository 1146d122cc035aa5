"""Pictures of one little world in every layout, and the metadata that say so."""

from __future__ import annotations

import struct
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import av
import cv2
import numpy as np

SIZE = (512, 256)


@lru_cache(maxsize=8)
def world(turn: int = 0, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A panorama (H, W, 3) of blobs of colour: smooth over the seam and the poles, and different everywhere."""
    rng = np.random.default_rng(5)
    centres = rng.normal(size=(90, 3))
    centres /= np.linalg.norm(centres, axis=1, keepdims=True)
    colours = rng.uniform(0, 255, (90, 3))
    width, height = size
    lon = (np.arange(width) + 0.5) / width * 2 * np.pi - np.pi + np.deg2rad(turn)
    lat = np.pi / 2 - (np.arange(height) + 0.5) / height * np.pi
    lon, lat = np.meshgrid(lon, lat)
    d = np.stack([np.cos(lat) * np.sin(lon), -np.sin(lat), np.cos(lat) * np.cos(lon)], axis=-1)
    weight = np.exp(40 * (d @ centres.T - 1))
    image = (weight @ colours) / weight.sum(axis=-1, keepdims=True)
    image += 35 * np.sin(13 * d @ centres[:3].T)
    return np.clip(image, 0, 255).round().astype(np.uint8)


def projected(arguments: str, width: int, height: int, image: np.ndarray | None = None) -> np.ndarray:
    """The world, or another picture, through FFmpeg's v360."""
    picture = world() if image is None else image
    graph = av.filter.Graph()
    source = graph.add_buffer(width=picture.shape[1], height=picture.shape[0], format="rgb24", time_base="1/30")
    view = ("v360", f"{arguments}:w={width}:h={height}")
    steps = (("format", "gbrp"), view, ("format", "rgb24"), ("buffersink", None))
    chain = [source, *(graph.add(*step) for step in steps)]
    for one, next_one in pairwise(chain):
        one.link_to(next_one)
    graph.configure()
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
    frame.pts = 0
    source.push(frame)
    source.push(None)
    return np.asarray(chain[-1].pull().to_ndarray())


def shifted(image: np.ndarray, pixels: int = 2) -> np.ndarray:
    """What the other eye sees."""
    return np.roll(image, pixels, axis=1)


def half_panorama(image: np.ndarray) -> np.ndarray:
    """180 degrees of a panorama."""
    w = image.shape[1]
    return image[:, w // 4 : 3 * w // 4]


def resized(image: np.ndarray, width: int, height: int) -> np.ndarray:
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA))


def barred(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """An image in the middle of a black picture."""
    h, w = image.shape[:2]
    out = np.zeros((height, width, 3), np.uint8)
    top, left = (height - h) // 2, (width - w) // 2
    out[top : top + h, left : left + w] = image
    return out


# -- boxes of MP4 files ------------------------------------------------------------------------------------------------


def box(kind: bytes, *content: bytes) -> bytes:
    data = b"".join(content)
    return struct.pack(">I4s", len(data) + 8, kind) + data


def with_boxes(path: Path, entry: bytes = b"", track: bytes = b"") -> Path:
    """A video with boxes added to its sample entry (avc1) and to its track, whose header comes after the pictures."""
    data = path.read_bytes()
    inner = [(b"avc1", entry)] if entry else []
    inner += [(b"trak", track)] if track else []
    for kind, extra in inner:
        at = data.index(b"moov")
        while True:  # the first box of that kind within the header
            at = data.index(kind, at + 1)
            size = struct.unpack(">I", data[at - 4 : at])[0]
            if 8 < size < len(data):
                break
        end = at - 4 + size
        data = data[:end] + extra + data[end:]
        parents = [b"moov", b"trak"]
        parents += [b"mdia", b"minf", b"stbl", b"stsd", b"avc1"] if kind == b"avc1" else []
        for parent in parents:
            where = data.index(parent, data.index(b"moov"))
            grown = struct.unpack(">I", data[where - 4 : where])[0] + len(extra)
            data = data[: where - 4] + struct.pack(">I", grown) + data[where:]
    path.write_bytes(data)
    return path


def spherical_boxes(
    *, stereo: int | None = None, projection: bytes | None = None, turned: tuple[float, float, float] = (0, 0, 0)
) -> bytes:
    """st3d and sv3d (Spherical Video V2). projection: the box; default: the whole equirectangular panorama."""
    full = b"\0\0\0\0"
    whole = box(b"equi", full, struct.pack(">4I", 0, 0, 0, 0)) if projection is None else projection
    pose = box(b"prhd", full, struct.pack(">3i", *(round(t * 65536) for t in turned)))
    sphere = box(b"sv3d", box(b"svhd", full, b"panobench\0"), box(b"proj", pose, whole))
    return (box(b"st3d", full, bytes([stereo])) if stereo is not None else b"") + sphere


def spherical_xml(**values: object) -> bytes:
    """The uuid box of Spherical Video V1."""
    fields = {"Spherical": "true", "Stitched": "true", "ProjectionType": "equirectangular", **values}
    text = "".join(f"<GSpherical:{k}>{v}</GSpherical:{k}>" for k, v in fields.items())
    xml = f'<?xml version="1.0"?><rdf:SphericalVideo xmlns:GSpherical="http://x">{text}</rdf:SphericalVideo>'
    return box(b"uuid", bytes.fromhex("ffcc8263f8554a938814587a02521fdd"), xml.encode())


def photo_sphere(jpeg: bytes, **values: object) -> bytes:
    """A JPEG with GPano's XMP."""
    text = " ".join(f'GPano:{k}="{v}"' for k, v in values.items())
    xmp = b"http://ns.adobe.com/xap/1.0/\0" + f"<x:xmpmeta><rdf:Description {text}/></x:xmpmeta>".encode()
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(xmp) + 2) + xmp + jpeg[2:]
