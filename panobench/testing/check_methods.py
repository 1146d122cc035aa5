"""Conformance of methods: contract, determinism for a seed, no ground truth, failure behaviour, timing."""

from __future__ import annotations

import dataclasses
import gc
import json
import os
import tempfile
import threading
from functools import cached_property
from pathlib import Path

import numpy as np

from panobench import kernel_cache
from panobench.bench.run.config import override
from panobench.cameras.base import Camera
from panobench.datasets.base import FrameSequence
from panobench.errors import PanobenchError
from panobench.methods.base import BatchMethod, OnlineMethod
from panobench.options import option_names
from panobench.plugins import registry, same_contract
from panobench.specs import CONTRACT_VERSION, CameraSpec, DepthSpec, MethodSpec, load_object
from panobench.testing.check_cameras import example_camera
from panobench.testing.conformance import Checks, Failed, Options, Skipped, require
from panobench.testing.running import MethodRun, make_method, run_method
from panobench.testing.sequences import GivenImages, TinySequence, erp_camera, two_lenses
from panobench.testing.watching import Watched, watch_files
from panobench.types import Estimate

NEEDS = {"rgb", "imu", "depth", "poses"}
IDLE_S = 0.02
MAX_IDLE_SHARE = 0.25


class _Subject:
    """A method spec under test; its first run on the tiny sequence is shared by several checks."""

    def __init__(self, spec: MethodSpec, options: Options, unavailable: str | None) -> None:
        self.spec, self.options, self.unavailable = spec, options, unavailable

    @cached_property
    def camera(self) -> Camera:
        cameras = registry().specs(CameraSpec)
        for kind in self.spec.cameras:
            if kind in cameras and cameras[kind].unavailable() is None:
                camera = example_camera(cameras[kind].load(), kind, width=128)
                if camera is not None:
                    return camera
        raise Skipped(f"no example camera of the kinds {', '.join(self.spec.cameras)}")

    @cached_property
    def sequence(self) -> TinySequence:
        return TinySequence(self.camera, n=8)

    def make(self) -> OnlineMethod | BatchMethod:
        if self.unavailable is not None:
            raise Skipped(self.unavailable)
        if self.spec.needs_map:
            raise Skipped("it needs a saved map, which these checks do not make")
        return make_method(self.spec, preset=self.options.preset)

    def run(self, sequence: FrameSequence, work: Path | None = None, idle_s: float = 0.0) -> MethodRun:
        return run_method(
            self.make(),
            sequence,
            seed=self.options.seed,
            work=work,
            make_depth=lambda: registry().get(DepthSpec, "constant").load()(""),
            needs=self.spec.needs,
            idle_s=idle_s,
            rigs=self.spec.rigs,
        )

    @cached_property
    def first(self) -> tuple[MethodRun, Watched, Path]:
        self.make()  # imports, so that their file accesses are not the method's
        with tempfile.TemporaryDirectory(prefix="panobench-") as folder:
            work = Path(folder) / "work"
            work.mkdir()
            with watch_files() as watched:
                run = self.run(self.sequence, work)
            return run, watched, work


def method_checks(spec: MethodSpec, options: Options, unavailable: str | None) -> Checks:
    """The checks of one method; those that run it are skipped where it cannot run."""
    s = _Subject(spec, options, unavailable)
    return [
        ("declaration", lambda: _declaration(spec)),
        ("implementation", lambda: _implementation(spec, unavailable)),
        ("answer", lambda: _answer(s)),
        ("determinism", lambda: _determinism(s)),
        ("no ground truth", lambda: _no_ground_truth(s)),
        ("stays in its folder", lambda: _stays(s)),
        ("black frames", lambda: _black(s)),
        ("one frame", lambda: _one_frame(s)),
        ("rig", lambda: _rig(s)),
        ("stopped early", lambda: _stopped_early(s)),
        ("timing", lambda: _timing(s)),
    ]


def _declaration(spec: MethodSpec) -> str:
    require(spec.cameras, "cameras is empty")
    unknown = set(spec.needs) - NEEDS
    require(not unknown, f"needs has {sorted(unknown)}; known are {sorted(NEEDS)}")
    require(set(spec.uses) <= {"imu"}, f"uses has {sorted(set(spec.uses) - {'imu'})}; known is imu")
    require(spec.licence, "licence is empty: name the licence of the method's code")
    require(
        same_contract(spec.contract), f"written for contract {spec.contract}, this panobench has {CONTRACT_VERSION}"
    )
    return f"contract {spec.contract}, cameras {', '.join(spec.cameras)}"


def _implementation(spec: MethodSpec, unavailable: str | None) -> str | None:
    if unavailable is not None and spec.requires:
        raise Skipped(unavailable)
    cls = spec.load()
    require(
        isinstance(cls, type) and issubclass(cls, (OnlineMethod, BatchMethod)),
        f"{spec.implementation} is neither an OnlineMethod nor a BatchMethod",
    )
    if spec.config is None:
        require(not spec.presets, "it has presets but names no config")
        return None
    config = load_object(spec.config, f"config of method '{spec.name}'")
    require(dataclasses.is_dataclass(config), f"{spec.config} is not a dataclass")
    known = set(option_names(config()))
    for preset, values in spec.presets.items():
        require(set(values) <= known, f"preset '{preset}' sets {sorted(set(values) - known)}, not in {spec.config}")
        override(config(), values, f"preset '{preset}'")
    config()
    return None


def check_estimate(estimate: Estimate, sequence: FrameSequence) -> None:
    """Fail unless an estimate keeps the contract for this sequence."""
    require(isinstance(estimate, Estimate), f"the answer is a {type(estimate).__name__}, not an Estimate")
    t, T = np.asarray(estimate.trajectory.times), np.asarray(estimate.trajectory.T_wc)
    require(T.shape == (len(t), 4, 4), f"T_wc has shape {T.shape} for {len(t)} times, must be (N, 4, 4)")
    require((np.diff(t) > 0).all(), "the trajectory's times are not strictly increasing")
    require(np.isin(t, sequence.times).all(), "the trajectory has times that are no input frame's time")
    require(np.isfinite(T).all(), "the trajectory has NaN or infinite poses; leave frames without a pose out")
    if len(t):
        R = T[:, :3, :3]
        require(np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-4, "a pose's 3x3 part is no rotation")
        require((np.linalg.det(R) > 0).all(), "a pose's 3x3 part is a reflection")
        require((T[:, 3] == [0, 0, 0, 1]).all(), "a pose's last row is not 0 0 0 1")
    outside = [k for k in estimate.keyframes if not 0 <= k < len(sequence)]
    require(not outside, f"keyframes {outside} are no input frames")
    try:
        json.dumps(estimate.extra, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise Failed(f"extra cannot be written to run.json: {error}") from error


def _answer(s: _Subject) -> str:
    run, _, _ = s.first
    check_estimate(run.estimate, s.sequence)
    for index, pose in enumerate(run.live):
        require(
            pose is None or (np.shape(pose) == (4, 4) and np.isfinite(pose).all()),
            f"track() returned neither None nor a finite 4x4 pose for frame {index}",
        )
    return f"{len(run.estimate.trajectory)} of {len(s.sequence)} frames have a pose"


def _determinism(s: _Subject) -> str | None:
    if not s.spec.deterministic:
        s.make()
        raise Skipped("its spec says that it is not deterministic")
    a, b = s.first[0].estimate.trajectory, s.run(s.sequence).estimate.trajectory
    same = np.array_equal(a.times, b.times) and np.array_equal(a.T_wc, b.T_wc)
    require(same, f"two runs with seed {s.options.seed} differ; take all randomness from context.seed")
    return None


def _no_ground_truth(s: _Subject) -> str | None:
    run, watched, _ = s.first
    asked = [a for a in run.asked if not (a == "depth" and "depth" in s.spec.needs)]
    require(not asked, f"it asks the sequence for {', '.join(sorted(set(asked)))}, which methods do not get")
    looked = [p for p in watched.read if p.name.lower().startswith(("groundtruth", "ground_truth", "gt."))]
    require(not looked, f"it opens {', '.join(map(str, looked))}")
    return None


def _stays(s: _Subject) -> str | None:
    _, watched, work = s.first
    kernels = os.environ.get(kernel_cache.VARIABLE)
    outside = watched.written_outside(work, Path.home() / ".cache", *([Path(kernels)] if kernels else []))
    require(not outside, f"it writes outside its work folder: {', '.join(map(str, outside[:3]))}")
    return "as far as Python's audit events show"


def _ends_cleanly(s: _Subject, sequence: FrameSequence, what: str) -> str:
    s.make()
    try:
        run = s.run(sequence)
    except PanobenchError as error:
        require("\n" not in str(error), f"{what}: the error's message has more than one line")
        return f"says: {error}"
    except Exception as error:
        raise Failed(
            f"{what}: raises {type(error).__name__}: {error}; answer None or raise a PanobenchError"
        ) from error
    check_estimate(run.estimate, sequence)
    return f"{len(run.estimate.trajectory)} of {len(sequence)} frames have a pose"


def _black(s: _Subject) -> str:
    image = np.zeros((s.camera.height, s.camera.width, 3), np.uint8)
    return _ends_cleanly(s, GivenImages(s.camera, [image] * 4, "black"), "four black frames")


def _one_frame(s: _Subject) -> str:
    return _ends_cleanly(s, GivenImages(s.camera, [s.sequence.image(0)], "one"), "a sequence of one frame")


def _rig(s: _Subject) -> str:
    if not s.spec.rigs:
        raise Skipped("its spec does not say that it takes rigs")
    require("erp" in s.spec.cameras, "it takes rigs, whose camera is a panorama, but 'erp' is not among its cameras")
    return _ends_cleanly(s, TinySequence(erp_camera(128), n=8, rig=two_lenses()), "a rig of two lenses")


def _stopped_early(s: _Subject) -> str | None:
    if isinstance(s.make(), BatchMethod):
        raise Skipped("a batch method is not asked to finish early")
    empty = GivenImages(s.camera, [], "empty")
    run = s.run(empty)
    check_estimate(run.estimate, empty)
    return None


def _timing(s: _Subject) -> str:
    if isinstance(s.make(), BatchMethod):
        raise Skipped("a batch method is timed as a whole")
    gc.collect()
    before = threading.active_count()
    run = s.run(s.sequence, idle_s=IDLE_S)
    idle = run.idle_cpu_s / (IDLE_S * len(s.sequence))
    require(
        idle < MAX_IDLE_SHARE,
        f"it works between the calls of track(): {idle:.0%} of a processor while it should rest; "
        "work that counts as its time must happen inside track()",
    )
    left = threading.active_count() - before
    require(left <= 0, f"{left} thread(s) still run after finish()")
    return (
        f"median {np.median(run.latency) * 1e3:.1f} ms per 128 px wide frame, {idle:.0%} of a processor between calls"
    )
