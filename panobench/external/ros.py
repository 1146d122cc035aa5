"""ROS 1 programs: a launch file with nodes and a recording, a master of the run's own, and the end of the run.

roslaunch ends when a required node does. The recording's player is one, and all other nodes are too, so that a node
that crashes ends the run instead of leaving it to the time limit. The player runs under ``play_and_wait.sh``: nodes
work through what they have buffered after the recording has ended, so the script goes on until their output has
stopped growing.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from panobench.errors import UnsupportedError

#: Seconds between the player's start and the first message, in which nodes start and subscribe.
DELAY_S = 3.0
#: The output folder must not change for so many seconds before the run is over.
IDLE_S = 4
#: Variables that name the network, the logs or a namespace; each run has its own.
_OWN = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME", "ROS_NAMESPACE", "ROS_HOME", "ROS_LOG_DIR")
_OTHERS = ("PYTHONPATH", "CMAKE_PREFIX_PATH", "PKG_CONFIG_PATH")

PLAY_AND_WAIT = """#!/bin/sh
# play_and_wait.sh FOLDER PLAYER [ARGUMENT ...]: play, then wait until the files in FOLDER have not changed for a while.
folder=$1
shift
"$@"
code=$?
before=
idle=0
while [ "$idle" -lt %d ]; do
    now=$(ls -lR "$folder" | cksum)
    if [ "$now" = "$before" ]; then idle=$((idle + 1)); else idle=0; fi
    before=$now
    sleep 1
done
exit "$code"
"""


@dataclass(frozen=True)
class Node:
    """A node of a launch file. parameters: name -> value; their types are those of the values."""

    package: str
    executable: str
    parameters: Mapping[str, str | int | float] = field(default_factory=dict)


def launch_file(nodes: Sequence[Node], recording: Path, rate: float, script: Path, output: Path) -> str:
    """The text of a launch file that plays ``recording`` at ``rate`` and ends as the module says.

    ``script`` comes from ``write_player_script``, ``output`` is the folder that it watches. Raises UnsupportedError
    for a path that a launch file cannot name.
    """
    for path in (recording, script, output, *(v for n in nodes for v in n.parameters.values())):
        if any(c in str(path) for c in "<>&\"'$ "):
            raise UnsupportedError(f"a ROS launch file cannot name the path {path}")
    lines = ["<launch>"]
    for node in nodes:
        name = node.executable
        lines.append(f'  <node name="{name}" pkg="{node.package}" type="{name}" output="screen" required="true">')
        for key, value in node.parameters.items():
            kind = {str: "string", int: "int", float: "double"}[type(value)]
            lines.append(f'    <param name="{key}" type="{kind}" value="{value}"/>')
        lines.append("  </node>")
    arguments = f"--quiet --delay={DELAY_S:g} --rate={rate:g} {recording}"
    lines.append(f'  <node name="player" pkg="rosbag" type="play" args="{arguments}" required="true" output="screen"')
    lines.append(f'        launch-prefix="sh {script} {output}"/>')
    return "\n".join([*lines, "</launch>", ""])


def write_player_script(folder: Path) -> Path:
    """Write ``play_and_wait.sh`` and return where it is."""
    path = folder / "play_and_wait.sh"
    path.write_text(PLAY_AND_WAIT % IDLE_S)
    return path


def free_port() -> int:
    """A TCP port on which nobody listens at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def ros_environment(work: Path, port: int, inherit: bool) -> dict[str, str]:
    """Variables for a run with a master at ``port`` and logs below ``work``.

    inherit: with the ROS variables of this process, which a sourced workspace has set. A container has its own.
    """
    inherited = {k: v for k, v in os.environ.items() if k.startswith("ROS_") or k in _OTHERS} if inherit else {}
    return {k: v for k, v in inherited.items() if k not in _OWN} | {
        "ROS_MASTER_URI": f"http://localhost:{port}",
        "ROS_HOSTNAME": "localhost",
        "ROS_HOME": str(work / "ros"),
        "ROS_LOG_DIR": str(work / "ros" / "log"),
        # roslaunch's lines, buffered, would follow those of the nodes in the log.
        "PYTHONUNBUFFERED": "1",
    }


def find_node(package: str, executable: str) -> Path | None:
    """An executable of a package in the sourced workspaces (CMAKE_PREFIX_PATH, as catkin installs it)."""
    for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix) / "lib" / package / executable
        if prefix and os.access(path, os.X_OK) and path.is_file():
            return path
    return None
