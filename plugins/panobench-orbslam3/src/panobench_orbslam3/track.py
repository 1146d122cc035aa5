"""Runs in the environment that has pyorbslam3 and numpy: feeds the images, saves trajectories and tracking times.

``python track.py VOCABULARY WORK PACE``; WORK holds settings.yaml, times.txt (nanoseconds) and images/<time>.png, and
with an IMU imu.txt: rows of time in s, angular rate in rad/s and specific force in m/s^2.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any


def read_grey(path: Path) -> Any:
    """Image (H, W) uint8 of an 8-bit grey PNG, by OpenCV if it is installed."""
    try:
        import cv2

        return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    except ImportError:
        return decode_grey_png(path.read_bytes())


def decode_grey_png(data: bytes) -> Any:
    """Decode an 8-bit grey PNG without interlacing (filters: section 9 of the PNG specification)."""
    import struct
    import zlib

    import numpy as np

    width, height, depth, colour, _, _, interlace = struct.unpack(">IIBBBBB", data[16:29])
    if (depth, colour, interlace) != (8, 0, 0):
        raise ValueError("only 8-bit grey PNG files without interlacing are read")
    at, packed = 8, b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        if kind == b"IDAT":
            packed += data[at + 8 : at + 8 + length]
        at += 12 + length
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, width + 1)
    image = np.zeros((height, width), np.uint8)
    above = np.zeros(width, np.uint8)
    for y in range(height):
        kind, line = rows[y, 0], rows[y, 1:].copy()
        if kind == 2:
            line += above
        elif kind == 1:
            line = np.cumsum(line, dtype=np.uint8)
        elif kind in (3, 4):
            left, corner = 0, 0
            for x in range(width):
                up = int(above[x])
                if kind == 3:
                    guess = (left + up) // 2
                else:
                    p = left + up - corner
                    a, b, c = abs(p - left), abs(p - up), abs(p - corner)
                    guess = left if a <= b and a <= c else up if b <= c else corner
                left, corner = (int(line[x]) + guess) & 255, up
                line[x] = left
        image[y] = above = line
    return image


def samples_by_frame(path: Path, stamps: list[str]) -> Any:
    """For each frame the inertial samples (n, 7) after the frame before it; for the first one those of 0.1 s."""
    import numpy as np

    samples = np.loadtxt(path, ndmin=2)
    times = np.array([int(stamp) * 1e-9 for stamp in stamps])
    begin = np.searchsorted(samples[:, 0], [times[0] - 0.1, *times], side="right")
    return [samples[begin[i] : begin[i + 1]] for i in range(len(times))]


def main(vocabulary: str, work: Path, pace: float) -> None:
    import pyorbslam3

    stamps = [line for line in (work / "times.txt").read_text().split() if line]
    inertial = (work / "imu.txt").exists()
    samples = samples_by_frame(work / "imu.txt", stamps) if inertial else [None] * len(stamps)
    sensor = pyorbslam3.Sensor.IMU_MONOCULAR if inertial else pyorbslam3.Sensor.MONOCULAR
    slam = pyorbslam3.Slam(vocabulary, str(work / "settings.yaml"), sensor, use_viewer=False)
    begin, tracked = time.perf_counter(), 0
    seconds: list[float] = []
    for i, stamp in enumerate(stamps):
        image = read_grey(work / "images" / f"{stamp}.png")
        ahead = (int(stamp) - int(stamps[0])) * 1e-9 * pace - (time.perf_counter() - begin)
        if ahead > 0:
            time.sleep(ahead)
        start = time.perf_counter()
        result = slam.track_monocular(image, int(stamp) * 1e-9, samples[i])
        seconds.append(time.perf_counter() - start)
        tracked += bool(result.pose_valid)
        print(f"frame {i}: {result.state}", flush=True)
    slam.shutdown()
    (work / "track_times.txt").write_text("\n".join(f"{s:.6f}" for s in seconds) + "\n")
    print(f"{tracked} of {len(stamps)} frames tracked live", flush=True)
    if tracked:
        slam.save_trajectory_euroc(str(work / "frames.txt"))
        slam.save_keyframe_trajectory_euroc(str(work / "keyframes.txt"))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]))
