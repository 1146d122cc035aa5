"""COLMAP's adapter: the genuine pycolmap where it is installed, a stand-in elsewhere."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from panobench_colmap import SPEC
from panobench_colmap.method import Colmap, ColmapConfig, colmap_camera

from panobench import MethodError, UnsupportedError
from panobench.testing import (
    FakeCamera,
    TinySequence,
    assert_conforms,
    ate_rmse,
    camera_from_dict,
    erp_camera,
    fisheye_camera,
    pose_rows,
    run_method,
)


def test_it_keeps_the_contract_where_it_cannot_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PANOBENCH_COLMAP_RUN_IN", "venv:/no/such/place")
    assert_conforms(SPEC)


def test_cameras_become_colmaps() -> None:
    assert colmap_camera(erp_camera(128)) == ("EQUIRECTANGULAR", [128.0, 64.0])
    values = {"model": "pinhole", "width": 96, "height": 64, "fx": 50.0, "fy": 51.0, "cx": 48.0, "cy": 32.0}
    pinhole = camera_from_dict(values)
    assert colmap_camera(pinhole) == ("PINHOLE", [50.0, 51.0, 48.0, 32.0])
    distorted = camera_from_dict({**values, "distortion": [0.1, 0.2, 0.3, 0.4]})
    model, parameters = colmap_camera(distorted)
    assert model == "FULL_OPENCV"
    assert len(parameters) == 12
    assert colmap_camera(fisheye_camera(96, 120))[0] == "OPENCV_FISHEYE"
    with pytest.raises(UnsupportedError, match="no fake camera"):
        colmap_camera(FakeCamera())


def fake_environment(folder: Path, body: str) -> str:
    """A virtual environment whose ``python SCRIPT WORK`` runs ``body`` instead of the script."""
    (folder / "lib" / "python3.11" / "site-packages" / "pycolmap").mkdir(parents=True)
    (folder / "bin").mkdir()
    (folder / "stand_in.py").write_text(f"import json, os, sys\nwork = sys.argv[2]\n{body}\n")
    python = folder / "bin" / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -IS "{folder}/stand_in.py" "$@"\n')
    python.chmod(0o755)
    return f"venv:{folder}"


def test_the_job_is_written_and_the_answer_read(tmp_path: Path) -> None:
    sequence = TinySequence(n=5)
    assert sequence.groundtruth is not None
    rows = "".join(" ".join(map(repr, row)) + "\n" for row in pose_rows(sequence.groundtruth)[1:])
    body = (
        "job = json.load(open(work + '/job.json'))\n"
        "assert job['model'] == 'EQUIRECTANGULAR' and job['parameters'] == [128.0, 64.0]\n"
        "assert all(os.path.exists(work + '/images/' + name) for name in job['images']) and len(job['images']) == 5\n"
        f"open(work + '/trajectory.tum', 'w').write({rows!r})\n"
        "json.dump({'registered': 4}, open(work + '/summary.json', 'w'))\n"
    )
    run = run_method(Colmap(ColmapConfig(run_in=fake_environment(tmp_path / "env", body))), sequence)
    assert np.allclose(run.estimate.trajectory.times, sequence.times[1:])
    assert ate_rmse(run, sequence) < 1e-6
    assert run.estimate.extra["colmap"] == {"registered": 4}


def test_nothing_registered_is_an_empty_answer(tmp_path: Path) -> None:
    place = fake_environment(tmp_path / "env", "print('no two images could be registered')")
    assert len(run_method(Colmap(ColmapConfig(run_in=place)), TinySequence(n=3)).estimate.trajectory) == 0


def test_a_crash_shows_the_log(tmp_path: Path) -> None:
    place = fake_environment(tmp_path / "env", "raise RuntimeError('database is locked')")
    with pytest.raises(MethodError, match="database is locked"):
        run_method(Colmap(ColmapConfig(run_in=place)), TinySequence(n=3))


def test_an_old_pycolmap_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("panobench.external.python_package.find_package", lambda place, name: Path(name))
    monkeypatch.setattr("importlib.metadata.version", lambda name: "0.6.1")
    assert "no equirectangular camera" in str(Colmap.missing())


@pytest.mark.skipif(importlib.util.find_spec("pycolmap") is None, reason="pycolmap is not installed")
def test_the_genuine_colmap_reconstructs_panoramas() -> None:
    sequence = TinySequence(erp_camera(512), n=6, rate=4.0)
    run = run_method(Colmap(ColmapConfig(features=1500, threads=2, timeout_s=120)), sequence)
    assert len(run.estimate.trajectory) == 6, run.log[-3:]
    assert ate_rmse(run, sequence) < 0.01
