"""Milliseconds of the Gaussian renderer, forward and backward, and its ratio to the dense torch oracle.

    python benchmarks/splat.py [--gaussians 10000 30000 60000] [--widths 256 512 1024] [--repeats 15] [--json]

The scene is a box of walls 2-4 m from the camera, covered evenly as seen from it, Gaussians flattened along the
walls and as wide as the spacing between them, half of them nearly opaque. Medians; run it on a quiet machine (the
machine line shows the load). Backward is for dL/d(colour) and gives the gradients of all parameters and the pose.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numba
import numpy as np
import torch

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import fibonacci_sphere, invert_pose, make_pose, quaternion_from_matrix, so3_exp
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.splat.view import Projection

CASES: dict[str, tuple[str, Projection]] = {
    "erp-sphere": ("erp", "sphere"),
    "erp-erp": ("erp", "erp"),
    "pinhole-sphere": ("pinhole", "sphere"),
    "pinhole-pinhole": ("pinhole", "pinhole"),
}
HALF_EXTENTS = np.array([3.0, 2.0, 4.0])
POSE = make_pose(so3_exp([0.05, 0.3, -0.1]), [0.2, -0.1, 0.3])


@dataclass
class Row:
    """One measurement; milliseconds are medians unless they say least, ``drawn`` counts the Gaussians composited."""

    case: str
    size: str
    gaussians: int
    drawn: int
    forward_ms: float
    forward_least_ms: float
    backward_ms: float
    backward_least_ms: float
    oracle_forward_ms: float | None = None
    oracle_backward_ms: float | None = None

    def __str__(self) -> str:
        return (
            f"{self.case:18s}{self.size:>10s}{self.gaussians:11d}{self.drawn:8d}{self.forward_ms:12.2f}"
            f"{self.forward_least_ms:8.2f}{self.backward_ms:13.2f}{self.backward_least_ms:8.2f}"
        )


def room(n: int, seed: int = 0) -> GaussianMap:
    """n Gaussians on the walls of a box around the origin."""
    rng = np.random.default_rng(seed)
    d = fibonacci_sphere(n)
    reach = HALF_EXTENTS / np.maximum(np.abs(d), 1e-9)
    wall = reach.argmin(axis=1)
    dist = reach.min(axis=1)
    across = np.sqrt(4 * np.pi / n) * dist * 0.5
    scales = np.repeat(across[:, None], 3, axis=1) * rng.uniform(0.7, 1.3, size=(n, 3))
    scales[np.arange(n), wall] *= 0.1
    tilt = quaternion_from_matrix(so3_exp(rng.normal(0, 0.1, size=(n, 3))))
    parameters = (
        d * dist[:, None],
        np.log(scales),
        tilt,
        rng.normal(2.0, 1.5, size=n),
        rng.uniform(size=(n, 3)),
    )
    return GaussianMap(*(p.astype(np.float32) for p in parameters))


def camera_of(kind: str, width: int) -> Camera:
    return ErpCamera(width, width // 2) if kind == "erp" else PinholeCamera.from_fov(width, 120.0, 60.0)


def timed_ms(run: Callable[[], Any], repeats: int, warm_up: int = 2) -> tuple[float, float]:
    """Median and least milliseconds of one call; the least tells what a busy machine hides."""
    times = []
    for _ in range(repeats + warm_up):
        start = time.perf_counter()
        run()
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times[warm_up:])), 1e3 * min(times[warm_up:])


def measure(case: str, n: int, width: int, repeats: int) -> Row:
    kind, projection = CASES[case]
    camera, gaussians = camera_of(kind, width), room(n)
    renderer = Renderer(camera, projection)
    out = renderer.forward(gaussians, POSE)
    weight = np.random.default_rng(1).normal(size=(3, camera.height, camera.width)).astype(np.float32)
    size = f"{camera.width}x{camera.height}"
    forward = timed_ms(lambda: renderer.forward(gaussians, POSE), repeats)
    backward = timed_ms(lambda: out.backward(weight, planar=True), repeats)
    return Row(case, size, n, len(out.order), *forward, *backward)


def measure_with_oracle(case: str, n: int, width: int, repeats: int) -> Row:
    """The same scene through the kernels and, in float32, through dense torch with its autograd (the tests' oracle)."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "splat"))
    from torch_reference import render_reference

    row = measure(case, n, width, repeats)
    kind, projection = CASES[case]
    camera, gaussians = camera_of(kind, width), room(n)
    means, log_scales, quats, logits, colours = leaves = [
        torch.tensor(a, requires_grad=True) for a in gaussians.arrays()
    ]
    T_cw = invert_pose(POSE)
    weight = torch.tensor(np.random.default_rng(1).normal(size=(camera.height, camera.width, 3)), dtype=torch.float32)

    def render() -> torch.Tensor:
        tau = torch.zeros(6, requires_grad=True)
        image = render_reference(means, log_scales, quats, logits, colours, camera, T_cw, tau, projection)
        return (image.colour * weight).sum()

    forwards, backwards = [], []
    for _ in range(3):
        for leaf in leaves:
            leaf.grad = None
        start = time.perf_counter()
        with torch.no_grad():
            render()
        middle = time.perf_counter()
        loss = render()
        late = time.perf_counter()
        loss.backward()
        forwards.append(middle - start)
        backwards.append(time.perf_counter() - late)
    row.oracle_forward_ms = 1e3 * float(np.median(forwards))
    row.oracle_backward_ms = 1e3 * float(np.median(backwards))
    return row


def machine() -> dict[str, Any]:
    """What the numbers depend on."""
    name = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as f:
            name = next((line.split(":", 1)[1].strip() for line in f if line.startswith("model name")), name)
    except OSError:
        pass
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    return {
        "cpu": name,
        "cores": os.cpu_count(),
        "threads": numba.get_num_threads(),
        "load": round(load, 2),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "torch": torch.__version__,
    }


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--gaussians", type=int, nargs="+", default=[10_000, 30_000, 60_000], metavar="N")
    parser.add_argument("--widths", type=int, nargs="+", default=[256, 512, 1024], metavar="PX")
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--threads", type=int, default=None, help="default: Numba's own")
    parser.add_argument("--oracle", type=int, nargs=2, default=[1000, 128], metavar=("N", "PX"), help="0 0: skip it")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of the table")
    options = parser.parse_args(arguments)
    limit = int(vars(numba.config)["NUMBA_NUM_THREADS"])
    if options.threads is not None and not 1 <= options.threads <= limit:
        parser.error(f"--threads must be 1..{limit} here (NUMBA_NUM_THREADS bounds it)")
    return options


def main(arguments: list[str] | None = None) -> None:
    options = parse(arguments)
    if options.threads:
        numba.set_num_threads(options.threads)
        torch.set_num_threads(options.threads)
    about = machine()
    table = not options.json
    if table:
        print("machine: " + ", ".join(f"{k} {v}" for k, v in about.items()), flush=True)
        print("compiling kernels" if sys.stdout.isatty() else "", end="\r", flush=True)
    measure("erp-sphere", 100, 64, 1)
    if table:
        titles = f"{'camera-projection':18s}{'size':>10s}{'Gaussians':>11s}{'drawn':>8s}"
        print(f"{titles}{'forward ms':>12s}{'least':>8s}{'backward ms':>13s}{'least':>8s}")
    rows = []
    for case in options.cases:
        for width in options.widths:
            for n in options.gaussians:
                row = measure(case, n, width, options.repeats)
                rows.append(row)
                if table:
                    print(row, flush=True)
    oracle = []
    n, width = options.oracle
    for case in options.cases if n and width else []:
        row = measure_with_oracle(case, n, width, options.repeats)
        oracle.append(row)
        assert row.oracle_forward_ms is not None
        assert row.oracle_backward_ms is not None
        if table:
            print(
                f"{row}   torch oracle {row.oracle_forward_ms:.0f} + {row.oracle_backward_ms:.0f} ms:"
                f" {row.oracle_forward_ms / row.forward_ms:.0f}x and {row.oracle_backward_ms / row.backward_ms:.0f}x",
                flush=True,
            )
    if options.json:
        print(json.dumps({"machine": about, "rows": [asdict(r) for r in rows], "oracle": [asdict(r) for r in oracle]}))


if __name__ == "__main__":
    main()
