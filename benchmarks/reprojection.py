"""Frames per second of reprojection, beside py360convert and pyequilib where they are installed.

    python benchmarks/reprojection.py [--repeats 30] [--threads 2] [--out reports/speed/reprojection.md]

Prints one table, and writes it as Markdown. Maps are computed once per camera pair, as in a conversion, and not
counted; their cost stands in its own column. Every other library gets the same images and views, and is given the same
chance to prepare.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import itertools
import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from panobench.bench.records.provenance import available_cores, commit, cpu_model
from panobench.bench.records.tables import text_table
from panobench.cameras.calibration import builtin_calibration
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.cameras.reproject import Reprojector
from panobench.cameras.views import look_rotation, upright_rotation
from panobench.writing import write_whole

VIEW_LON_DEG, VIEW_LAT_DEG = 30.0, 10.0


@dataclass
class Row:
    what: str
    library: str
    ms: float
    prepare_ms: float = float("nan")
    psnr_db: float = float("nan")

    def cells(self) -> list[str]:
        numbers = (1000 / self.ms, self.ms, self.prepare_ms, self.psnr_db)
        texts = [f"{n:.{d}f}" if np.isfinite(n) else "-" for n, d in zip(numbers, (1, 2, 1, 1))]
        return [self.what, self.library, *texts]


def measure(run: Callable[[], Any], repeats: int) -> float:
    """Median milliseconds of one call, after two to warm up."""
    times = []
    for _ in range(repeats + 2):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return float(np.median(times[2:])) * 1e3


def test_panorama(width: int) -> np.ndarray:
    """A smooth coloured panorama with detail near, but below, what the pixels can show."""
    lon = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    lat = np.pi / 2 - (np.arange(width // 2) + 0.5) / (width // 2) * np.pi
    x, y, z = np.cos(lat)[:, None] * np.sin(lon), np.sin(lat)[:, None] + 0 * lon, np.cos(lat)[:, None] * np.cos(lon)
    waves = [np.sin(40 * x + 3 * y) * np.cos(31 * z), np.sin(37 * y) * np.cos(29 * x), np.sin(43 * z + 23 * x)]
    return (127.5 + 120 * np.stack(waves, axis=-1)).astype(np.uint8)


def true_view(camera: PinholeCamera, R_target_source: np.ndarray) -> np.ndarray:
    """The same function seen directly, without a panorama in between."""
    x, down, z = np.moveaxis(camera.rays() @ R_target_source, -1, 0)
    y = -down
    waves = [np.sin(40 * x + 3 * y) * np.cos(31 * z), np.sin(37 * y) * np.cos(29 * x), np.sin(43 * z + 23 * x)]
    return 127.5 + 120 * np.stack(waves, axis=-1)


def psnr(image: np.ndarray, truth: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.mean((image.astype(np.float64) - truth) ** 2)))


def samples(reprojector: Reprojector) -> str:
    count = reprojector.sampling.grid**2
    return f"{count} sample{'s' * (count > 1)}/px"


def pal_to_erp(repeats: int) -> list[Row]:
    source, target = builtin_calibration("palvio_up"), ErpCamera(1024, 512)
    rng = np.random.default_rng(0)
    rows = []
    for antialias in (True, False):
        start = time.perf_counter()
        reprojector = Reprojector(source, target, upright_rotation(source), antialias)
        prepare = (time.perf_counter() - start) * 1e3
        for name, shape in (("RGB", (960, 1280, 3)), ("mono", (960, 1280))):
            image = rng.integers(0, 256, shape, dtype=np.uint8)
            ms = measure(partial(reprojector.image, image), repeats)
            rows.append(Row(f"PAL 1280x960 {name} -> ERP 1024x512", f"panobench, {samples(reprojector)}", ms, prepare))
    return rows


def erp_to_view(width: int, view_width: int, repeats: int) -> list[Row]:
    image = test_panorama(width)
    camera = PinholeCamera.from_fov(view_width, 90, 90)
    R = look_rotation(VIEW_LON_DEG, VIEW_LAT_DEG)
    truth = true_view(camera, R)
    what = f"ERP {width}x{width // 2} -> 90x90 deg {view_width}x{view_width}"
    rows = []
    for antialias in (True, False):
        start = time.perf_counter()
        reprojector = Reprojector(ErpCamera(width, width // 2), camera, R, antialias)
        prepare = (time.perf_counter() - start) * 1e3
        ms = measure(partial(reprojector.image, image), repeats)
        how = f"panobench, {samples(reprojector)}"
        rows.append(Row(what, how, ms, prepare, psnr(reprojector.image(image), truth)))
        if reprojector.sampling.grid == 1:
            break
    for make in (_py360convert, _equilib):
        rows.extend(make(what, image, view_width, truth, max(3, repeats // 3)))
    return rows


def _py360convert(what: str, image: np.ndarray, size: int, truth: np.ndarray, repeats: int) -> list[Row]:
    try:
        import py360convert
    except ImportError:
        return []

    def run() -> np.ndarray:
        return py360convert.e2p(image, (90, 90), VIEW_LON_DEG, VIEW_LAT_DEG, (size, size), mode="bilinear")

    return [Row(what, "py360convert", measure(run, repeats), psnr_db=psnr(run(), truth))]


def _equilib(what: str, image: np.ndarray, size: int, truth: np.ndarray, repeats: int) -> list[Row]:
    try:
        from equilib import Equi2Pers
    except ImportError:
        return []
    import torch

    convert = Equi2Pers(height=size, width=size, fov_x=90.0, mode="bilinear")
    planes = np.ascontiguousarray(image.transpose(2, 0, 1))
    rows = []
    for backend, given in (("numpy", planes), ("torch", torch.from_numpy(planes))):
        found = []
        for a, b in itertools.product((1, -1), repeat=2):  # sign conventions differ between releases: find ours
            angles = {"roll": 0.0, "pitch": a * np.deg2rad(VIEW_LAT_DEG), "yaw": b * np.deg2rad(VIEW_LON_DEG)}
            shown = np.asarray(convert(equi=given, rots=angles)).transpose(1, 2, 0)
            found.append((psnr(shown, truth), angles))
        best, rots = max(found, key=lambda row: row[0])
        ms = measure(partial(convert, equi=given, rots=rots), repeats)
        rows.append(Row(what, f"pyequilib ({backend})", ms, psnr_db=best))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--threads", type=int, default=min(2, os.cpu_count() or 1))
    parser.add_argument("--out", type=Path, help="also write the table there, as Markdown")
    options = parser.parse_args()
    cv2.setNumThreads(options.threads)
    with contextlib.suppress(ImportError):
        import torch

        torch.set_num_threads(options.threads)
    rows = [
        *pal_to_erp(options.repeats),
        *erp_to_view(1024, 512, options.repeats),
        *erp_to_view(2048, 512, options.repeats),
        *erp_to_view(3840, 960, options.repeats),
    ]
    header = ["reprojection", "library", "frames/s", "ms/frame", "prepare ms", "PSNR dB"]
    table = [row.cells() for row in rows]
    print(setting(options.threads))
    print(text_table(header, table))
    if options.out is not None:
        command = f"python benchmarks/reprojection.py --repeats {options.repeats} --threads {options.threads}"
        write_whole(options.out, report(setting(options.threads), command, text_table(header, table, markdown=True)))


def setting(threads: int) -> str:
    """Machine and versions, on one line."""
    versions = [f"Python {platform.python_version()}"]
    for name in ("numpy", "opencv-python-headless", "torch", "py360convert", "pyequilib"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions.append(f"{name} {importlib.metadata.version(name)}")
    return f"{cpu_model()}, {available_cores()} cores, {threads} threads; {', '.join(versions)}"


def report(where: str, command: str, table: str) -> str:
    return f"""# Reprojection speed

Written by `{command} --out FILE`, panobench commit {commit() or "unknown"}.

Measured on {where}.

Median of repeated calls on 8-bit images, after two to warm up. The map of a camera pair is computed once per
conversion: "prepare" is its cost, not counted in the frames; the other libraries keep what they can between calls too.
PSNR is against the same function seen directly, so it shows what a faster call costs in quality.

{table}
"""


if __name__ == "__main__":
    main()
