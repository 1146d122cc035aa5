"""`panobench import`: anybody's trajectory becomes a run that is marked imported."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from panobench.cli.import_run import score_import
from panobench.cli.main import run as panobench
from panobench.datasets.files.trajectory_io import write_tum
from panobench.datasets.files.trajectory_match import interpolate_poses
from panobench.geometry import Sim3, invert_pose, quaternion_from_matrix, so3_exp
from panobench.testing import TinySequence
from panobench.types import Trajectory


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sequence of eight frames in panobench's own format."""
    folder = tmp_path_factory.mktemp("data") / "tiny"
    sequence = TinySequence(n=8)
    (folder / "images").mkdir(parents=True)
    rows = ["time,file"]
    for frame in sequence.frames():
        cv2.imwrite(str(folder / "images" / f"{frame.name}.png"), frame.image[..., ::-1])
        rows.append(f"{frame.time:.9f},images/{frame.name}.png")
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    (folder / "camera.yaml").write_text("model: erp\nwidth: 128\nheight: 64\n")
    assert sequence.groundtruth is not None
    write_tum(folder / "groundtruth.tum", sequence.groundtruth)
    return folder


@pytest.fixture
def truth() -> Trajectory:
    found = TinySequence(n=8).groundtruth
    assert found is not None
    return found


def moved(truth: Trajectory) -> Trajectory:
    """The truth in another world, half as large: what a monocular method finds at best."""
    return Trajectory(
        truth.times, Sim3(0.5, so3_exp([0.1, -0.7, 0.2]), np.array([1.0, 2.0, 3.0])).apply_poses(truth.T_wc)
    )


def imported(path: Path, root: Path, out: Path, *options: str) -> tuple[int, dict]:
    words = ["import", str(path), "--name", "TheirSLAM", "--dataset", "folder", "--root", str(root), "--width", "128"]
    code = panobench([*words, "--out", str(out), "--quiet", *options])
    return code, json.loads((out / "run.json").read_text()) if (out / "run.json").exists() else {}


def test_a_tum_file_is_scored_and_marked(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    write_tum(tmp_path / "them.tum", moved(truth))
    code, run = imported(tmp_path / "them.tum", root, tmp_path / "out")
    assert code == 0
    assert run["origin"] == "imported"
    assert run["spec"]["method"] == "TheirSLAM"
    assert run["metrics"]["ate_rmse_m"] < 1e-6
    assert run["metrics"]["tracked"] == 1.0
    assert run["timing"]["fps"] is None
    assert run["imported"]["trajectory"] == "them.tum"
    assert len(run["imported"]["sha256"]) == 64
    assert (tmp_path / "out" / "trajectory.tum").exists()


def test_a_metric_trajectory_is_scored_without_scale_too(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    write_tum(tmp_path / "them.tum", moved(truth))
    _, run = imported(tmp_path / "them.tum", root, tmp_path / "out", "--metric")
    assert run["metrics"]["ate_se3_rmse_m"] > 0.05
    assert run["metrics"]["ate_rmse_m"] < 1e-6


def test_kitti_and_euroc_are_told_apart(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    them = moved(truth)
    np.savetxt(tmp_path / "kitti.txt", them.T_wc[:, :3].reshape(-1, 12))
    q = quaternion_from_matrix(them.T_wc[:, :3, :3])
    rows = ["#timestamp, x, y, z, qw, qx, qy, qz"]
    rows += [
        f"{round(t * 1e9)},{p[0]},{p[1]},{p[2]},{r[0]},{r[1]},{r[2]},{r[3]}"
        for t, p, r in zip(them.times, them.positions, q)
    ]
    (tmp_path / "euroc.csv").write_text("\n".join(rows))
    for name in ("kitti.txt", "euroc.csv"):
        code, run = imported(tmp_path / name, root, tmp_path / f"out-{name}")
        assert code == 0
        assert run["metrics"]["ate_rmse_m"] < 1e-6


def test_world_to_camera_poses_are_inverted(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    write_tum(tmp_path / "them.tum", Trajectory(truth.times, invert_pose(moved(truth).T_wc)))
    _, wrong = imported(tmp_path / "them.tum", root, tmp_path / "wrong")
    _, right = imported(tmp_path / "them.tum", root, tmp_path / "right", "--inverse")
    assert right["metrics"]["ate_rmse_m"] < 1e-6 < wrong["metrics"]["ate_rmse_m"]


def test_coverage_is_what_the_file_covers(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    write_tum(tmp_path / "half.tum", moved(truth).select(np.arange(4)))
    code, run = imported(tmp_path / "half.tum", root, tmp_path / "out")
    assert code == 1
    assert run["status"] == "lost"
    assert run["metrics"]["tracked"] == 0.5


def test_shifted_times_are_explained_and_can_be_mended(
    root: Path, tmp_path: Path, truth: Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tum(tmp_path / "them.tum", Trajectory(truth.times + 1000, truth.T_wc))
    code, run = imported(tmp_path / "them.tum", root, tmp_path / "out")
    assert code == 2
    assert not run
    assert not (tmp_path / "out").exists()
    message = capsys.readouterr().err
    assert "8 of 8 poses belong to no frame" in message
    assert "--time-offset" in message
    code, _ = imported(tmp_path / "them.tum", root, tmp_path / "out", "--time-offset", "-1000")
    assert code == 0


def test_renders_are_scored(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    sequence, folder = TinySequence(n=8), tmp_path / "renders"
    folder.mkdir()
    noise = np.random.default_rng(0)
    for i in range(8):
        image = sequence.image(i).astype(float) + noise.normal(scale=8, size=(64, 128, 3))
        cv2.imwrite(str(folder / f"{i:06d}.png"), np.clip(image, 0, 255)[..., ::-1])
    write_tum(tmp_path / "them.tum", moved(truth))
    code, run = imported(tmp_path / "them.tum", root, tmp_path / "out", "--renders", str(folder))
    assert code == 0
    expected = 20 * np.log10(255 / 8)
    assert abs(run["metrics"]["pano_psnr_db"] - expected) < 0.8  # clipping takes some of the noise away
    assert run["metrics"]["psnr_db"] > expected  # the cut smooths a little of it
    assert list((tmp_path / "out" / "renders").glob("*.jpg"))


def test_a_missing_render_is_named(
    root: Path, tmp_path: Path, truth: Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "renders"
    folder.mkdir()
    for i in range(7):
        cv2.imwrite(str(folder / f"{i:06d}.png"), np.zeros((64, 128, 3), np.uint8))
    write_tum(tmp_path / "them.tum", truth)
    code, _ = imported(tmp_path / "them.tum", root, tmp_path / "out", "--renders", str(folder))
    assert code == 2
    assert "no render for frame 7 ('000007')" in capsys.readouterr().err


def test_a_render_of_another_size_is_named(
    root: Path, tmp_path: Path, truth: Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "renders"
    folder.mkdir()
    for i in range(8):
        cv2.imwrite(str(folder / f"{i:06d}.png"), np.zeros((32, 64, 3), np.uint8))
    write_tum(tmp_path / "them.tum", truth)
    _, run = imported(tmp_path / "them.tum", root, tmp_path / "out", "--renders", str(folder))
    assert "the render is 64x32, the frames are 128x64" in run["notes"]["rendering"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "no pose"),
        ("0 1 2 3\n", "the row has 4 values, which no format has: TUM 8"),
        ("0 0 0 0 0 0 0 1\n0.1 0 0\n", "them.txt:2: the row has 3 values"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n", "1 poses for 8 frames"),
    ],
)
def test_a_bad_file_is_one_line_and_writes_nothing(
    text: str, words: str, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "them.txt").write_text(text)
    code, _ = imported(tmp_path / "them.txt", root, tmp_path / "out")
    assert code == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["them.txt"]


def test_a_name_of_several_lines_is_refused(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    write_tum(tmp_path / "them.tum", truth)
    assert (
        panobench(["import", str(tmp_path / "them.tum"), "--name", "a\nb", "--dataset", "folder", "--root", str(root)])
        == 2
    )


def test_it_is_a_function_too(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    from panobench.bench.run.request import RunRequest
    from panobench.external.imported import ImportOptions

    write_tum(tmp_path / "them.tum", truth)
    request = RunRequest("Mine", dataset="folder", root=str(root), width=128)
    folder = score_import(tmp_path / "them.tum", request, ImportOptions(metric=True), tmp_path / "run")
    assert json.loads((folder / "run.json").read_text())["metric"] is True


# -- keyframes, other formats, any path against any path --------------------------------------------------------------


def test_a_file_of_keyframes_is_judged_as_such(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    write_tum(tmp_path / "keyframes.tum", moved(truth).select(np.array([0, 3, 5, 7])))
    code, run = imported(tmp_path / "keyframes.tum", root, tmp_path / "plain")
    assert (code, run["status"]) == (1, "lost")
    assert "if the file has keyframes alone, add --keyframes" in run["message"]
    code, run = imported(tmp_path / "keyframes.tum", root, tmp_path / "out", "--keyframes")
    assert (code, run["status"], run["keyframes"]) == (0, "ok", [0, 3, 5, 7])
    assert run["metrics"]["ate_keyframes_rmse_m"] < 1e-6
    assert run["metrics"]["ate_rmse_m"] is run["metrics"]["rpe_trans_rmse_m"] is None
    assert run["metrics"]["tracked"] == 0.5
    assert "keyframes alone" in run["notes"]["ate_rmse_m"]
    assert panobench(["score", str(tmp_path / "out"), "--in-place"]) == 0
    again = json.loads((tmp_path / "out" / "run.json").read_text())
    assert (again["status"], again["metrics"]["ate_rmse_m"]) == ("ok", None)
    assert again["metrics"]["ate_keyframes_rmse_m"] == pytest.approx(run["metrics"]["ate_keyframes_rmse_m"])


def test_poses_of_no_frame_are_counted(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    more = Trajectory(np.r_[truth.times, truth.times[-1] + [1.0, 2.0]], np.concatenate([truth.T_wc, truth.T_wc[-2:]]))
    write_tum(tmp_path / "them.tum", more)
    _, run = imported(tmp_path / "them.tum", root, tmp_path / "out")
    assert (run["imported"]["poses"], run["imported"]["unplaced"]) == (10, 2)
    assert run["remarks"] == ["2 of 10 poses belong to no frame"]
    write_tum(tmp_path / "them.tum", truth)
    _, run = imported(tmp_path / "them.tum", root, tmp_path / "all")
    assert (run["imported"]["poses"], run["imported"]["unplaced"], run["remarks"]) == (8, 0, [])
    assert "0 of 8 poses belong to no frame" in (tmp_path / "all" / "log.txt").read_text()


def test_frame_numbers_for_times_are_offered_and_taken(
    root: Path, tmp_path: Path, truth: Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    write_tum(tmp_path / "them.tum", Trajectory(np.arange(8.0), moved(truth).T_wc))
    assert imported(tmp_path / "them.tum", root, tmp_path / "out")[0] == 2
    assert "they look like frame numbers: add --time-unit frames" in capsys.readouterr().err
    code, run = imported(tmp_path / "them.tum", root, tmp_path / "out", "--time-unit", "frames")
    assert code == 0
    assert run["metrics"]["ate_rmse_m"] < 1e-6


def transforms(path: Path, truth: Trajectory, suffix: str = ".png") -> Path:
    """nerfstudio's file, in whose world and scale it may be."""
    them = moved(truth)
    frames = [
        {"file_path": f"images/{i:06d}{suffix}", "transform_matrix": (T @ np.diag([1, -1, -1, 1])).tolist()}
        for i, T in enumerate(them.T_wc)
    ]
    path.write_text(json.dumps({"frames": frames}))
    return path


def test_poses_by_image_name(root: Path, tmp_path: Path, truth: Trajectory) -> None:
    code, run = imported(transforms(tmp_path / "transforms.json", truth), root, tmp_path / "out")
    assert code == 0
    assert run["metrics"]["ate_rmse_m"] < 1e-6
    assert run["metrics"]["ate_rotation_rmse_deg"] < 1e-4


def against(tmp_path: Path, *words: str) -> dict:
    out = tmp_path / "against"
    assert panobench(["import", *words, "--out", str(out), "--force", "--quiet"]) == 0
    run: dict = json.loads((out / "run.json").read_text())
    assert run["status"] == "ok"
    return run


def test_any_path_against_any_path(tmp_path: Path, truth: Trajectory) -> None:
    """Without a data set: the frames are the poses of the other."""
    a, b = tmp_path / "a.tum", tmp_path / "b.tum"
    write_tum(a, moved(truth))
    write_tum(b, truth)
    run = against(tmp_path, str(a), "--against", str(b))
    assert (run["spec"]["method"], run["spec"]["dataset"], run["spec"]["sequence"]) == ("a", "path", "b")
    assert run["metrics"]["ate_rmse_m"] < 1e-6
    assert (tmp_path / "against" / "groundtruth.tum").is_file()
    # each second frame is there: the others belong to none
    write_tum(b, truth.select(np.arange(0, 8, 2)))
    run = against(tmp_path, str(a), "--against", str(b))
    assert (run["frames"]["given"], run["imported"]["unplaced"]) == (4, 4)
    # motion capture has many more: it is interpolated to the poses
    times = np.linspace(truth.times[0], truth.times[-1], 701)
    write_tum(b, interpolate_poses(truth, times))
    run = against(tmp_path, str(a), "--against", str(b))
    assert run["frames"]["given"] == run["frames"]["tracked"] == 8
    assert run["metrics"]["ate_rmse_m"] < 1e-3


def test_a_reference_without_scale_gives_shares_of_the_path(
    root: Path, tmp_path: Path, truth: Trajectory, capsys: pytest.CaptureFixture[str]
) -> None:
    reference = transforms(tmp_path / "transforms.json", truth)
    write_tum(tmp_path / "them.tum", truth)
    words = [str(tmp_path / "them.tum"), "--against", str(reference), "--dataset", "folder", "--root", str(root)]
    run = against(tmp_path, *words, "--width", "128")
    assert run["groundtruth_scaled"] is False
    assert run["metrics"]["ate_rmse_m"] is None
    assert run["metrics"]["ate_percent"] < 1e-4
    assert "no scale" in run["notes"]["ate_rmse_m"]
    run = against(tmp_path, *words, "--width", "128", "--groundtruth-scale", "metres")
    assert run["metrics"]["ate_rmse_m"] < 1e-6
    assert panobench(["report", str(tmp_path / "against"), "-o", str(tmp_path / "page.html")]) == 0
    capsys.readouterr()
    assert panobench(["import", str(tmp_path / "them.tum"), "--against", str(reference), "--out", "x"]) == 2
    assert "transforms.json has poses by image name, the other trajectory by time: name the data set" in (
        capsys.readouterr().err
    )


def test_both_ways_of_naming_the_reference_at_once(tmp_path: Path, truth: Trajectory) -> None:
    write_tum(tmp_path / "a.tum", truth)
    file = str(tmp_path / "a.tum")
    assert panobench(["import", file, "--against", file, "--groundtruth", file]) == 2
