"""Saved maps: what is read is what was written, whatever happens to the writer or the files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.errors import OutputError
from panobench.geometry import make_pose, so3_exp
from panobench.maps import store
from panobench.maps.saved import SavedKeyframe, SavedMap
from panobench.maps.store import INDEX, MapError, read_map, write_map
from panobench.splat.gaussians import GaussianMap


def a_map(seed: int = 0, keyframes: int = 3, n: int = 20) -> SavedMap:
    rng = np.random.default_rng(seed)
    mask = np.ones((16, 32), bool)
    mask[12:] = False
    quats = rng.normal(size=(n, 4))
    gaussians = GaussianMap(
        rng.normal(size=(n, 3)), rng.normal(-3, 1, (n, 3)), quats / np.linalg.norm(quats, axis=1)[:, None],
        rng.normal(size=n), rng.uniform(size=(n, 3)),
    )  # fmt: skip
    kept = tuple(
        SavedKeyframe(
            5 * k, k / 3, make_pose(so3_exp(rng.normal(size=3)), rng.normal(size=3)),
            rng.integers(0, 255, (16, 32, 3), dtype=np.uint8),
        )
        for k in range(keyframes)
    )  # fmt: skip
    anchors = rng.integers(0, keyframes, n).astype(np.int32)
    return SavedMap(gaussians, anchors, ErpCamera(32, 16).with_mask(mask), kept, 2.5, False, "panogs")


def same(a: SavedMap, b: SavedMap) -> bool:
    arrays = zip(a.gaussians.arrays(), b.gaussians.arrays())
    return (
        all(np.allclose(x, y, atol=1e-6) for x, y in arrays)
        and bool(np.array_equal(a.anchors, b.anchors))
        and a.camera.to_dict() == b.camera.to_dict()
        and bool(np.array_equal(a.camera.valid_mask(), b.camera.valid_mask()))
        and [k.index for k in a.keyframes] == [k.index for k in b.keyframes]
        and [k.time for k in a.keyframes] == [k.time for k in b.keyframes]
        and all(np.array_equal(x.T_wc, y.T_wc) for x, y in zip(a.keyframes, b.keyframes))
        and all(np.array_equal(x.image, y.image) for x, y in zip(a.keyframes, b.keyframes))
        and (a.scene_depth, a.metric, a.made_by) == (b.scene_depth, b.metric, b.made_by)
    )


def test_what_is_read_is_what_was_written(tmp_path: Path) -> None:
    write_map(tmp_path / "m", a_map())
    assert same(read_map(tmp_path / "m"), a_map())


def test_a_new_state_replaces_the_old_one_and_leaves_nothing_of_it(tmp_path: Path) -> None:
    folder = tmp_path / "m"
    write_map(folder, a_map())
    once = len(list(folder.iterdir()))
    first = a_map()
    grown = replace(a_map(1, keyframes=4), keyframes=(*first.keyframes, a_map(1).keyframes[0]))
    write_map(folder, grown)
    assert same(read_map(folder), grown)
    assert len(list(folder.iterdir())) == once + 1  # the keyframes that stayed are the same files


@pytest.mark.parametrize("writes", range(6))
def test_a_writer_that_stops_leaves_the_old_map(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, writes: int) -> None:
    folder = tmp_path / "m"
    write_map(folder, a_map())
    real, done = store.write_whole, 0

    def stops(path: Path, data: bytes | str) -> None:
        nonlocal done
        if done == writes:
            path.with_name("." + path.name).write_bytes(b"half")
            raise KeyboardInterrupt
        done += 1
        real(path, data)

    monkeypatch.setattr(store, "write_whole", stops)
    with pytest.raises(KeyboardInterrupt):
        write_map(folder, a_map(1, keyframes=4))
    assert same(read_map(folder), a_map())


def test_other_folders_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(OutputError, match="no saved map"):
        write_map(tmp_path, a_map())


def changed(folder: Path, **values: Any) -> Path:
    index = json.loads((folder / INDEX).read_text())
    (folder / INDEX).write_text(json.dumps({**index, **values}))
    return folder


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    write_map(tmp_path, a_map())
    name = json.loads((tmp_path / INDEX).read_text())["keyframes"][1]["image"]
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-9])
    with pytest.raises(MapError, match="damaged"):
        read_map(tmp_path)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"version": 2}, "newer"),
        ({"format": "other"}, "not the index"),
        ({"gaussians": "../../etc/passwd"}, "no file of a map"),
        ({"gaussians": "a" * 64 + ".ply"}, "missing"),
        ({"anchors": 3}, "'anchors'"),
        ({"scene_depth": -1.0}, "scene_depth"),
        ({"scene_depth": True}, "scene_depth"),
        ({"metric": "yes"}, "metric"),
        ({"keyframes": []}, "keyframes"),
        ({"keyframes": [3]}, "keyframe"),
        ({"camera": {"model": "erp", "width": 20000, "height": 10000}}, "large"),
        ({"camera": {"model": "erp", "width": 64, "height": 32}}, "64x32"),
    ],
)
def test_a_hostile_index_is_one_clear_error(tmp_path: Path, values: dict[str, Any], said: str) -> None:
    write_map(tmp_path, a_map())
    with pytest.raises(MapError, match=said):
        read_map(changed(tmp_path, **values))


@pytest.mark.parametrize("row", [[0.0] * 12, [float("nan")] * 12, [1.0] * 11, ["x"] * 12])
def test_a_keyframe_s_pose_must_be_rigid(tmp_path: Path, row: list[Any]) -> None:
    write_map(tmp_path, a_map())
    listed = json.loads((tmp_path / INDEX).read_text())["keyframes"]
    listed[0]["T_wc"] = row
    with pytest.raises(MapError):
        read_map(changed(tmp_path, keyframes=listed))


def test_a_missing_folder_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(MapError, match="--save-map"):
        read_map(tmp_path / "none")
