"""Which frame a pose belongs to: by image name, frame number and time; and what is said where it is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.bench.run.views import ChosenFrames
from panobench.errors import InputError
from panobench.testing import TinySequence
from panobench.trajectories.matching import Frames, place
from panobench.trajectories.posed import PoseList

TIMES = np.arange(24) / 15
FILE = Path("theirs.txt")


def poses(n: int) -> np.ndarray:
    """Each tells its number by its x."""
    T = np.tile(np.eye(4), (n, 1, 1))
    T[:, 0, 3] = np.arange(n)
    return T


def by_time(times: np.ndarray) -> PoseList:
    return PoseList(poses(len(times)), "tum", times=np.asarray(times, dtype=float))


def by_name(*names: str) -> PoseList:
    return PoseList(poses(len(names)), "colmap", names=names)


def by_number(numbers: list[int], counted: bool = False) -> PoseList:
    return PoseList(poses(len(numbers)), "monogs", numbers=np.array(numbers), counted=counted)


# -- times -----------------------------------------------------------------------------------------------------------


def test_times_find_the_nearest_frame() -> None:
    found = place(by_time(TIMES[::2] + 0.004), Frames(TIMES), FILE)
    assert found.index.tolist() == list(range(0, 24, 2))
    assert found.trajectory.times.tolist() == TIMES[::2].tolist()
    assert (found.unplaced, found.remarks) == (0, ())


def test_poses_without_a_frame_are_counted() -> None:
    found = place(by_time(np.r_[TIMES, TIMES[-1] + 1, TIMES[-1] + 2]), Frames(TIMES), FILE)
    assert found.remarks == ("2 of 26 poses belong to no frame",)
    assert found.counts() == "2 of 26 poses belong to no frame"


@pytest.mark.parametrize(
    ("times", "offer"),
    [
        (np.arange(24), "22 of 24 poses belong to no frame: .*they look like frame numbers: add --time-unit frames"),
        (np.arange(1, 25), r"look like frame numbers \(from 1\): add --time-unit frames"),
        (np.arange(0, 24, 4), "look like frame numbers: add --time-unit frames"),
        (TIMES * 1e3, "23 of 24 poses belong to no frame: .*they look like milliseconds: add --time-unit ms"),
        (TIMES * 1e6 + 5e9, "they look like microseconds: add --time-unit us --time-offset -5000"),
        (TIMES + 1.7e9, r"they look like seconds of another clock: add --time-offset -1.7e\+09"),
        (TIMES * 0.1 - 50, "none of its 24 poses is within .*shift them with --time-offset"),
    ],
)
def test_times_that_mean_something_else_are_recognised(times: np.ndarray, offer: str) -> None:
    with pytest.raises(InputError, match=offer):
        place(by_time(times), Frames(TIMES), FILE)


def test_an_offset_and_a_tolerance() -> None:
    assert len(place(by_time(TIMES + 3), Frames(TIMES), FILE, time_offset=-3).index) == 24
    assert len(place(by_time(TIMES + 0.2), Frames(TIMES), FILE, max_dt=0.3).index) >= 21


# -- frame numbers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("numbers", "index"),
    [
        (list(range(24)), list(range(24))),
        (list(range(1, 25)), list(range(24))),  # counted from 1
        ([0, 5, 23], [0, 5, 23]),
        ([6, 12, 18], [6, 12, 18]),  # each sixth from 0, the first left out
        ([7, 13, 19], [6, 12, 18]),  # each sixth from 1
        ([3, 1, 0], [0, 1, 3]),
    ],
)
def test_frame_numbers(numbers: list[int], index: list[int]) -> None:
    assert place(by_number(numbers), Frames(TIMES), FILE).index.tolist() == index


def test_frame_numbers_of_the_whole_recording() -> None:
    """Frames chosen with --every are found by their own numbers, and by the whole recording's."""
    frames = Frames.of(ChosenFrames(TinySequence(n=24), every=3))
    assert place(by_number(list(range(8))), frames, FILE).index.tolist() == list(range(8))
    assert place(by_number(list(range(0, 24, 3))), frames, FILE).index.tolist() == list(range(8))


def test_poses_that_only_count_must_be_as_many_as_the_frames() -> None:
    assert len(place(by_number(list(range(24)), counted=True), Frames(TIMES), FILE).index) == 24
    with pytest.raises(InputError, match=r"12 poses for 24 frames, and no times: say which frames .* --every"):
        place(by_number(list(range(12)), counted=True), Frames(TIMES), FILE)
    with pytest.raises(InputError, match="none of its 2 poses belongs to a frame: they are numbered 100 to 101"):
        place(by_number([100, 101]), Frames(TIMES), FILE)


# -- image names -----------------------------------------------------------------------------------------------------

NAMES = ["a.png", "b.png", "c10.png", "c9.png"]


@pytest.mark.parametrize(
    "names",
    [
        ["a.png", "b.png", "c10.png", "c9.png"],
        ["images/a.png", "./images/b.png", "images\\c10.png", "/data/images/c9.png"],
        ["a.jpg", "images/b", "./c10", "c9.JPG"],
    ],
)
def test_image_names(names: list[str]) -> None:
    found = place(by_name(*names), Frames(np.arange(4.0), NAMES), FILE)
    assert found.index.tolist() == [0, 1, 2, 3]
    assert found.trajectory.positions[:, 0].tolist() == [0, 1, 2, 3]


def test_the_order_of_the_file_does_not_matter_and_some_may_be_missing() -> None:
    found = place(by_name("c9.png", "other.png", "a.png"), Frames(np.arange(4.0), NAMES), FILE)
    assert found.index.tolist() == [0, 3]
    assert found.trajectory.positions[:, 0].tolist() == [2, 0]
    assert found.remarks == ("1 of 3 poses belong to no frame",)


def test_two_cameras_of_one_frame_are_refused() -> None:
    with pytest.raises(InputError, match=r"'left/a.png' and 'right/a.png' belong to the same frame"):
        place(by_name("left/a.png", "right/a.png"), Frames(np.arange(4.0), NAMES), FILE)


def test_names_of_a_videos_extracted_frames() -> None:
    """A video's frames have no names: the numbers count, from 0 or from 1 as ffmpeg does."""
    frames = Frames.of(TinySequence(n=24))
    assert frames.names is None
    zero = place(by_name(*(f"f_{i:04d}.png" for i in range(24))), frames, FILE)
    one = place(by_name(*(f"{i:06d}.png" for i in range(1, 25))), frames, FILE)
    assert zero.index.tolist() == one.index.tolist() == list(range(24))
    assert zero.remarks == ("images are matched to frames by their numbers, counted from 0",)
    assert one.remarks == ("images are matched to frames by their numbers, counted from 1",)
    sixth = place(by_name(*(f"{i:06d}.png" for i in range(0, 24, 6))), frames, FILE)
    assert sixth.index.tolist() == [0, 6, 12, 18]


def test_a_guess_among_numbers_is_not_made() -> None:
    """Twelve images numbered in a row may be each second of 24 frames, or the first twelve."""
    with pytest.raises(InputError, match=r"numbered 1 to 12 for 24 frames: .*--every \(perhaps 2\) or --max-frames"):
        place(by_name(*(f"{i:03d}.png" for i in range(1, 13))), Frames.of(TinySequence(n=24)), FILE)
    every = Frames.of(ChosenFrames(TinySequence(n=24), every=2))
    assert len(place(by_name(*(f"{i:03d}.png" for i in range(1, 13))), every, FILE).index) == 12


@pytest.mark.parametrize("names", [["x.png", "y.png"], ["a1b.png", "c2.png"], [f"{i}.png" for i in range(500, 520)]])
def test_names_that_are_no_frames(names: list[str]) -> None:
    with pytest.raises(InputError, match="called like none of the 24 frames"):
        place(by_name(*names), Frames.of(TinySequence(n=24)), FILE)
