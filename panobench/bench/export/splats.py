"""The map in the formats of splat viewers: PLY with harmonics of degree 3, splat, SPZ and SOG.

Gaussians that are not finite, or have the quaternion zero, are left out.
"""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.bench.export.base import ExportOptions, map_of, opacities
from panobench.splat.ply import SH_C0, write_ply
from panobench.writing import write_whole

if TYPE_CHECKING:
    from panobench.api import Run
    from panobench.splat.gaussians import GaussianMap

Bytes = NDArray[np.uint8]


def _usable(run: Run) -> GaussianMap:
    gaussians = map_of(run)
    keep = np.abs(gaussians.quats).max(axis=1) > 0
    for values in gaussians.arrays():
        keep &= np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    return gaussians.select(keep)


def _unit_quats(gaussians: GaussianMap) -> NDArray[np.float64]:
    q = gaussians.quats.astype(np.float64)
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def _bytes(values: NDArray[Any]) -> Bytes:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def ply_sh3(run: Run, target: Path, options: ExportOptions) -> None:
    """As map.ply, with the 45 coefficients of degree 1 to 3 that viewers of the first generation insist on."""
    gaussians = _usable(run)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_ply(target, *gaussians.arrays(), harmonics=45)


def splat(run: Run, target: Path, options: ExportOptions) -> None:
    """32 bytes per Gaussian: position and scale (float32), RGBA, and the quaternion (w, x, y, z) as q 128 + 128.

    The largest and most opaque come first, for viewers that draw while they load.
    """
    gaussians = _usable(run)
    alpha = opacities(gaussians)
    scales = np.exp(gaussians.log_scales.astype(np.float64))
    row = np.zeros(
        len(gaussians), dtype=[("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)]
    )
    row["mean"], row["scale"] = gaussians.means, scales
    row["rgba"][:, :3], row["rgba"][:, 3] = _bytes(255.0 * gaussians.colours), _bytes(255.0 * alpha)
    row["quat"] = _bytes(128.0 * _unit_quats(gaussians) + 128.0)
    order = np.argsort(-scales.prod(axis=1) * alpha, kind="stable")
    write_whole(target, row[order].tobytes())


def spz(run: Run, target: Path, options: ExportOptions) -> None:
    """SPZ version 3 (Niantic): a header, then all positions, opacities, colours, scales and rotations, compressed.

    Positions are 24-bit fixed point, as fine as the farthest one allows; axes are right, up, back. Rotations are the
    three smaller components, sign and 9 bits each, after the number of the largest.
    """
    gaussians = _usable(run)
    means = gaussians.means.astype(np.float64) * [1.0, -1.0, -1.0]
    largest = float(np.abs(means).max())
    fraction = int(np.clip(np.floor(np.log2((2**23 - 1) / max(largest, 1e-6))), 0, 20))
    fixed = np.clip(np.rint(means * 2.0**fraction), -(2**23), 2**23 - 1).astype("<i4")
    positions = fixed.view(np.uint8).reshape(-1, 3, 4)[:, :, :3]
    quats = _unit_quats(gaussians) * [1.0, 1.0, -1.0, -1.0]  # half a turn about x changes the axes of y and z
    harmonics = (gaussians.colours.astype(np.float64) - 0.5) / SH_C0
    parts = [
        struct.pack("<IIIBBBB", 0x5053474E, 3, len(gaussians), 0, fraction, 0, 0),
        positions.tobytes(),
        _bytes(255.0 * opacities(gaussians)).tobytes(),
        _bytes((0.15 * harmonics + 0.5) * 255.0).tobytes(),
        _bytes((gaussians.log_scales.astype(np.float64) + 10.0) * 16.0).tobytes(),
        _packed_quats(quats[:, [1, 2, 3, 0]]).tobytes(),
    ]
    write_whole(target, gzip.compress(b"".join(parts), 9, mtime=0))


def sog(run: Run, target: Path, options: ExportOptions) -> None:
    """SOG version 2 (PlayCanvas): a zip of meta.json and lossless pictures with a pixel per Gaussian.

    Positions have 16 bits in a logarithmic scale, rotations the three smaller components, scales and colours an index
    into 256 values.
    """
    gaussians = _usable(run)
    gaussians = gaussians.select(_morton_order(gaussians.means))
    count = len(gaussians)
    width = 4 * -(-int(np.ceil(np.sqrt(count))) // 4)
    height = 4 * -(-count // (4 * width))

    means = gaussians.means.astype(np.float64)
    means = np.sign(means) * np.log1p(np.abs(means))
    low, high = means.min(axis=0), means.max(axis=0)
    levels = np.rint((means - low) / np.maximum(high - low, 1e-12) * 65535.0).astype(np.uint16)
    scales, scale_values = _indexed(gaussians.log_scales)
    colours, colour_values = _indexed((gaussians.colours.astype(np.float64) - 0.5) / SH_C0)
    alpha = _bytes(255.0 * opacities(gaussians))[:, None]
    pictures = {
        "means_l": (levels & 255).astype(np.uint8),
        "means_u": (levels >> 8).astype(np.uint8),
        "scales": scales,
        "quats": _smallest_three(_unit_quats(gaussians)),
        "sh0": np.concatenate([colours, alpha], axis=1),
    }
    meta = {
        "version": 2,
        "asset": {"generator": "panobench"},
        "count": count,
        "antialias": False,
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": scale_values, "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
        "sh0": {"codebook": colour_values, "files": ["sh0.webp"]},
    }
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as archive:  # pictures are compressed already
        for name, values in pictures.items():
            archive.writestr(zipfile.ZipInfo(f"{name}.webp"), _webp(values, width, height))
        archive.writestr(zipfile.ZipInfo("meta.json"), json.dumps(meta))
    write_whole(target, content.getvalue())


def _webp(values: Bytes, width: int, height: int) -> bytes:
    """(N, 3 or 4) bytes as the first pixels of a lossless picture, transparent ones included."""
    from PIL import Image

    pixels = np.zeros((width * height, 4), np.uint8)
    pixels[:, 3] = 255
    pixels[: len(values), : values.shape[1]] = values
    content = io.BytesIO()
    Image.fromarray(pixels.reshape(height, width, 4)).save(content, "WEBP", lossless=True, exact=True, quality=100)
    return content.getvalue()


def _indexed(values: NDArray[Any]) -> tuple[Bytes, list[float]]:
    """Indices (N, 3) into at most 256 sorted values that lie as the data do: k-means in one dimension."""
    flat = np.sort(np.asarray(values, np.float64).ravel())
    # half of them where the data are dense, half evenly over their range, for what is rare
    dense = flat[np.linspace(0, len(flat) - 1, 128).round().astype(int)]
    book = np.unique(np.concatenate([dense, np.linspace(flat[0], flat[-1], 128)]))
    total = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(5):
        ends = np.concatenate([[0], np.searchsorted(flat, 0.5 * (book[1:] + book[:-1])), [len(flat)]])
        used = np.diff(ends) > 0
        book = (np.diff(total[ends]) / np.maximum(np.diff(ends), 1))[used]
    index = np.searchsorted(0.5 * (book[1:] + book[:-1]), values)
    padded = np.concatenate([book, np.full(256 - len(book), book[-1])])
    return index.astype(np.uint8), [float(v) for v in padded]


def _packed_quats(quats: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Unit quaternions (N, 4) as (x, y, z, w) in 32 bits each, as SPZ packs them."""
    small, largest = _without_largest(quats)
    magnitude = np.rint(511.0 * np.abs(small) * np.sqrt(2.0)).astype(np.uint32)
    code = largest.astype(np.uint32)
    for k in range(3):
        code = (code << np.uint32(10)) | ((small[:, k] < 0).astype(np.uint32) << np.uint32(9)) | magnitude[:, k]
    return code.astype("<u4")


def _without_largest(quats: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Unit quaternions (N, 4) -> the other components (N, 3) once the largest is positive, and its index (N,)."""
    largest = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, largest] < 0, -1.0, 1.0)[:, None]
    others = np.array([[k for k in range(4) if k != out] for out in range(4)])[largest]
    return quats[rows[:, None], others], largest


def _smallest_three(quats: NDArray[np.float64]) -> Bytes:
    """Unit quaternions (N, 4) as SOG has them: three components, times sqrt 2, and 252 + the index of the largest."""
    small, largest = _without_largest(quats)
    return _bytes(
        np.concatenate(
            [(0.5 * np.sqrt(2.0) * small + 0.5) * 255.0, 252.0 + largest[:, None].astype(np.float64)], axis=1
        )
    )


def _morton_order(points: NDArray[np.float32]) -> NDArray[np.intp]:
    """Neighbours in space become neighbours in the pictures, which compresses better."""
    low, high = points.min(axis=0), points.max(axis=0)
    cells = ((points - low) / np.maximum(high - low, 1e-12) * 1023).astype(np.uint32)
    code = np.zeros(len(points), np.uint32)
    for bit in range(10):
        for axis in range(3):
            code |= ((cells[:, axis] >> np.uint32(bit)) & np.uint32(1)) << np.uint32(3 * bit + axis)
    return np.argsort(code, kind="stable")
