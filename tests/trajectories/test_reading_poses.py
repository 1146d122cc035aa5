"""Trajectories in other programs' files: each holds the same poses, and they come back as they were."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from panobench.datasets.files.trajectory_io import rows_from_poses, tum_text
from panobench.errors import DatasetError, InputError, PanobenchError, UsageError
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.trajectories.reading import read_poses, recognise
from panobench.types import Trajectory

N = 5
RNG = np.random.default_rng(3)
T_WC = make_pose(so3_exp(RNG.normal(scale=0.8, size=(N, 3))), RNG.normal(size=(N, 3)))
NAMES = [f"cam/{i:03d}.png" for i in range(N)]
#: World-to-camera as COLMAP writes it: qw qx qy qz tx ty tz.
_CW = rows_from_poses(invert_pose(T_WC))
COLMAP = np.concatenate([_CW[:, [6, 3, 4, 5]], _CW[:, :3]], axis=1)
GL = np.diag([1.0, -1.0, -1.0, 1.0])


def numbers(row: np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in row)


def images_txt(points: str = "1.0 2.0 -1 3.5 4.5 7\n") -> str:
    head = "# Image list with two lines of data per image:\n#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n"
    return head + "".join(f"{i + 1} {numbers(COLMAP[i])} 1 {NAMES[i]}\n{points}" for i in range(N))


def images_bin() -> bytes:
    data = struct.pack("<Q", N)
    for i in range(N):
        data += struct.pack("<I7dI", i + 1, *COLMAP[i], 1) + NAMES[i].encode() + b"\0"
        data += struct.pack("<Q", i) + struct.pack("<2dQ", 1.0, 2.0, 2**64 - 1) * i
    return data


def transforms(**more: object) -> str:
    frames = [{"file_path": name, "transform_matrix": (T @ GL).tolist()} for name, T in zip(NAMES, T_WC)]
    return json.dumps({"camera_model": "EQUIRECTANGULAR", "w": 64, "h": 32, "frames": frames, **more})


@pytest.mark.parametrize(
    ("name", "content", "format"),
    [
        ("images.txt", images_txt(), "colmap"),
        ("images.txt", images_txt("\n"), "colmap"),  # no points: an empty line
        ("images.txt", images_txt(""), "colmap"),  # or none, as some programs leave it out
        ("images.bin", images_bin(), "colmap"),
        ("transforms.json", transforms(), "transforms"),
        ("poses", transforms(), "transforms"),
    ],
)
def test_poses_by_image_name(tmp_path: Path, name: str, content: str | bytes, format: str) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    found = read_poses(tmp_path / name)
    assert (found.format, found.names, found.scaled) == (format, tuple(NAMES), False)
    assert found.T_wc == pytest.approx(T_WC, abs=1e-12)


def test_a_folder_is_a_colmap_model(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"without images.bin or images.txt"):
        read_poses(tmp_path)
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    (tmp_path / "sparse" / "0" / "images.bin").write_bytes(images_bin())
    for folder in (tmp_path, tmp_path / "sparse", tmp_path / "sparse" / "0"):
        if folder.name != "sparse":
            assert read_poses(folder).names == tuple(NAMES)


def test_names_with_spaces_and_numbers(tmp_path: Path) -> None:
    path = tmp_path / "images.txt"
    path.write_text(
        f"1 {numbers(COLMAP[0])} 1 my room 1.png\n1 2 -1\n2 {numbers(COLMAP[1])} 1 00012\n1 2 3 4 5 6 7 8 9 1 2 3\n"
    )
    assert read_poses(path).names == ("my room 1.png", "00012")


def test_nerfstudios_scale_is_divided_out(tmp_path: Path) -> None:
    (tmp_path / "transforms.json").write_text(transforms(applied_scale=2.0))
    found = read_poses(tmp_path / "transforms.json").T_wc
    assert found[:, :3, 3] == pytest.approx(T_WC[:, :3, 3] / 2)
    assert found[:, :3, :3] == pytest.approx(T_WC[:, :3, :3])


def test_monogs(tmp_path: Path) -> None:
    path = tmp_path / "trj_final.json"
    path.write_text(json.dumps({"trj_id": [0, 3, 4, 9, 12], "trj_est": T_WC.tolist(), "trj_gt": []}))
    found = read_poses(path)
    assert found.numbers is not None
    assert (found.format, found.numbers.tolist()) == ("monogs", [0, 3, 4, 9, 12])
    assert found.T_wc == pytest.approx(T_WC)


def rows(columns: int, times: np.ndarray | None = None) -> list[str]:
    flat = T_WC.reshape(N, 16)[:, :columns]
    return [numbers(row if times is None else np.r_[times[i], row]) for i, row in enumerate(flat)]


def blocks(height: int, head: Callable[[int], str] = lambda i: "") -> str:
    return "\n".join(head(i) + "\n".join(numbers(row) for row in T_WC[i][:height]) for i in range(N)) + "\n"


@pytest.mark.parametrize(
    "text",
    [
        "\n".join(rows(16)),
        "\n".join(rows(12)),
        "# camera-to-world\n" + "\n".join(rows(16)),
        "\n".join(", ".join(row.split()) for row in rows(16)),
        ",".join(f"r{k}" for k in range(16)) + "\n" + "\n".join(",".join(row.split()) for row in rows(16)),
        blocks(4),
        blocks(3),
        blocks(4, lambda i: f"{i} {i} {i + 1}\n"),
        blocks(4, lambda i: f"{i}\n"),
    ],
    ids=["16", "12", "comment", "commas", "header", "4x4", "3x4", "redwood", "numbered"],
)
def test_matrices_are_one_for_each_frame(tmp_path: Path, text: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    found = read_poses(tmp_path / "poses.txt")
    assert found.counted
    assert found.T_wc == pytest.approx(T_WC)


@pytest.mark.parametrize("columns", [12, 16])
def test_matrices_after_a_time_or_a_frames_number(tmp_path: Path, columns: int) -> None:
    times = np.arange(N) / 15 + 7
    path = tmp_path / "poses.txt"
    path.write_text("\n".join(rows(columns, times)))
    found = read_poses(path)
    assert found.times == pytest.approx(times)
    assert found.T_wc == pytest.approx(T_WC)
    header = ",".join(["frame", *(f"m{k}" for k in range(columns))])
    path.write_text("\n".join([header, *(row.replace(" ", ",") for row in rows(columns, np.array([2, 3, 5, 7, 11])))]))
    found = read_poses(path)
    assert found.numbers is not None
    assert found.numbers.tolist() == [2, 3, 5, 7, 11]
    path.write_text("\n".join(rows(columns, times * 1e3)))
    assert read_poses(path, unit="ms").times == pytest.approx(times)


def test_frame_numbers_in_the_place_of_times(tmp_path: Path) -> None:
    path = tmp_path / "a.tum"
    path.write_text(tum_text(Trajectory(np.array([0.0, 1, 2, 5, 7]), T_WC)))
    found = read_poses(path, unit="frames")
    assert found.numbers is not None
    assert found.numbers.tolist() == [0, 1, 2, 5, 7]
    path.write_text(tum_text(Trajectory(np.array([0.0, 0.5, 2, 5, 7]), T_WC)))
    with pytest.raises(UsageError, match="times that are no frame numbers"):
        read_poses(path, unit="frames")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("images.txt", "1 1 0 0 0 0 0 nan 1 a.png\n", "images.txt:1: a pose is not finite"),
        ("images.txt", "1 2 0 0 0 0 0 0 1 a.png\n", "images.txt:1: the quaternion has norm 2"),
        ("images.bin", struct.pack("<Q", 1 << 60) + b"\0" * 80, "claims 1152921504606846976 images"),
        ("images.bin", images_bin()[:-5], "cut short"),
        ("images.bin", images_bin()[:90], "it claims 5 images, more than fit into the file"),
        ("t.json", '{"frames": []}', "the file has no frame"),
        ("t.json", '{"frames": [{"file_path": "a"}]}', "the pose of 'a' is no 4x4 matrix"),
        ("t.json", '{"trj_est": [[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]], "trj_id": ["a"]}', "'trj_id' must be"),
        ("t.json", '{"a": 1}', "'frames' (nerfstudio's transforms.json) or 'trj_est' (MonoGS) is expected"),
        ("p.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0\n", "p.txt:2: the row has 3 values, expected 12"),
        ("p.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2\n", "p.txt:1: the last row of the 4x4 matrix"),
        ("p.txt", "2 0 0 0 0 1 0 0 0 0 1 0\n", "p.txt:1: the 3x3 part is not a rotation"),
        ("p.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n1 2\n", "p.txt:2: the row has 2 values, expected 16"),
        ("p.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n1 0 0 0\n", "p.txt:4: the last matrix is cut short"),
        ("p.txt", "1 2 3\n", "the row has 3 values, which no format has"),
        ("p.txt", "", "no pose"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, name: str, content: str | bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(PanobenchError) as caught:
        read_poses(tmp_path / name)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_unknown_options(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("0 0 0 0 0 0 0 1\n")
    with pytest.raises(UsageError, match="did you mean 'colmap'"):
        read_poses(tmp_path / "a.tum", "colmp")
    with pytest.raises(UsageError, match="--time-unit h: known are s, ms, us, ns, frames"):
        read_poses(tmp_path / "a.tum", unit="h")
    with pytest.raises(InputError, match="missing"):
        recognise(tmp_path / "nothing")
