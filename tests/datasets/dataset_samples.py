"""Tiny data sets on disk, in the layouts the adapters read. Images carry their frame number in their grey level."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from panobench.datasets.files.trajectory_io import rows_from_poses
from panobench.geometry import make_pose, so3_exp

SIZE = (64, 32)


def panorama(index: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A smooth RGB panorama (H, W, 3) that differs per frame and per channel."""
    w, h = size
    u = (np.arange(w) + 0.5) / w * 2 * np.pi
    v = (np.arange(h) + 0.5) / h
    image = np.empty((h, w, 3))
    image[..., 0] = 120 + 80 * np.sin(u)[None, :]
    image[..., 1] = 40 + 160 * v[:, None]
    image[..., 2] = 20 + 10 * (index % 20)
    return image.round().astype(np.uint8)


def save(path: Path, rgb: np.ndarray) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), rgb[..., ::-1] if rgb.ndim == 3 else rgb)
    return path


def poses(n: int) -> np.ndarray:
    """Camera-to-world poses (n, 4, 4) on a gentle curve, x right, y down, z forward."""
    k = np.arange(n)[:, None]
    return make_pose(so3_exp(k * [[0.01, 0.05, -0.02]]), np.concatenate([0.1 * k, 0.02 * k, 0.05 * np.sin(k)], axis=1))


def pose_row(T: np.ndarray) -> str:
    return " ".join(f"{x:.9f}" for x in rows_from_poses(T[None])[0])


def synpano_scene(
    folder: Path, n: int = 4, *, header: bool = True, suffix: str = ".png", raw: bool = True
) -> np.ndarray:
    """Write a scene; returns its camera-to-world poses in the package's axes. ``raw``: store Blender axes."""
    true = poses(n)
    stored = true.copy()
    if raw:
        stored[:, :3, :3] = true[:, :3, :3] @ np.diag([1.0, -1.0, -1.0])
    lines = ["frame_id image_name x y z qx qy qz qw"] if header else []
    for i in range(n):
        save(folder / "images" / f"{i:06d}{suffix}", panorama(i))
        lines.append(f"{i} {i:06d}{suffix} {pose_row(stored[i])}")
    (folder / "groundtruth.txt").write_text("\n".join(lines) + "\n")
    return true


def video(path: Path, n: int = 30, rate: float = 24.0, size: tuple[int, int] = SIZE) -> Path:
    """An MPEG-4 clip; the grey level of a frame's lower half tells its number."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), rate, size)
    assert writer.isOpened()
    for i in range(n):
        frame = panorama(0, size)
        frame[size[1] // 2 :] = 4 * i + 10
        writer.write(frame[..., ::-1])
    writer.release()
    return path
