"""`panobench run --viewer`: what is written can be read back; without the package one line says what to do."""

from __future__ import annotations

import importlib.util
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import panobench
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute
from panobench.errors import OutputError, UnavailableError, UnknownNameError, UsageError
from panobench.plugins import registry
from panobench.viewer.choose import viewer


@pytest.mark.parametrize(
    ("option", "error", "message"),
    [
        ("reurn", UnknownNameError, "did you mean 'rerun'"),
        ("rerun:run.txt", UsageError, r"must end in \.rrd"),
        ("rerun:no/such/folder/run.rrd", OutputError, "there is no folder"),
    ],
)
def test_wrong_options_are_said(option: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message), viewer(option):
        pass


def test_without_the_package_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "rerun" else real(name))
    with pytest.raises(UnavailableError, match=r"panobench\[viewer\]"), viewer(f"rerun:{tmp_path / 'run.rrd'}"):
        pass


def test_a_run_is_served_to_this_machine_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("viser")
    request = RunRequest(method="panogs", sequence="tiny", width=64, max_frames=6, depth="oracle")
    with viewer("web:18345"):
        plugin = registry().manager.get_plugin("panobench.viewer")
        assert plugin.server.get_host() == "localhost", "not to the whole network"
        execute(request, tmp_path / "watched")
        address = plugin.url
        page = urllib.request.urlopen(address, timeout=10).read()
        assert b"<html" in page
        assert "frame" not in plugin.state.content
        assert plugin.frame.image.shape == (32, 64, 3)
        assert len(plugin.positions) == 6
        scene = plugin.server.get_scene_serializer().serialize()
        assert len(scene) > 1000
    assert address in capsys.readouterr().err
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address, timeout=10)


@pytest.mark.parametrize("option", ["web:port", "web:localhost:0", "web:1:2:x"])
def test_addresses_are_checked(option: str) -> None:
    with pytest.raises(UsageError, match="web:HOST:PORT"), viewer(option):
        pass


def test_a_run_is_written_and_read_back(tmp_path: Path) -> None:
    rr = pytest.importorskip("rerun")
    chunk = pytest.importorskip("rerun.chunk")
    file = tmp_path / "run.rrd"
    request = RunRequest(method="panogs", sequence="tiny", width=64, max_frames=8, depth="oracle")
    with viewer(f"rerun:{file}"):
        watched = execute(request, tmp_path / "watched")
    assert not registry().manager.has_plugin("panobench.viewer")

    def rows(path: Path) -> dict[str, int]:
        entities: dict[str, int] = {}
        for part in chunk.RrdReader(path).stream():
            entities[str(part.entity_path)] = entities.get(str(part.entity_path), 0) + part.num_rows
        return entities

    entities = rows(file)
    for name in ("trajectory", "truth", "keyframes", "map", "camera"):
        assert entities[f"/world/{name}"] >= 1, name
    assert entities["/images/frame"] == 8
    assert entities["/plots/latency_ms"] == 8
    assert entities["/images/render"] >= 1
    assert b"rerun_blueprint" in file.read_bytes() or b"Blueprint" in file.read_bytes(), "it opens with a layout"
    assert entities["/world/final/map"] == entities["/world/final/trajectory"] == 1, "the final state"
    finished = panobench.Run(watched).export("rrd", tmp_path / "finished.rrd")
    found = rows(finished)
    for name in ("trajectory", "truth", "keyframes", "map"):
        assert found[f"/world/{name}"] == 1, name
    assert found["/world/camera"] == found["/plots/error_mm"] == 8
    assert found["/images/render"] == found["/images/frame"] >= 1
    alone = execute(request, tmp_path / "alone")
    assert rr.__version__
    same = [np.loadtxt(folder / "trajectory.tum") for folder in (watched, alone)]
    assert np.array_equal(*same), "watching changed the run"
