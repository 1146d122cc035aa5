"""The conformance suite finds what it is there to find."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench import CameraSpec, Estimate, MethodSpec, OnlineMethod, Trajectory
from panobench.errors import UnavailableError
from panobench.specs import load_object
from panobench.testing import FakeCamera, check_spec
from panobench.testing.conformance import run_checks


class Good(OnlineMethod):
    """Identity for every frame; the faulty ones below change one thing each."""

    def start(self, camera: Any, context: Any) -> None:
        self.context = context
        self.times: list[float] = []

    def pose(self) -> np.ndarray:
        return np.eye(4)

    def track(self, frame: Any) -> Any:
        self.times.append(frame.time)
        return self.pose()

    def finish(self) -> Estimate:
        T = np.stack([self.pose() for _ in self.times]) if self.times else np.zeros((0, 4, 4))
        return Estimate(Trajectory(np.array(self.times), T))


class Random(Good):
    def pose(self) -> np.ndarray:
        T = np.eye(4)
        T[0, 3] = np.random.default_rng().normal()
        return T


class Peeks(Good):
    def start(self, camera: Any, context: Any) -> None:
        super().start(camera, context)
        truth = context.work / "groundtruth.tum"
        truth.write_text("0 0 0 0 0 0 0 1\n")
        truth.read_text()


class Strays(Good):
    def track(self, frame: Any) -> Any:
        (self.context.work.parent / "elsewhere.txt").write_text("x")
        return super().track(frame)


class Chokes(Good):
    def track(self, frame: Any) -> Any:
        1 / int(frame.image.max() > 0)
        return super().track(frame)


class Moonlights(Good):
    def start(self, camera: Any, context: Any) -> None:
        super().start(camera, context)
        self.stop = threading.Event()
        self.thread = threading.Thread(target=self._work, daemon=True)
        self.thread.start()

    def _work(self) -> None:
        end = time.monotonic() + 20
        while not self.stop.is_set() and time.monotonic() < end:
            sum(range(1000))

    def finish(self) -> Estimate:
        self.stop.set()
        self.thread.join()
        return super().finish()


class Late(Good):
    def track(self, frame: Any) -> Any:
        self.times.append(frame.time + 0.01)
        return np.eye(4)


class NeedsAFrame(Good):
    def finish(self) -> Estimate:
        return Estimate(Trajectory(np.array(self.times), np.stack([np.eye(4) for _ in self.times])))


def spec(name: str, **changes: Any) -> MethodSpec:
    values: dict[str, Any] = {"licence": "CC0-1.0", **changes}
    return MethodSpec("faulty", "a method for this test", f"{__name__}:{name}", **values)


def failures(name: str, **changes: Any) -> dict[str, str]:
    return {c.name: c.message for c in check_spec(spec(name, **changes)) if c.outcome == "fail"}


def test_a_method_without_faults_passes() -> None:
    assert failures("Good") == {}


@pytest.mark.parametrize(
    ("name", "check", "words"),
    [
        ("Random", "determinism", "two runs with seed"),
        ("Peeks", "no ground truth", "groundtruth.tum"),
        ("Strays", "stays in its folder", "elsewhere.txt"),
        ("Chokes", "black frames", "ZeroDivisionError"),
        ("Moonlights", "timing", "work that counts as its time must happen inside track()"),
        ("Late", "answer", "no input frame's time"),
        ("NeedsAFrame", "stopped early", "ValueError"),
    ],
)
def test_each_fault_is_found_by_its_check(name: str, check: str, words: str) -> None:
    found = failures(name)
    assert words in found[check]


def test_one_fault_is_one_finding() -> None:
    assert set(failures("Random")) == {"determinism"}
    assert set(failures("Strays")) == {"stays in its folder"}


def test_a_method_that_admits_randomness_is_not_blamed() -> None:
    assert failures("Random", deterministic=False) == {}


def test_declarations_are_checked() -> None:
    assert "licence" in failures("Good", licence="")["declaration"]
    assert "contract 2.0" in failures("Good", contract="2.0")["declaration"]
    assert "needs has" in failures("Good", needs=("sonar",))["declaration"]


def test_a_method_that_cannot_run_is_skipped_with_its_reason() -> None:
    checks = check_spec(spec("Good", requires=("no_such_module",)))
    assert not [c for c in checks if c.outcome == "fail"]
    skipped = {c.name: c.message for c in checks if c.outcome == "skip"}
    assert "no_such_module" in skipped["answer"]


class CrookedCamera(FakeCamera):
    kind = "crooked"

    def jacobian(self, points: Any) -> Any:
        return 1.1 * super().jacobian(points)


def test_a_wrong_jacobian_is_found() -> None:
    checks = check_spec(CameraSpec("crooked", "for this test", f"{__name__}:CrookedCamera"))
    assert [c.name for c in checks if c.outcome == "fail"] == ["jacobian"]


def test_the_example_camera_conforms() -> None:
    checks = check_spec(CameraSpec("fake", "for tests", "panobench.testing.cameras:FakeCamera"))
    assert [c for c in checks if c.outcome != "pass"] == []


def test_nothing_is_left_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    check_spec(spec("Good"))
    assert not list(tmp_path.iterdir())


def test_a_failure_in_a_library_is_blamed_on_the_caller() -> None:
    def check() -> None:
        np.linalg.inv(np.zeros((2, 2)))

    (found,) = run_checks("a", [("b", check)])
    assert found.outcome == "fail"
    assert "test_conformance.py:" in found.message


def test_a_plugin_that_does_not_compile_is_named_in_one_line(tmp_path: Path, monkeypatch) -> None:
    (tmp_path / "with_a_slip.py").write_text("def f(:\n    pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(UnavailableError, match=r"method 'slip' cannot be loaded: SyntaxError at .*with_a_slip.py:1: "):
        load_object("with_a_slip:F", "method 'slip'")
