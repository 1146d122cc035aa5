"""Splats read back from the formats of viewers, by readers written from the formats' descriptions."""

from __future__ import annotations

import gzip
import io
import json
import struct
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from PIL import Image
from plyfile import PlyData

from panobench.bench.export import FORMATS, ExportOptions
from panobench.splat.gaussians import GaussianMap
from panobench.splat.ply import SH_C0, read_ply


@pytest.fixture
def gaussians() -> GaussianMap:
    rng = np.random.default_rng(3)
    n = 500
    means = rng.normal(0, 3, (n, 3))
    means[0] = [80.0, -40.0, 200.0]  # of a far shell
    scales = np.log(rng.uniform(0.005, 0.3, (n, 3)))
    return GaussianMap(
        means.astype(np.float32),
        scales.astype(np.float32),
        rng.normal(0, 2, (n, 4)).astype(np.float32),
        rng.normal(1, 2, n).astype(np.float32),
        rng.uniform(0, 1, (n, 3)).astype(np.float32),
    )


def write(gaussians: GaussianMap, to: str, target: Path) -> Path:
    run: Any = SimpleNamespace(map=gaussians, folder=Path("run"))
    FORMATS[to].write(run, target, ExportOptions())
    return target


def compare(
    found: GaussianMap, expected: GaussianMap, *, position: float, scale: float, degrees: float, colour: float
) -> None:
    """Gaussians in any order are the same within these tolerances."""
    nearest = np.linalg.norm(found.means[:, None] - expected.means[None], axis=2).argmin(axis=0)
    assert len(np.unique(nearest)) == len(expected) == len(found)
    found = found.select(nearest)
    assert np.abs(found.means - expected.means)[1:].max() <= position
    assert np.abs(found.log_scales - expected.log_scales).max() <= scale
    a, b = (m.quats / np.linalg.norm(m.quats, axis=1, keepdims=True) for m in (found, expected))
    angle = 2 * np.arccos(np.clip(np.abs((a * b).sum(axis=1)), 0, 1))
    assert np.rad2deg(angle).max() <= degrees
    assert np.abs(found.colours - expected.colours).max() <= colour
    alpha = [1 / (1 + np.exp(-m.opacity_logits)) for m in (found, expected)]
    assert np.abs(alpha[0] - alpha[1]).max() <= 0.5 / 255 + 1e-6


def logit(alpha: np.ndarray) -> np.ndarray:
    alpha = np.clip(alpha, 1e-6, 1 - 1e-6)
    return np.log(alpha / (1 - alpha)).astype(np.float32)


def test_harmonics_of_degree_3_are_zero_and_the_rest_is_the_map(gaussians: GaussianMap, tmp_path: Path) -> None:
    path = write(gaussians, "ply-sh3", tmp_path / "a.ply")
    vertex = PlyData.read(path)["vertex"]
    names = [p.name for p in vertex.properties]
    assert names[9:54] == [f"f_rest_{k}" for k in range(45)], "where the first viewers look for them"
    assert not any(vertex[name].any() for name in names[9:54])
    for a, b in zip(GaussianMap(*read_ply(path)).arrays(), gaussians.arrays()):
        assert np.abs(a - b).max() < 1e-6


def test_splat_reads_back(gaussians: GaussianMap, tmp_path: Path) -> None:
    data = write(gaussians, "splat", tmp_path / "a.splat").read_bytes()
    assert len(data) == 32 * len(gaussians)
    rows = np.frombuffer(data, np.dtype([("f", "<f4", 6), ("rgba", "u1", 4), ("q", "u1", 4)]))
    found = GaussianMap(
        rows["f"][:, :3],
        np.log(rows["f"][:, 3:]),
        (rows["q"].astype(np.float32) - 128) / 128,
        logit(rows["rgba"][:, 3] / 255),
        rows["rgba"][:, :3] / np.float32(255),
    )
    compare(found, gaussians, position=0, scale=1e-5, degrees=2.0, colour=0.5 / 255 + 1e-6)
    size = np.exp(found.log_scales.sum(axis=1)) / (1 + np.exp(-found.opacity_logits))
    assert size[:50].mean() > size[-50:].mean(), "the large ones come first"


def test_spz_reads_back(gaussians: GaussianMap, tmp_path: Path) -> None:
    data = gzip.decompress(write(gaussians, "spz", tmp_path / "a.spz").read_bytes())
    magic, version, n, degree, fraction, _, _ = struct.unpack("<IIIBBBB", data[:16])
    assert (magic, version, n, degree) == (0x5053474E, 3, len(gaussians), 0)
    body = np.frombuffer(data[16:], np.uint8)
    assert len(body) == n * (9 + 1 + 3 + 3 + 4)
    xyz, alpha, colour, scale, packed = np.split(body, np.cumsum([9 * n, n, 3 * n, 3 * n]))
    levels = xyz.reshape(n, 3, 3).astype(np.int32) @ np.array([1, 256, 65536])
    means = np.where(levels >= 2**23, levels - 2**24, levels) / 2.0**fraction * [1, -1, -1]
    quats = np.zeros((n, 4))  # (x, y, z, w)
    for row, code in zip(quats, packed.view("<u4").astype(np.int64)):
        largest, rest = int(code >> 30), [(int(code) >> shift) & 1023 for shift in (20, 10, 0)]
        others = [k for k in range(4) if k != largest]
        row[others] = [(-1 if c & 512 else 1) * (c & 511) / 511 * np.sqrt(0.5) for c in rest]
        row[largest] = np.sqrt(max(0.0, 1 - (row**2).sum()))
    found = GaussianMap(
        means.astype(np.float32),
        (scale.reshape(n, 3) / 16.0 - 10).astype(np.float32),
        (quats[:, [3, 0, 1, 2]] * [1, 1, -1, -1]).astype(np.float32),
        logit(alpha / 255),
        (0.5 + SH_C0 * (colour.reshape(n, 3) / 255 - 0.5) / 0.15).astype(np.float32),
    )
    compare(found, gaussians, position=2e-5, scale=0.5 / 16 + 1e-5, degrees=0.3, colour=SH_C0 / 0.15 * 0.51 / 255)


def test_sog_reads_back(gaussians: GaussianMap, tmp_path: Path) -> None:
    with zipfile.ZipFile(write(gaussians, "sog", tmp_path / "a.sog")) as archive:
        meta = json.loads(archive.read("meta.json"))
        pixels = {
            name.removesuffix(".webp"): np.array(Image.open(io.BytesIO(archive.read(name))).convert("RGBA"))
            for name in archive.namelist()
            if name.endswith(".webp")
        }
    n = meta["count"]
    assert (meta["version"], n) == (2, len(gaussians))
    flat = {name: p.reshape(-1, 4)[:n].astype(np.float64) for name, p in pixels.items()}
    levels = (flat["means_l"] + 256 * flat["means_u"])[:, :3] / 65535
    low, high = np.array(meta["means"]["mins"]), np.array(meta["means"]["maxs"])
    logs = low + levels * (high - low)
    quats = np.zeros((n, 4))  # (w, x, y, z)
    for row, (a, b, c, tag) in zip(quats, flat["quats"]):
        largest = int(tag) - 252
        row[[k for k in range(4) if k != largest]] = (np.array([a, b, c]) / 255 - 0.5) * np.sqrt(2)
        row[largest] = np.sqrt(max(0.0, 1 - (row**2).sum()))
    scales = np.array(meta["scales"]["codebook"])[flat["scales"][:, :3].astype(int)]
    colours = 0.5 + SH_C0 * np.array(meta["sh0"]["codebook"])[flat["sh0"][:, :3].astype(int)]
    found = GaussianMap(
        (np.sign(logs) * np.expm1(np.abs(logs))).astype(np.float32),
        scales.astype(np.float32),
        quats.astype(np.float32),
        logit(flat["sh0"][:, 3] / 255),
        colours.astype(np.float32),
    )
    compare(found, gaussians, position=0.003, scale=0.08, degrees=1.0, colour=0.01)


def test_what_cannot_be_drawn_is_left_out(gaussians: GaussianMap, tmp_path: Path) -> None:
    gaussians.means[3] = np.nan
    gaussians.quats[4] = 0
    data = write(gaussians, "splat", tmp_path / "a.splat").read_bytes()
    assert len(data) == 32 * (len(gaussians) - 2)
