"""Everything to measure on a GPU, in one command of under five minutes: correctness first, then speed.

    python benchmarks/device.py [--out device.json] [--stage NAME ...] [--budget 290] [--emulate]

Stages, in this order: `correctness` (the emulator's stored answers, then the Numba renderer; a failure ends it with
exit code 1), `steps` (milliseconds of forward, backward and a whole mapping step, beside the Numba renderer), `runs`
(panogs on room1 at three widths) and `sanitizer` (compute-sanitizer, where it is installed). A stage for which the
budget has no time left is left out, and named. It prints a table and writes JSON.

--emulate: the first two stages on the emulator, in small; it tests this file where there is no GPU.
--store: writes the stored answers anew, from the emulator; needed when the formulas change.
"""

from __future__ import annotations

import argparse
import json
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from splat import POSE, room

from panobench.cameras.erp import ErpCamera
from panobench.gpu import emulator, nvrtc
from panobench.gpu.device import CudaDevice, Device
from panobench.gpu.source import source
from panobench.splat.adam import GaussianAdam, LearningRates, Target
from panobench.splat.backend import empty_map, new_adam
from panobench.splat.loss import pixel_weights
from panobench.splat.render import Renderer

EXPECTED = Path(__file__).with_name("device_expected.npz")
#: Gaussians and width of what is timed; the Numba renderer is timed up to the second number of Gaussians.
SIZES = [(30_000, 512), (127_000, 1024), (509_000, 2048), (2_000_000, 4096)]
NUMBA_MOST = 127_000
#: Largest relative error against the stored answers (of the counts: a pixel at the edge of a footprint may fall on
#: either side), and against the Numba renderer.
STORED_LIMIT, COUNTS_LIMIT = 1e-3, 2e-2
NUMBA_LIMITS = {"image": 1e-3, "pose": 1e-2, "gradients": 5e-2}
RATES = LearningRates(1e-3, 0.01, 0.01, 0.02, 0.01, lift=0.2, tilt=0.1)
#: Width, frames and seconds that a run may take. More frames would not fit into the budget.
RUNS = [(512, 120, 40), (1024, 80, 50), (2048, 40, 60)]


class Clock:
    """Seconds since the start, and what is left of the budget."""

    def __init__(self, budget: float) -> None:
        self.began, self.budget = time.perf_counter(), budget

    @property
    def left(self) -> float:
        return self.budget - (time.perf_counter() - self.began)

    def say(self, *words: object) -> None:
        print(f"[{time.perf_counter() - self.began:6.1f}]", *words, flush=True)


def relative(got: Any, want: Any) -> float:
    """Norm of the difference over the norm."""
    want = np.asarray(want, dtype=np.float64)
    return float(np.linalg.norm(np.asarray(got, dtype=np.float64) - want) / max(float(np.linalg.norm(want)), 1e-30))


def photograph(camera: ErpCamera, seed: int = 1) -> Target:
    """A smooth random picture to fit, as a mapping step has it."""
    rng = np.random.default_rng(seed)
    coarse = torch.from_numpy(rng.random((1, 3, 8, 16)))
    image = torch.nn.functional.interpolate(coarse, (camera.height, camera.width), mode="bicubic")[0]
    return Target(
        np.ascontiguousarray((image.clamp(0, 1) * 255).byte().numpy().transpose(1, 2, 0)), pixel_weights(camera),
        knee=0.05, opaque=0.5,
    )  # fmt: skip


# -- correctness -------------------------------------------------------------------------------------------------------


def answers(device: Device) -> dict[str, np.ndarray]:
    """What a small scene gives: all images, all gradients, and the map after three mapping steps."""
    camera, g = ErpCamera(64, 32), room(300)
    renderer = Renderer(camera, device=device)
    render = renderer.forward(g, POSE, count_touched=True, sum_weights=True, sloped=True)
    out: dict[str, Any] = {"sloped depth": render.depth, "touched": render.touched, "weights": render.weights}
    render = renderer.forward(g, POSE)
    out |= {"planes": render.planes, "depth": render.depth, "opacity": render.opacity}
    rng = np.random.default_rng(2)
    back = [rng.normal(size=a.shape).astype(np.float32) for a in (render.colour, render.depth, render.opacity)]
    gradients = render.backward(*back)
    out |= {"gradients": gradients.packed, "pose": gradients.pose}
    mine, adam = empty_map(device).concat(g), new_adam(len(g), 0.8, 0.99, device)
    target = photograph(camera)
    losses = [adam.photometric_step(renderer.forward(mine, POSE), target, RATES, 1e-4)[0] for _ in range(3)]
    return out | {"losses": np.array(losses), "means": mine.means, "quats": mine.quats, "colours": mine.colours}


def correctness(device: Device, clock: Clock, small: bool) -> dict[str, Any]:
    """Errors against the stored answers and against the Numba renderer, and whether all are within their limits."""
    stored = np.load(EXPECTED)
    found = answers(device)
    errors = {name: relative(found[name], stored[name]) for name in stored.files}
    worst = max(errors, key=lambda name: errors[name])
    clock.say(f"stored answers: largest error {errors[worst]:.1e} ({worst})")
    n, width = (500, 64) if small else (30_000, 512)
    camera, g = ErpCamera(width, width // 2), room(n)
    d = np.random.default_rng(3).normal(size=(3, width // 2, width)).astype(np.float32)
    renders = [Renderer(camera, device=d_).forward(g, POSE) for d_ in (device, None)]
    gradients = [r.backward(d, planar=True) for r in renders]
    numbas = {
        "image": relative(renders[0].planes, renders[1].planes),
        "pose": relative(gradients[0].pose, gradients[1].pose),
        "gradients": relative(gradients[0].packed, gradients[1].packed),
    }
    clock.say("against Numba:", ", ".join(f"{k} {v:.1e}" for k, v in numbas.items()))
    again = Renderer(camera, device=device).forward(g, POSE)
    repeats = bool(np.array_equal(again.planes, renders[0].planes))
    clock.say("images repeat to the bit" if repeats else "images do not repeat to the bit")
    ok = all(e < (COUNTS_LIMIT if name == "touched" else STORED_LIMIT) for name, e in errors.items())
    ok = ok and all(numbas[k] < limit for k, limit in NUMBA_LIMITS.items())
    return {"ok": ok, "stored": errors, "numba": numbas, "images repeat": repeats}


# -- milliseconds ------------------------------------------------------------------------------------------------------


def timed(run: Callable[[], Any], finish: Callable[[], Any], seconds: float, most: int = 50) -> dict[str, float]:
    """Median, least and number of milliseconds of ``run``, after two runs that do not count."""
    for _ in range(2):
        run()
    finish()
    times: list[float] = []
    began = time.perf_counter()
    while len(times) < most and (len(times) < 3 or time.perf_counter() - began < seconds):
        start = time.perf_counter()
        run()
        finish()
        times.append(1e3 * (time.perf_counter() - start))
    return {"median": float(np.median(times)), "least": min(times), "times": len(times)}


def one_size(n: int, width: int, device: Device | None, seconds: float) -> dict[str, Any]:
    """Forward, backward and whole mapping step of a room of n Gaussians."""
    camera = ErpCamera(width, width // 2)
    renderer, start = Renderer(camera, low_pass=0.1, device=device), room(n)
    g, target = empty_map(device).concat(start), photograph(camera)
    adam = new_adam(n, 0.8, 0.99, device) if device else GaussianAdam(n, 0.8, 0.99)
    finish = torch.cuda.synchronize if isinstance(device, CudaDevice) else (lambda: None)
    render = renderer.forward(g, POSE)
    d = np.random.default_rng(3).normal(size=(3, width // 2, width)).astype(np.float32)
    out: dict[str, Any] = {"gaussians": n, "width": width, "drawn": render.drawn}
    out["forward"] = timed(lambda: renderer.forward(g, POSE), finish, seconds)
    if device is None:
        out["backward"] = timed(lambda: render.backward(d, planar=True), finish, seconds)
    else:
        on_device = device.upload(d)  # so that copying it does not count
        out["backward"] = timed(lambda: render.sums_on_device(on_device), finish, seconds)  # type: ignore[attr-defined]
    out["step"] = timed(lambda: adam.photometric_step(renderer.forward(g, POSE), target, RATES), finish, seconds)
    return out


def steps(device: Device, clock: Clock, small: bool) -> list[dict[str, Any]]:
    """``one_size`` of all sizes on the device, and on the CPU where that does not take long."""
    rows = []
    for n, width in [(300, 64)] if small else SIZES:
        on_gpu = one_size(n, width, device, 0.1 if small else 1.0)
        on_cpu = one_size(n, width, None, 1.0) if n <= NUMBA_MOST and clock.left > 60 else None
        rows.append({"device": on_gpu, "numba": on_cpu})
        clock.say(_row(rows[-1]))
    return rows


def _row(row: dict[str, Any]) -> str:
    mine, numba = row["device"], row["numba"]
    words = [f"{mine['gaussians']:9,d} at {mine['width']:4d}"]
    for what in ("forward", "backward", "step"):
        beside = f" (Numba {numba[what]['median']:.1f})" if numba else ""
        words.append(f"{what} {mine[what]['median']:.3f} ms{beside}")
    return "  ".join(words)


# -- whole runs --------------------------------------------------------------------------------------------------------


def runs(clock: Clock) -> list[dict[str, Any]]:
    """panogs on room1 at three widths, each in a process of its own."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for width, frames, seconds in RUNS:
            out = Path(folder) / str(width)
            if clock.left < seconds:
                clock.say(f"room1 at {width}: left out, {clock.left:.0f} s are left")
                continue
            command = [sys.executable, "-m", "panobench.cli.main", "run", "--dataset", "rooms", "--sequence", "room1"]
            command += ["--width", str(width), "--max-frames", str(frames), "--holdout", "8", "--device", "cuda"]
            try:
                done = subprocess.run(
                    [*command, "--quiet", "--out", str(out)], capture_output=True, text=True, timeout=seconds
                )
                record = json.loads((out / "run.json").read_text(encoding="utf-8"))
            except (subprocess.TimeoutExpired, OSError) as error:
                rows.append({"width": width, "failed": f"{type(error).__name__}: {error}"})
                clock.say(f"room1 at {width}: {rows[-1]['failed']}")
                continue
            rows.append(
                {"width": width, "frames": frames, "exit code": done.returncode, "status": record["status"],
                 "message": record["message"], "gpu": record.get("gpu"), "timing": record["timing"],
                 "metrics": record["metrics"]}
            )  # fmt: skip
            timing, metrics = record["timing"], record["metrics"]
            clock.say(f"room1 at {width}: {record['status']}, {timing.get('fps') or 0:.1f} frames/s,", metrics)
    return rows


def sanitizer(clock: Clock) -> dict[str, str]:
    """The last lines of compute-sanitizer's tools over the small scene."""
    program = shutil.which("compute-sanitizer") or shutil.which("/usr/local/cuda/bin/compute-sanitizer")
    if program is None:
        clock.say("compute-sanitizer is not installed")
        return {}
    said = {}
    for tool in ("memcheck", "racecheck", "synccheck"):
        if clock.left < 20:
            clock.say(f"{tool}: left out, {clock.left:.0f} s are left")
            continue
        command = [program, "--tool", tool, sys.executable, __file__, "--stage", "answers"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=min(clock.left, 60))
            said[tool] = "\n".join((done.stdout + done.stderr).strip().splitlines()[-3:])
        except subprocess.TimeoutExpired:
            said[tool] = "took longer than a minute"
        clock.say(f"{tool}: {said[tool]}")
    return said


# -- all of it ---------------------------------------------------------------------------------------------------------


def environment(device: Device, clock: Clock) -> dict[str, Any]:
    """The machine, and the seconds of one compilation."""
    found = {"device": device.name, "python": platform.python_version(), "torch": torch.__version__}
    if isinstance(device, CudaDevice):
        major, minor = torch.cuda.get_device_capability()
        began = time.perf_counter()
        nvrtc.compile_source(source().encode(), f"sm_{major}{minor}")
        found |= {"cuda": torch.version.cuda, "nvrtc": nvrtc.version(), "architecture": f"sm_{major}{minor}"}
        found["compile_s"] = round(time.perf_counter() - began, 2)
    clock.say(found)
    return found


def emulated() -> Device:
    return emulator.EmulatedDevice(emulator.build(Path(tempfile.mkdtemp())))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("device.json"))
    parser.add_argument("--stage", nargs="+", default=["correctness", "steps", "runs", "sanitizer"])
    parser.add_argument("--budget", type=float, default=290.0, help="seconds")
    parser.add_argument("--emulate", action="store_true")
    parser.add_argument("--store", action="store_true")
    options = parser.parse_args()
    clock = Clock(options.budget)
    device = emulated() if options.emulate or options.store else CudaDevice()
    if options.store:
        np.savez_compressed(EXPECTED, **answers(device))
        return 0
    if options.stage == ["answers"]:  # what the sanitizer looks at
        answers(device)
        return 0
    results: dict[str, Any] = {"environment": environment(device, clock)}
    try:
        if "correctness" in options.stage:
            results["correctness"] = correctness(device, clock, options.emulate)
            if not results["correctness"]["ok"]:
                clock.say("the device's answers are wrong: nothing is timed")
                return 1
        if "steps" in options.stage:
            results["steps"] = steps(device, clock, options.emulate)
        if "runs" in options.stage and not options.emulate:
            results["runs"] = runs(clock)
        if "sanitizer" in options.stage and not options.emulate:
            results["sanitizer"] = sanitizer(clock)
    finally:
        results["peak_gpu_bytes"] = device.peak_memory_bytes()
        options.out.write_text(json.dumps(results, indent=1, default=float), encoding="utf-8")
        clock.say(f"written: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
