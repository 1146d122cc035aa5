"""Launch files, the run's own master, and waiting for nodes that lag behind the recording."""

from __future__ import annotations

import subprocess
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from panobench.errors import UnsupportedError
from panobench.external import ros


def test_the_launch_file_names_the_nodes_and_ends_with_the_recording() -> None:
    node = ros.Node("vins", "estimator", {"config": "/w/c.yaml", "skip": 0, "distance": 0.5})
    text = ros.launch_file([node], Path("/w/r.bag"), 0.5, Path("/w/p.sh"), Path("/w/out"))
    estimator, player = ElementTree.fromstring(text)
    assert [(p.get("type"), p.get("value")) for p in estimator] == [
        ("string", "/w/c.yaml"),
        ("int", "0"),
        ("double", "0.5"),
    ]
    assert player.get("launch-prefix") == "sh /w/p.sh /w/out"
    assert "--quiet" in player.get("args", "").split()
    assert "--rate=0.5" in player.get("args", "").split()
    assert all(n.get("required") == "true" for n in (estimator, player))


@pytest.mark.parametrize("path", ['/w/"><evil/>.bag', "/a folder/r.bag", "/w/$(env X)"])
def test_paths_that_roslaunch_would_take_apart_are_refused(path: str) -> None:
    with pytest.raises(UnsupportedError, match="cannot name the path"):
        ros.launch_file([], Path(path), 1.0, Path("/w/p.sh"), Path("/w/out"))


def test_each_run_has_a_master_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", "http://elsewhere:11311")
    monkeypatch.setenv("ROS_IP", "10.0.0.1")
    monkeypatch.setenv("ROS_PACKAGE_PATH", "/ws/src")
    monkeypatch.setenv("CMAKE_PREFIX_PATH", "/ws/devel")
    found = ros.ros_environment(tmp_path, 4000, inherit=True)
    assert found["ROS_MASTER_URI"] == "http://localhost:4000"
    assert "ROS_IP" not in found
    assert (found["ROS_PACKAGE_PATH"], found["CMAKE_PREFIX_PATH"]) == ("/ws/src", "/ws/devel")
    assert set(ros.ros_environment(tmp_path, 4000, inherit=False)) == {
        "ROS_MASTER_URI",
        "ROS_HOSTNAME",
        "ROS_HOME",
        "ROS_LOG_DIR",
        "PYTHONUNBUFFERED",
    }
    assert ros.free_port() != ros.free_port()


def test_nodes_are_found_where_catkin_puts_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = tmp_path / "b" / "lib" / "vins" / "node"
    program.parent.mkdir(parents=True)
    program.write_text("x")
    monkeypatch.setenv("CMAKE_PREFIX_PATH", f"{tmp_path / 'a'}:{tmp_path / 'b'}")
    assert ros.find_node("vins", "node") is None  # it cannot be executed
    program.chmod(0o755)
    assert ros.find_node("vins", "node") == program
    monkeypatch.delenv("CMAKE_PREFIX_PATH")
    assert ros.find_node("vins", "node") is None


def test_the_player_waits_until_the_output_has_stopped_growing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros, "IDLE_S", 2)
    script, output = ros.write_player_script(tmp_path), tmp_path / "out"
    output.mkdir()
    rows = 4
    writer = subprocess.Popen(["sh", "-c", f"for i in $(seq {rows}); do sleep 0.8; echo row >> {output}/result; done"])
    begin = time.monotonic()
    player = subprocess.run(["sh", str(script), str(output), "sh", "-c", "exit 3"], timeout=60, check=False)
    writer.wait(timeout=10)
    assert player.returncode == 3
    assert time.monotonic() - begin >= 0.8 * rows
    assert (output / "result").read_text().count("row") == rows
