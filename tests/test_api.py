"""Runs from Python: what is done, read, drawn and scored is what the command line stores."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import panobench
from panobench.errors import InputError, UnavailableError, UsageError
from panobench.geometry import Sim3, so3_exp
from panobench.metrics.image_quality import psnr
from panobench.testing import TinySequence

TINY = {"dataset": "rooms", "sequence": "tiny", "width": 128, "max_frames": 8}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> panobench.Run:
    """A short run with a map: an offline reconstruction from the true poses."""
    settings = {"passes": 3, "seeds": 3, "sweep_views": 2}
    folder = tmp_path_factory.mktemp("runs") / "one"
    return panobench.run(folder, method="reconstruct", settings=settings, **TINY)


def test_a_run_is_done_and_read(made: panobench.Run) -> None:
    assert made.ok, made.record.message
    assert made.verdict is not None
    assert "given poses" in made.cautions
    assert len(made.trajectory) == len(made.frames["time"]) == 8
    assert made.trajectory.T_wc.shape == (8, 4, 4)
    assert made.metrics["tracked"] == 1.0
    assert panobench.Run(made.folder).metrics == made.metrics
    assert made.aligned is not None
    assert made.groundtruth is not None
    assert np.abs(made.aligned.positions - made.groundtruth.positions).max() < 1e-5


def test_the_map_renders_what_the_camera_saw(made: panobench.Run) -> None:
    image = made.render(3)
    assert image.shape == (64, 128, 3)
    assert image.dtype == np.float32
    frame = panobench_frame(3)
    assert psnr(image, frame, np.ones(frame.shape[:2], bool)) > psnr(made.render(-1), frame, np.ones((64, 128), bool))
    with pytest.raises(UsageError, match="8"):
        made.render(8)


def panobench_frame(i: int) -> np.ndarray:
    from panobench.bench.run.request import RunRequest
    from panobench.bench.run.setup import open_input

    return (open_input(RunRequest(**TINY)).image(i) / 255).astype(np.float32)


def test_frames_and_stores_are_tables(made: panobench.Run) -> None:
    pandas = pytest.importorskip("pandas")
    table = made.to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert len(table) == 8
    assert table["error_m"].max() < 1e-4
    runs = panobench.load(made.folder.parent)
    assert len(runs) == 1
    row = runs.to_dataframe().iloc[0]
    assert (row["method"], row["width"], row["status"]) == ("reconstruct", "128", "ok")
    assert len(runs.where(method="sparse")) == 0
    assert len(runs.where(width=128)) == 1


def test_without_pandas_the_error_says_what_to_install(made: panobench.Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(UnavailableError, match="pip install pandas"):
        made.to_dataframe()


def test_the_card_shows_picture_path_and_figures_and_nothing_from_outside(made: panobench.Run) -> None:
    html = made._repr_html_()
    assert "<img src='data:image/webp" in html
    assert html.count("<polyline") == 2
    assert "reconstruct" in html
    assert "http" not in html
    assert "<script" not in html


def test_a_trajectory_is_scored_against_a_sequence_or_a_true_one(tmp_path: Path) -> None:
    sequence = TinySequence()
    truth = sequence.groundtruth
    assert truth is not None
    turned = Sim3(2.0, so3_exp(np.array([0.1, 0.4, 0.0])), np.array([1.0, 0.0, 2.0]))
    moved = panobench.Trajectory(truth.times, turned.apply_poses(truth.T_wc))
    for reference in (sequence, truth):
        found = panobench.score(moved, reference)
        assert found.status == "ok"
        assert found.metrics["ate_rmse_m"] == pytest.approx(0.0, abs=1e-9)
    half = panobench.score(moved.select(np.arange(len(moved) // 2)), sequence)
    assert half.status == "lost"
    assert half.metrics["tracked"] == pytest.approx(0.5, abs=0.1)


def test_errors_say_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no run\.json"):
        panobench.load(tmp_path)
    with pytest.raises(UsageError, match="nonsense"):
        panobench.run(nonsense=3)


def test_importing_panobench_stays_light() -> None:
    script = "import sys, panobench; print(sorted({'numba', 'pandas', 'torch', 'scipy'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
