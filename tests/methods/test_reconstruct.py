"""``reconstruct``: given poses in, a map out."""

import dataclasses

import numpy as np
import pytest

from panobench.bench.run.request import RunRequest
from panobench.bench.run.setup import set_up_run
from panobench.cameras.kannala_brandt import KannalaBrandtCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.datasets.files.trajectory_io import write_tum
from panobench.datasets.writing.writer import write_sequence
from panobench.errors import InputError, UnsupportedError
from panobench.geometry import Sim3, so3_exp
from panobench.methods.base import MethodContext
from panobench.methods.reconstruct.config import ReconstructConfig
from panobench.methods.reconstruct.method import ReconstructMethod
from panobench.testing import run_method
from panobench.testing.sequences import GivenImages, TinySequence, erp_camera
from panobench.types import Trajectory

SHORT = {"passes": 8, "sweep_width": 128, "densify_every": 4}
CAMERAS = {
    "erp": lambda: erp_camera(128),
    "pinhole": lambda: PinholeCamera(96, 96, 55.0, 55.0, 48.0, 48.0),
    "fisheye": lambda: KannalaBrandtCamera(96, 96, 40.0, 40.0, 48.0, 48.0),
}


def reconstruct(sequence, seed=0, **settings):
    method = ReconstructMethod(ReconstructConfig(**{**SHORT, **settings}))
    return method, run_method(method, sequence, seed=seed, needs=("rgb", "poses")).estimate


def psnr(method, sequence, T_wc, T_true):
    seen, valid = sequence.image_from(T_true), sequence.camera.valid_mask()
    shown = method.render(sequence.camera, T_wc)
    return -10 * np.log10(np.mean((shown[valid] - seen[valid] / 255) ** 2))


@pytest.mark.parametrize("kind", CAMERAS)
def test_unseen_views_are_rendered(kind):
    sequence = TinySequence(CAMERAS[kind](), 10)
    method, estimate = reconstruct(sequence)
    np.testing.assert_array_equal(estimate.trajectory.T_wc, sequence.groundtruth.T_wc)
    assert estimate.metric
    T = sequence.pose_at(0.45)  # between two frames
    assert psnr(method, sequence, T, T) > 22
    assert len(estimate.map) == estimate.extra["gaussians"]


def test_a_trajectory_file_replaces_the_truth(tmp_path):
    """In its own scale and world."""
    sequence = TinySequence(n=10)
    other = Sim3(3.0, so3_exp([0.3, 0.1, 0.2]), np.array([1.0, 2.0, 3.0]))
    truth = sequence.groundtruth
    chosen = [0, 1, 2, 4, 5, 6, 7, 9]
    write_tum(tmp_path / "t.tum", Trajectory(truth.times[chosen] + 0.004, other.apply_poses(truth.T_wc[chosen])))
    method, estimate = reconstruct(sequence, trajectory=str(tmp_path / "t.tum"))
    np.testing.assert_allclose(estimate.trajectory.times, truth.times[chosen])
    assert not estimate.metric
    T = sequence.pose_at(0.45)
    assert psnr(method, sequence, other.apply_poses(T), T) > 22


def test_files_that_do_not_fit(tmp_path):
    sequence = TinySequence(n=3)
    with pytest.raises(InputError, match="no such file"):
        reconstruct(sequence, trajectory=str(tmp_path / "none.tum"))
    late = Trajectory(sequence.times + 50, sequence.groundtruth.T_wc)
    write_tum(tmp_path / "late.tum", late)
    with pytest.raises(InputError, match="no pose within"):
        reconstruct(sequence, trajectory=str(tmp_path / "late.tum"))
    with pytest.raises(UnsupportedError, match="needs poses"):
        ReconstructMethod().run(sequence, MethodContext())


def test_same_seed_same_map():
    sequence = TinySequence(erp_camera(64), n=6)
    a, b, c = (reconstruct(sequence, seed=s, passes=5, densify_every=2)[1].map for s in (0, 0, 1))
    np.testing.assert_array_equal(a.means, b.means)
    assert len(a) != len(c) or not np.array_equal(a.means, c.means)


def test_a_standing_camera_and_a_single_frame_still_give_a_map():
    still = TinySequence(n=3, pose=lambda t: np.eye(4))
    _, estimate = reconstruct(still, passes=3)
    assert len(estimate.map) > 100
    one = GivenImages(still.camera, [still.image(0)])
    context = MethodContext(poses={0: np.eye(4)})
    assert len(ReconstructMethod(ReconstructConfig(passes=5)).run(one, context).map) > 100
    assert ReconstructMethod().run(GivenImages(still.camera, []), MethodContext(poses={})).map is None


def test_data_without_truth_need_a_trajectory(tmp_path):
    sequence = TinySequence(erp_camera(64), n=4)
    frames = ((float(t), sequence.image(i), None) for i, t in enumerate(sequence.times))
    write_sequence(tmp_path / "seq", sequence.camera, frames)
    write_tum(tmp_path / "t.tum", sequence.groundtruth)
    request = RunRequest("reconstruct", dataset="folder", root=str(tmp_path), sequence="seq", width=64)
    with pytest.raises(UnsupportedError, match="needs given poses"):
        set_up_run(request)
    named = dataclasses.replace(request, settings={"trajectory": str(tmp_path / "t.tum")})
    assert set_up_run(named).sequence.groundtruth is None
