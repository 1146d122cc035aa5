"""A plugin with methods that behave and misbehave, and a dataset that needs no files. Installed by conftest.py."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from panobench import (
    BatchMethod,
    Dataset,
    DatasetSpec,
    Estimate,
    InputError,
    MethodSpec,
    NovelView,
    OnlineMethod,
    Trajectory,
    UnknownNameError,
    hookimpl,
)
from panobench.external.adapter import ExternalConfig, ExternalMethod, Job
from panobench.testing import TinySequence


@dataclass(frozen=True)
class Inner:
    gain: float = 0.5
    steps: tuple[int, ...] = (1, 2)


@dataclass(frozen=True)
class FakeConfig:
    features: int = 100
    rate: float = 1.0
    fast: bool = False
    name: str | None = None
    inner: Inner = field(default_factory=Inner)

    def __post_init__(self) -> None:
        if self.features < 1:
            raise ValueError("features must be at least 1")


class Still(OnlineMethod):
    """Says it moves straight ahead; renders a grey picture."""

    def start(self, camera, context):
        self.times, self.poses, self.context = [], [], context
        context.log("still started")

    def pose(self, frame):
        T = np.eye(4)
        T[2, 3] = 0.1 * frame.index
        T[0, 3] = 0.01 * frame.index**2 * (1 + 0.01 * self.context.seed)
        return T

    def track(self, frame):
        assert not hasattr(frame, "T_wc")
        self.times.append(frame.time)
        self.poses.append(self.pose(frame))
        return self.poses[-1]

    def finish(self):
        n = len(self.times)
        frames = {i: {"loss": 1.0 / (i + 1), "tracking_s": 0.001} for i in range(n)}
        return Estimate(
            Trajectory(np.array(self.times), np.array(self.poses).reshape(-1, 4, 4)),
            keyframes=list(range(0, n, 2)),
            frames=frames,
            extra={"seed": self.context.seed},
        )

    def render(self, camera, T_wc):
        return np.full((camera.height, camera.width, 3), 0.5, np.float32)


class Slow(Still):
    def track(self, frame):
        if frame.index and "FAKE_PROGRESS" in os.environ:  # the frames before this one are done
            Path(os.environ["FAKE_PROGRESS"]).write_text(str(frame.index))
        time.sleep(float(os.environ.get("FAKE_SLEEP", "0.05")))
        return super().track(frame)


class CompilesLate(Still):
    """Warms up, and has Numba compile something in the middle of a run all the same."""

    def warm_up(self, camera):
        assert camera.kind == "erp"
        time.sleep(0.3)

    def track(self, frame):
        if frame.index == 5:
            import numba

            @numba.njit
            def kernel_of_a_plugin(x):
                total = 0.0
                for i in range(x):
                    total += np.sin(i) * np.cos(total)
                return total

            kernel_of_a_plugin(3)
        return super().track(frame)


class Crash(Still):
    def track(self, frame):
        if frame.index == 3:
            raise ValueError("three is\nmy limit")
        return super().track(frame)


class NanPose(Still):
    def pose(self, frame):
        T = super().pose(frame)
        if frame.index == 2:
            T[0, 0] = np.nan
        return T


class Skewed(Still):
    def pose(self, frame):
        T = super().pose(frame)
        T[:3, :3] *= 1.1
        return T


class LosesTrack(Still):
    def track(self, frame):
        return super().track(frame) if frame.index < 4 else None


class Hang(Still):
    def track(self, frame):
        if frame.index == 2:
            signal.signal(signal.SIGTERM, signal.SIG_IGN)
            while True:
                time.sleep(1)
        return super().track(frame)


class Exit(Still):
    def track(self, frame):
        if frame.index == 2:
            os._exit(7)
        return super().track(frame)


class Segfault(Still):
    def track(self, frame):
        if frame.index == 2:
            import ctypes

            ctypes.string_at(0)
        return super().track(frame)


class Hungry(Still):
    def track(self, frame):
        if frame.index == 2:
            self.hoard = []
            while True:
                self.hoard.append(np.ones(32 << 20, np.uint8))
        return super().track(frame)


class Exhausted(Still):
    """Its own allocation fails."""

    def track(self, frame):
        if frame.index == 2:
            raise MemoryError
        return super().track(frame)


class Bomb(Still):
    """Children that start children without end, each in a session of its own; they write their ids."""

    def track(self, frame):
        if frame.index == 2:
            code = (
                "import os, subprocess, sys, time\n"
                "with open(os.environ['FAKE_PIDS'], 'a') as file: file.write(f'{os.getpid()}\\n')\n"
                "for _ in range(3): subprocess.Popen([sys.executable, '-c', sys.argv[1], sys.argv[1]],"
                " start_new_session=True)\n"
                "time.sleep(600)"
            )
            subprocess.Popen([sys.executable, "-c", code, code], start_new_session=True).wait()
        return super().track(frame)


class Spawner(Still):
    """Starts children that would outlive it (in sessions of their own), writes their ids, then hangs."""

    def track(self, frame):
        if frame.index == 1:
            code = "import time; time.sleep(600)"
            children = [
                subprocess.Popen([sys.executable, "-c", code], start_new_session=new) for new in (False, True, True)
            ]
            Path(os.environ["FAKE_PIDS"]).write_text(" ".join(str(c.pid) for c in children))
            time.sleep(600)
        return super().track(frame)


class Peeks(Still):
    """Looks for ground truth wherever a frame or the context could carry it."""

    def track(self, frame):
        assert frame.depth is None
        assert self.context.poses is None
        assert self.context.imu is None
        frame.image[:] = 0  # its own copy
        return super().track(frame)


class Batch(BatchMethod):
    def set_up(self, sequence, context):
        time.sleep(0.3)

    def run(self, sequence, context):
        assert sequence.groundtruth is None
        assert sequence.depth(0) is None
        assert sequence.novel_views() == []
        assert sequence.imu is None
        assert not any(hasattr(v, "groundtruth") for v in vars(sequence).values())
        frames = list(sequence.frames())
        (context.work / "scratch").write_text("x")
        poses = np.tile(np.eye(4), (len(frames), 1, 1))
        poses[:, 0, 3] = np.arange(len(frames))
        return Estimate(Trajectory(sequence.times, poses), extra={"mapped": [f.index for f in frames if f.mappable]})


class Program(ExternalMethod):
    """An external program; its option ``extra`` says how it behaves."""

    title, program, variable = "Program", sys.executable, "PANOBENCH_FAKE_PROGRAM"

    def prepare(self, sequence, context):
        rows = "".join(f"{t:.9f} {i} 0 0 0 0 0 1\n" for i, t in enumerate(sequence.times))
        code = (
            "import os, sys, time\n"
            f"work, rows, how = {str(context.work)!r}, {rows!r}, sys.argv[1]\n"
            "print('about to', how, flush=True)\n"
            "if how == 'crash': sys.exit(7)\n"
            "if how == 'hang': time.sleep(60)\n"
            "if how == 'stray': open(work + '/../../stray.txt', 'w').write('x')\n"
            "if how == 'partial': rows = rows[:-9]\n"
            "if how == 'malformed': rows = 'no trajectory at all\\n'\n"
            "if how != 'silent': open(work + '/out.txt', 'w').write(rows)\n"
        )
        return Job(["-c", code], context.work / "out.txt")


class GivenPoses(OnlineMethod):
    def start(self, camera, context):
        self.poses, self.times, self.context = context.poses, [], context

    def track(self, frame):
        self.times.append(frame.time)
        return self.poses[frame.index]

    def finish(self):
        n = len(self.times)
        return Estimate(
            Trajectory(np.array(self.times), np.array([self.poses[i] for i in range(n)])),
            keyframes=[0, n // 2, n - 1],
            metric=True,
        )

    def render(self, camera, T_wc):
        return (TinySequence(n=1, seed=1).image_from(T_wc, camera) / 255).astype(np.float32)


class WantsDepth(Still):
    """Asks for the depth estimator the user chose."""

    def track(self, frame):
        if frame.index == 0:
            self.estimator = self.context.make_depth()
        self.depths = getattr(self, "depths", [])
        self.depths.append(frame.depth is not None)
        return super().track(frame)

    def finish(self):
        estimate = super().finish()
        estimate.extra["depths"] = self.depths
        return estimate


class TinyDataset(Dataset):
    name = "tiny"

    def sequences(self):
        return ["a", "b", "c"]

    def open(self, sequence=None, *, width=None):
        sequence = sequence or "a"
        if sequence not in [*self.sequences(), "broken", "empty", "blind"]:
            raise UnknownNameError("sequence", sequence, self.sequences())
        tiny = Views(n=0 if sequence == "empty" else 12, seed=1, name=sequence)
        if width is not None:
            tiny.camera = tiny.camera.scaled(width)
        if sequence == "broken":
            tiny.broken = 5
        tiny.blind = sequence == "blind"
        return tiny


class Views(TinySequence):
    """``blind``: without ground truth, so that evo is not imported and a run takes half a second."""

    broken: int | None = None
    blind = False
    dataset = "tiny"

    @property
    def groundtruth(self):
        return None if self.blind else super().groundtruth

    def image(self, index):
        if index == self.broken:
            raise InputError("the image is truncated", "broken/000005.png", frame=index)
        return super().image(index)

    def novel_views(self):
        if self.blind:
            return []
        T = self.pose_at(0.35)
        T[1, 3] += 0.2
        return [NovelView("up", self.image_from(T), self.camera, T)]

    def provenance(self):
        return {"generator": "tiny", "sha256": os.environ.get("FAKE_DATA", "0" * 64)}


_METHODS = {
    "still": Still,
    "compiles-late": CompilesLate,
    "slow": Slow,
    "crash": Crash,
    "nan-pose": NanPose,
    "skewed": Skewed,
    "loses-track": LosesTrack,
    "hang": Hang,
    "exit": Exit,
    "segfault": Segfault,
    "hungry": Hungry,
    "spawner": Spawner,
    "exhausted": Exhausted,
    "bomb": Bomb,
    "peeks": Peeks,
    "batch": Batch,
    "wants-depth": WantsDepth,
}


@hookimpl
def register_methods():
    specs = [
        MethodSpec(f"fake-{name}", "for tests", f"{__name__}:{cls.__name__}", cameras=("erp", "pinhole"))
        for name, cls in _METHODS.items()
    ]
    specs.append(MethodSpec("fake-poses", "for tests", f"{__name__}:GivenPoses", needs=("rgb", "poses")))
    specs.append(MethodSpec("fake-absent", "for tests", f"{__name__}:Still", requires=("no_such_package",)))
    specs.append(MethodSpec("fake-depth", "for tests", f"{__name__}:WantsDepth", needs=("rgb", "depth")))
    specs.append(MethodSpec("fake-inertial", "for tests", f"{__name__}:Still", needs=("rgb", "imu")))
    program = f"{ExternalConfig.__module__}:{ExternalConfig.__name__}"
    specs.append(MethodSpec("fake-program", "for tests", f"{__name__}:Program", config=program))
    specs.append(
        MethodSpec(
            "fake-options",
            "for tests",
            f"{__name__}:Still",
            cameras=("erp",),
            config=f"{__name__}:FakeConfig",
            presets={"quick": {"features": 10, "inner": {"gain": 0.1}}},
        )
    )
    return specs


@hookimpl
def register_datasets():
    return [DatasetSpec("tiny", "for tests", f"{__name__}:TinyDataset", needs_root=False)]


@hookimpl
def run_finished(folder, run):
    if "FAKE_HOOK" in os.environ:
        raise RuntimeError("a hook of a stranger")
