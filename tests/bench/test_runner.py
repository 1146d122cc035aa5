"""One run: what ends up in the folder for methods that behave and that do not, and that truth stays hidden."""

from __future__ import annotations

import csv
import json
import os
import signal
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench.bench.records.runfolder import read_run_json
from panobench.bench.run.observer import Observer
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import default_folder, execute
from panobench.bench.run.views import FrameReader, MethodSequence
from panobench.cameras.erp import ErpCamera
from panobench.datasets.files.trajectory_io import read_tum
from panobench.errors import PanobenchError, UnavailableError, UnknownNameError, UnsupportedError, UsageError
from panobench.metrics.base import PROTOCOL_VERSION
from panobench.plugins import PluginWarning
from panobench.testing import GivenImages

pytestmark = pytest.mark.usefixtures("fake_plugin")


def run(tmp_path: Path, method: str, **options: Any) -> tuple[Path, dict[str, Any]]:
    request = RunRequest(method=f"fake-{method}", dataset="tiny", **{"width": 128, **options})
    folder = execute(request, tmp_path / "out" / method)
    return folder, read_run_json(folder)


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def left_over(tmp_path: Path) -> list[str]:
    return [p.name for p in (tmp_path / "out").iterdir() if p.name.startswith(".")]


def test_a_whole_run(tmp_path: Path) -> None:
    folder, run_json = run(tmp_path, "still", holdout=4, seed=3)
    assert run_json["status"] == "ok"
    assert sorted(p.name for p in folder.iterdir()) == [
        "frames.csv",
        "groundtruth.tum",
        "log.txt",
        "renders",
        "run.json",
        "trajectory.tum",
    ]
    assert left_over(tmp_path) == []
    assert len(read_tum(folder / "trajectory.tum")) == 12
    table = rows(folder)
    assert [int(r["index"]) for r in table if r["mappable"] == "0"] == [3, 7, 11]
    assert float(table[1]["loss"]) == pytest.approx(0.5)
    assert all(float(r["latency_s"]) >= 0 for r in table)
    metrics, timing = run_json["metrics"], run_json["timing"]
    assert metrics["tracked"] == 1.0
    assert 0.001 < metrics["ate_rmse_m"] < 0.2
    for name in ("psnr_db", "ssim", "pano_psnr_db", "ws_psnr_db", "holdout_psnr_db", "novel_psnr_db"):
        assert metrics[name] is not None, name
    assert metrics["lpips"] is None
    assert "n/a" in run_json["notes"]["lpips"]
    assert timing["tracking_fps"] == pytest.approx(1000)  # the method says 1 ms per frame
    assert timing["fps"] > 0
    assert timing["peak_rss_bytes"] > 10 << 20
    provenance = run_json["provenance"]
    assert provenance["dataset"]["generator"] == "tiny"
    assert provenance["packages"]["numpy"] == np.__version__
    assert provenance["machine"]["cpu"]
    assert run_json["method"]["origin"] == "panobench-fake 1.5"
    assert run_json["depth"] == {"source": None, "oracle": False, "poses_given": False}
    assert run_json["protocol"] == PROTOCOL_VERSION
    assert "--holdout 4" in provenance["command"]
    renders = {p.name for p in (folder / "renders").iterdir()}
    assert {"000000.jpg", "000000_gt.jpg", "000011.jpg", "novel_000.jpg", "novel_000_gt.jpg"} <= renders


def test_the_map_rendered_from_true_poses_scores_perfectly(tmp_path: Path) -> None:
    _, run_json = run(tmp_path, "poses", holdout=4, width=256)
    metrics = run_json["metrics"]
    assert metrics["ate_rmse_m"] < 1e-9
    assert metrics["ate_keyframes_rmse_m"] < 1e-9
    assert run_json["metric"] is True
    assert run_json["depth"]["poses_given"] is True
    # only the rounding to eight bits separates render and image
    for name in ("pano_psnr_db", "ws_psnr_db", "holdout_psnr_db", "novel_psnr_db"):
        assert metrics[name] > 50, name
    # the reference views are cut out of the images by interpolation
    assert metrics["psnr_db"] > 45
    assert metrics["ssim"] > 0.995


def test_every_and_max_frames_choose_frames(tmp_path: Path) -> None:
    folder, run_json = run(tmp_path, "still", every=3, max_frames=3)
    table = rows(folder)
    assert [r["name"] for r in table] == ["000000", "000003", "000006"]
    assert [float(r["time"]) for r in table] == pytest.approx([0.0, 0.3, 0.6])
    assert run_json["frames"] == {"given": 3, "planned": 3, "tracked": 3, "held_out": 0}


@pytest.mark.parametrize(
    ("method", "status", "says", "given"),
    [
        ("crash", "crashed", "frame 3: ValueError: three is my limit", 3),
        ("nan-pose", "crashed", "frame 2: track() returned a pose that is not finite", 3),
        ("skewed", "crashed", "frame 0: track() returned a pose that is not rigid", 1),
        ("loses-track", "lost", "tracked 33.3% of the frames", 12),
    ],
)
def test_failures_are_runs_with_a_status(tmp_path: Path, method: str, status: str, says: str, given: int) -> None:
    folder, run_json = run(tmp_path, method)
    assert run_json["status"] == status
    assert says in run_json["message"]
    assert "\n" not in run_json["message"]
    assert run_json["frames"]["given"] == given
    assert len(rows(folder)) == given
    if status == "crashed":
        assert run_json["metrics"]["ate_rmse_m"] is None
        assert "Traceback" in (folder / "log.txt").read_text()


def test_warming_up_is_not_timed_and_late_compilation_is_told(tmp_path: Path) -> None:
    import numba  # noqa: F401 - as it is imported by built-in methods

    _, run_json = run(tmp_path, "compiles-late")
    timing = run_json["timing"]
    assert timing["prepare_s"] >= 0.3
    assert timing["start_s"] < 0.3
    assert timing["late_compile_s"] > 0
    if timing["late_compile_s"] > 0.1:
        assert any("compiling kernels (kernel_of_a_plugin)" in remark for remark in run_json["remarks"])
    _, quiet = run(tmp_path, "still")
    assert quiet["timing"]["late_compile_s"] == 0


def test_methods_see_no_truth(tmp_path: Path) -> None:
    folder, run_json = run(tmp_path, "peeks")
    assert run_json["status"] == "ok", run_json["message"]
    # the method blackened its images; those kept for scoring are untouched
    import cv2

    assert cv2.imread(str(folder / "renders" / "000000_gt.jpg")).mean() > 50
    _, batch = run(tmp_path, "batch", holdout=3)
    assert batch["status"] == "ok", batch["message"]
    assert batch["extra"]["mapped"] == [0, 1, 3, 4, 6, 7, 9, 10]
    assert batch["timing"]["fps"] == pytest.approx(batch["timing"]["tracking_fps"])
    assert 0.3 <= batch["timing"]["start_s"] < batch["timing"]["wall_s"]
    busy = batch["frames"]["given"] / batch["timing"]["fps"]
    assert busy <= batch["timing"]["wall_s"] - batch["timing"]["start_s"] + 1e-6


def test_methods_do_not_see_what_the_mask_hides() -> None:
    camera = ErpCamera(64, 32)
    mask = np.ones((32, 64), dtype=bool)
    mask[20:] = False
    image = np.full((32, 64, 3), 200, np.uint8)
    sequence = GivenImages(camera.with_mask(mask), [image])
    read = FrameReader(sequence)
    assert set(np.unique(read(0).image[:20])) == {200}
    assert set(np.unique(read(0).image[20:])) == {0}
    assert set(np.unique(MethodSequence(sequence).image(0)[20:])) == {0}
    assert sequence.image(0).min() == 200


def test_depth_goes_to_those_who_declare_it(tmp_path: Path) -> None:
    _, oracle = run(tmp_path, "wants-depth", depth="oracle")
    assert oracle["extra"]["depths"] == [True] + [False] * 11
    assert oracle["depth"]["oracle"] is True
    assert oracle["spec"]["depth"] == "oracle"
    _, sensor = run(tmp_path, "depth", depth="constant")
    assert sensor["extra"]["depths"] == [True] * 12
    assert sensor["depth"]["oracle"] is True
    (tmp_path / "again").mkdir()
    _, blind = run(tmp_path / "again", "wants-depth", depth="constant:1.5")
    assert blind["extra"]["depths"] == [False] * 12
    assert blind["depth"] == {"source": "constant:1.5", "oracle": False, "poses_given": False}


class Interrupts(Observer):
    """Sends Ctrl-C after the third frame."""

    def frame(self, index: int, time: float, T_wc: Any, latency_s: float) -> None:
        if index == 2:
            os.kill(os.getpid(), signal.SIGINT)


def test_interrupting_keeps_what_was_tracked(tmp_path: Path) -> None:
    before = signal.getsignal(signal.SIGINT)
    request = RunRequest(method="fake-still", dataset="tiny", width=128)
    folder = execute(request, tmp_path / "out", observer=Interrupts())
    run_json = read_run_json(folder)
    assert run_json["status"] == "interrupted"
    assert run_json["frames"]["given"] == 3
    assert len(read_tum(folder / "trajectory.tum")) == 3
    assert run_json["metrics"]["tracked"] == 1.0
    assert signal.getsignal(signal.SIGINT) is before


class InterruptsTwice(Interrupts):
    def stage(self, text: str) -> None:
        if text == "finishing":
            os.kill(os.getpid(), signal.SIGINT)


def test_a_second_interrupt_skips_finish_and_keeps_live_poses(tmp_path: Path) -> None:
    request = RunRequest(method="fake-still", dataset="tiny", width=128)
    folder = execute(request, tmp_path / "out", observer=InterruptsTwice())
    run_json = read_run_json(folder)
    assert run_json["status"] == "interrupted"
    assert run_json["keyframes"] == []
    assert len(read_tum(folder / "trajectory.tum")) == 3


class Hammers(Interrupts):
    """Ctrl-C again and again: while finishing, scoring and writing."""

    def __init__(self) -> None:
        self.told = 0

    def interrupted(self) -> None:
        self.told += 1

    def stage(self, text: str) -> None:
        if text in ("finishing", "writing"):
            for _ in range(3):
                os.kill(os.getpid(), signal.SIGINT)


def test_many_interrupts_still_keep_the_poses(tmp_path: Path) -> None:
    before, observer = signal.getsignal(signal.SIGINT), Hammers()
    folder = execute(RunRequest(method="fake-still", dataset="tiny", width=128), tmp_path / "out", observer=observer)
    assert read_run_json(folder)["status"] == "interrupted"
    assert len(read_tum(folder / "trajectory.tum")) == 3
    assert observer.told == 1
    assert signal.getsignal(signal.SIGINT) is before


def test_an_interrupted_method_may_know_more_than_it_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses that ``track`` could not give at the time, and none that is no pose."""
    from panobench.methods.base import OnlineMethod

    known: dict[int, Any] = {0: np.eye(4), 1: np.eye(4), 7: np.eye(4)}
    monkeypatch.setattr(OnlineMethod, "known_poses", lambda self: known)
    request = RunRequest(method="fake-still", dataset="tiny", width=128)
    folder = execute(request, tmp_path / "out", observer=InterruptsTwice())
    assert len(read_tum(folder / "trajectory.tum")) == 2
    known[1] = np.full((4, 4), np.nan)
    folder = execute(request, tmp_path / "again", observer=InterruptsTwice())
    assert len(read_tum(folder / "trajectory.tum")) == 3  # those that track() gave


@pytest.mark.parametrize(
    ("method", "options", "error", "says"),
    [
        ("stil", {}, UnknownNameError, "did you mean 'fake-still'"),
        ("still", {"sequence": "broken"}, PanobenchError, "broken/000005.png, frame 5: the image is truncated"),
        ("still", {"sequence": "empty"}, PanobenchError, "has no frames"),
        ("still", {"sequence": "z"}, UnknownNameError, "unknown sequence 'z'"),
        ("still", {"camera": "pinhol"}, UnknownNameError, "did you mean 'pinhole'"),
        ("still", {"camera": "pal"}, UnsupportedError, "it takes erp, pinhole"),
        ("still", {"depth": "orakle"}, UnknownNameError, "did you mean 'oracle'"),
        ("still", {"depth": "oracle:3"}, UsageError, "takes no argument"),
        ("options", {"settings": {"featurs": "3"}}, UnknownNameError, "did you mean 'features'"),
        ("options", {"preset": "quik"}, UnknownNameError, "did you mean 'quick'"),
        ("absent", {}, UnavailableError, "no_such_package"),
    ],
)
def test_bad_input_writes_nothing(
    tmp_path: Path, method: str, options: dict[str, Any], error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        run(tmp_path, method, **options)
    assert not (tmp_path / "out").exists() or list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize("values", [{"every": 0}, {"max_frames": 0}, {"holdout": 1}, {"seed": -1}, {"width": 3}])
def test_impossible_requests(values: dict[str, int]) -> None:
    with pytest.raises(UsageError, match="--" + next(iter(values)).replace("_", "-")):
        RunRequest(**values)  # type: ignore[arg-type]


def test_a_request_survives_json() -> None:
    request = RunRequest(method="sparse", settings={"a.b": [1, 2]}, max_frames=7, fov="120x60")
    assert RunRequest.from_dict(json.loads(json.dumps(request.to_dict()))) == request
    assert "--set a.b=1,2" in " ".join(request.command())
    with pytest.raises(UnknownNameError, match="did you mean 'method'"):
        RunRequest.from_dict({"methd": "sparse"})


def test_same_seed_same_files(tmp_path: Path) -> None:
    first, one = run(tmp_path / "1", "still", seed=5)
    second, two = run(tmp_path / "2", "still", seed=5)
    assert (first / "trajectory.tum").read_bytes() == (second / "trajectory.tum").read_bytes()
    assert one["metrics"] == two["metrics"]
    other, _ = run(tmp_path / "3", "still", seed=6)
    assert (first / "trajectory.tum").read_bytes() != (other / "trajectory.tum").read_bytes()


@pytest.mark.parametrize(
    ("options", "kind", "size"),
    [
        ({"camera": "pinhole", "width": 96}, "pinhole", (96, 32)),
        ({"camera": "pinhole:left", "width": 90, "fov": "90x60"}, "pinhole", (90, 52)),
        ({"camera": "erp", "width": 64, "fov": "200"}, "erp", (64, 32)),
    ],
)
def test_another_camera_than_the_datasets(
    tmp_path: Path, options: dict[str, Any], kind: str, size: tuple[int, int]
) -> None:
    import cv2

    folder, run_json = run(tmp_path, "still", **options)
    assert run_json["status"] == "ok"
    model = run_json["spec"]["camera_model"]
    assert (model["model"], model["width"], model["height"]) == (kind, *size)
    assert cv2.imread(str(folder / "renders" / "000000_gt.jpg")).shape == (size[1], size[0], 3)
    assert run_json["provenance"]["dataset"]["conversion"]["source_camera"]["width"] == 128


def test_a_failing_hook_does_not_end_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FAKE_HOOK", "1")
    with pytest.warns(PluginWarning, match="run_finished hook failed: RuntimeError"):
        _, run_json = run(tmp_path, "still")
    assert run_json["status"] == "ok"


def test_runs_from_a_thread(tmp_path: Path) -> None:
    """Signals can only be handled in the main thread; elsewhere the run must still work."""
    found: list[str] = []
    thread = threading.Thread(target=lambda: found.append(run(tmp_path, "still")[1]["status"]))
    thread.start()
    thread.join()
    assert found == ["ok"]


def test_default_folders_do_not_collide(tmp_path: Path) -> None:
    request = RunRequest(method="m", camera="pinhole:-90,10", dataset="tiny", sequence="../x")
    first = default_folder(request, tmp_path)
    assert first.parent == tmp_path
    first.mkdir()
    second = default_folder(request, tmp_path)
    assert second != first
