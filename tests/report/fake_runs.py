"""Fake run folders, shaped as the runner writes them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from panobench.bench.records.results import write_depth
from panobench.bench.records.runfolder import write_frames, write_json
from panobench.datasets.files.trajectory_io import write_tum
from panobench.geometry import make_pose, so3_exp
from panobench.metrics.rendering import write_pair
from panobench.types import DepthEstimate, Trajectory


def loop(n: int, noise: float = 0.0, seed: int = 0) -> Trajectory:
    """A wavy loop of n poses in a world with y down; ``noise`` metres are added to every position."""
    t = np.linspace(0, 2 * np.pi, n, endpoint=False)
    p = np.stack([np.sin(t), 0.1 * np.sin(3 * t), np.cos(t) * 0.7], axis=1)
    p += noise * np.random.default_rng(seed).standard_normal(p.shape)
    return Trajectory(np.arange(n) / 15.0, make_pose(so3_exp(np.stack([0 * t, t, 0 * t], axis=1)), p))


def panorama(phase: float, width: int = 128) -> np.ndarray:
    """(H, W, 3) float picture 0..1 that differs with ``phase``."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, width), np.linspace(0, np.pi, width // 2))
    return np.stack([0.5 + 0.4 * np.sin(3 * u + phase), v / np.pi, 0.5 + 0.4 * np.cos(5 * v + phase)], axis=2)


def write_run(
    folder: Path,
    *,
    method: str = "panogs",
    dataset: str = "rooms",
    sequence: str = "room1",
    seed: int = 0,
    status: str = "ok",
    message: str = "",
    origin: str = "measured",
    noise: float = 0.001,
    tracked: float = 1.0,
    frames: int = 40,
    pictures: int = 2,
    fps: float = 4.0,
    truth: bool = True,
    depth: bool = True,
    spec: dict[str, Any] | None = None,
    metrics: dict[str, Any] | None = None,
    log: str = "tracking\nfinished",
) -> Path:
    """Write a run folder at ``folder`` and return it. ``noise`` is the trajectory's error per axis, metres."""
    folder.mkdir(parents=True)
    reference, estimate = loop(frames), loop(frames, noise, seed + 1)
    count = round(tracked * frames)
    if truth:
        write_tum(folder / "groundtruth.tum", reference)
    write_tum(folder / "trajectory.tum", estimate.select(np.arange(count)))
    rng = np.random.default_rng(seed)
    write_frames(
        folder / "frames.csv",
        [
            {
                "index": i,
                "time": f"{reference.times[i]:.9f}",
                "tracked": int(i < count),
                "latency_s": f"{(0.5 + rng.random()) / fps:.6f}",
                "loss": 0.02 + 0.01 * rng.random(),
            }
            for i in range(frames)
        ],
    )
    for i in range(pictures):
        picture = panorama(0.3 * i)
        blurred = cv2.GaussianBlur(picture, (0, 0), 1.5)
        write_pair(folder / "renders", f"{i * 10:06d}", blurred.astype(np.float32), picture.astype(np.float32))
    if depth:
        distance = (1.0 + panorama(1.0)[..., 0]).astype(np.float32)
        write_depth(folder / "renders", DepthEstimate(distance, confidence=np.ones_like(distance)))
    (folder / "log.txt").write_text(log)
    ate = noise * np.sqrt(3) if truth and status in ("ok", "lost") else None
    write_json(
        folder / "run.json",
        {
            "schema": 1,
            "status": status,
            "message": message,
            "origin": origin,
            "protocol": "1.0",
            "metric": False,
            "spec": {
                "method": method,
                "camera": "erp",
                "dataset": dataset,
                "sequence": sequence,
                "seed": seed,
                "width": 512,
                "settings": {},
                **(spec or {}),
            },
            "metrics": {
                "ate_rmse_m": ate,
                "ate_keyframes_rmse_m": ate,
                "rpe_trans_rmse_m": None if ate is None else 0.3 * ate,
                "tracked": tracked,
                "psnr_db": 31.0 - 1000 * noise,
                "ssim": 0.91,
                "lpips": None,
                "pano_psnr_db": 32.0 - 1000 * noise,
                **(metrics or {}),
            },
            "timing": {
                "fps": fps,
                "tracking_fps": 4 * fps,
                "latency_p50_s": 0.8 / fps,
                "latency_p95_s": 1.2 / fps,
                "wall_s": frames / fps,
                "peak_rss_bytes": 9e8 + 1e7 * fps,
            },
            "map": {"file": "map.ply", "gaussians": 21034, "bytes": 5_000_000},
            "depth": {"source": "bootstrap", "oracle": False, "range": [0.8, 3.9]},
            "keyframes": list(range(0, frames, 8)),
            "provenance": {
                "panobench": "0.1.0",
                "machine": {"cpu": "Some CPU @ 2.0 GHz", "cores": 2},
                "packages": {"numpy": "2.0.0"},
                "command": f"panobench run --method {method} --dataset {dataset} --sequence {sequence} --seed {seed}",
            },
        },
    )
    return folder


def write_suite(store: Path) -> Path:
    """A store with three methods, two sequences, repeats, and each kind of failure; returns it."""
    bare: dict[str, Any] = {"pictures": 0, "depth": False}
    other: dict[str, Any] = {"method": "imported-slam", "origin": "imported", **bare}
    write_run(store / "a0")
    write_run(store / "a1", seed=1, noise=0.0012)
    write_run(store / "a2", seed=2, noise=0.0008)
    write_run(store / "b0", method="sparse", noise=0.004, fps=25.0, **bare)
    write_run(store / "c0", noise=0.01, **other)
    write_run(store / "a3", sequence="room2", noise=0.002)
    lost: dict[str, Any] = {"tracked": 0.6, "status": "lost", "message": "tracked 60%"}
    write_run(store / "b1", method="sparse", sequence="room2", **lost, **bare)
    write_run(store / "c1", sequence="room2", status="crashed", log="Segmentation fault", **other)
    return store
