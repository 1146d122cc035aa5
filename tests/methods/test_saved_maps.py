"""Maps that stay: saved by one run, another finds its camera in it or goes on with it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from panobench.bench.records.record import read_record
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.cli.main import run as panobench
from panobench.datasets.files.trajectory_io import read_tum
from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.errors import UsageError
from panobench.geometry import umeyama
from panobench.maps.store import MapError, read_map

FRAMES = 24
WIDTH = 256


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of every other frame, ``run``, and the map it saved, ``map``."""
    folder = tmp_path_factory.mktemp("mapped")
    request = RunRequest(
        preset="fast", sequence="tiny", width=WIDTH, every=2, max_frames=FRAMES // 2, save_map=str(folder / "map")
    )
    execute(request, folder / "run")
    return folder


def errors_in_map(mapped: Path, run: Path) -> np.ndarray:
    """Distances (N,) of the run's positions from the truth, both in the map's frame, in the room's metres."""
    truth = RoomsDataset().open("tiny", width=WIDTH).groundtruth
    assert truth is not None
    made, found = read_tum(mapped / "run" / "trajectory.tum"), read_tum(run / "trajectory.tum")
    to_room = umeyama(made.positions, truth.positions[np.searchsorted(truth.times, made.times - 1e-6)])
    true = truth.positions[np.searchsorted(truth.times, found.times - 1e-6)]
    return np.linalg.norm(to_room.apply_points(found.positions) - true, axis=1)


@pytest.mark.slow
def test_frames_between_the_mapped_ones_are_found_in_the_map(mapped: Path, tmp_path: Path) -> None:
    words = ["localize", str(tmp_path), "--map", str(mapped / "map"), "--dataset", "disturbed"]
    words += ["--sequence", "rooms/tiny:noise=0.02", "--width", str(WIDTH), "--max-frames", str(FRAMES)]
    assert panobench([*words, "--out", str(tmp_path / "run"), "--quiet"]) == 0
    record = read_record(tmp_path / "run")
    assert record.frames.tracked == FRAMES
    assert errors_in_map(mapped, tmp_path / "run").max() < 0.02


@pytest.mark.slow
def test_another_camera_finds_itself_too(mapped: Path, tmp_path: Path) -> None:
    request = RunRequest(
        method="localise", sequence="tiny", camera="pinhole:front", fov="110x80", width=160, max_frames=8,
        continue_map=str(mapped / "map"),
    )  # fmt: skip
    record = read_record(execute(request, tmp_path / "run"))
    assert record.frames.tracked == 8
    assert errors_in_map(mapped, tmp_path / "run").max() < 0.05


@pytest.mark.slow
def test_frames_of_another_room_are_not_in_the_map(mapped: Path, tmp_path: Path) -> None:
    words = ["localize", str(tmp_path), "--map", str(mapped / "map"), "--dataset", "disturbed"]
    words += ["--sequence", "rooms/room3:noise=0.001"]
    words += ["--width", str(WIDTH), "--max-frames", "6", "--every", "10"]
    assert panobench([*words, "--out", str(tmp_path / "run"), "--quiet"]) == 1
    assert read_record(tmp_path / "run").frames.tracked == 0


@pytest.mark.slow
def test_a_map_is_gone_on_with(mapped: Path, tmp_path: Path) -> None:
    """The second walk goes beyond the first; its poses are in the first map's frame, which has grown."""
    before = read_map(mapped / "map")
    request = RunRequest(
        preset="fast", sequence="tiny", width=WIDTH, continue_map=str(mapped / "map"), save_map=str(tmp_path / "more")
    )
    record = read_record(execute(request, tmp_path / "run"))
    assert record.status == "ok"
    assert errors_in_map(mapped, tmp_path / "run").max() < 0.02
    after = read_map(tmp_path / "more")
    assert len(after.keyframes) > len(before.keyframes)
    for old, kept in zip(before.keyframes, after.keyframes):
        assert np.array_equal(old.image, kept.image)
        assert np.abs(old.T_wc - kept.T_wc).max() < 0.02 * before.scene_depth


@pytest.mark.slow
def test_another_camera_is_refused_for_mapping_on(mapped: Path, tmp_path: Path) -> None:
    request = RunRequest(sequence="tiny", width=128, continue_map=str(mapped / "map"))
    with pytest.raises(UsageError, match=r"256x128.*128x64"):
        execute(request, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_methods_without_maps_refuse_one(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="panogs"):
        execute(RunRequest(method="sparse", save_map=str(tmp_path / "m")), tmp_path / "run")
    with pytest.raises(UsageError, match="--continue"):
        execute(RunRequest(method="localise"), tmp_path / "run")
    with pytest.raises(MapError):
        execute(RunRequest(continue_map=str(tmp_path / "none")), tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_the_command_says_what_is_missing(tmp_path: Path) -> None:
    (tmp_path / "map.json").write_text(json.dumps({"format": "other"}))
    assert panobench(["localize", str(tmp_path / "walk.mp4"), "--map", str(tmp_path)]) == 2
