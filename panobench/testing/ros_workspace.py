"""A stand-in for a ROS 1 workspace: roslaunch, the bag player and nodes, as far as adapters depend on them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from panobench.testing.programs import write_program

#: Reads the launch file as roslaunch does: starts every node, under its prefix, and ends all when a required one ends.
#: Unlike roslaunch it gives nodes their parameters as arguments, name=value.
ROSLAUNCH = """
import os, socket, subprocess, sys, time
import xml.etree.ElementTree as ElementTree

option, port, path = sys.argv[1:]
assert option == "-p" and os.environ["ROS_MASTER_URI"] == f"http://localhost:{port}"
assert os.path.isdir(os.path.dirname(os.environ["ROS_HOME"]))
master = socket.create_server(("127.0.0.1", int(port)))  # refuses a port that another run has taken
nodes = []
for element in ElementTree.parse(path).getroot():
    package, name = element.get("pkg"), element.get("type")
    found = [f"{p}/lib/{package}/{name}" for p in os.environ["CMAKE_PREFIX_PATH"].split(":")]
    program = next((f for f in found if os.access(f, os.X_OK)), None)
    if program is None:
        print(f"ERROR: cannot launch node of type [{package}/{name}]")
        continue
    parameters = [f"{p.get('name')}={p.get('value')}" for p in element]
    prefix = element.get("launch-prefix", "").split()
    nodes.append((element, subprocess.Popen([*prefix, program, *element.get("args", "").split(), *parameters])))
while not any(n.get("required") == "true" and p.poll() is not None for n, p in nodes):
    time.sleep(0.02)
for _, process in nodes:
    process.terminate()
"""
#: ``rosbag play``: checks its options and the recording, then plays for a tenth of a second.
PLAY = """
import sys, time
*options, recording = sys.argv[1:]
assert "--quiet" in options and any(o.startswith("--rate=") for o in options), options
assert open(recording, "rb").read(13) == b"#ROSBAG V2.0\\n"
time.sleep(0.1)
open(recording + ".played", "w").close()
"""
#: Before a node's own code: its parameters, and ``wait_for_end()``, which returns when the recording has ended.
NODE = """
import os, sys, time
parameters = dict(a.split("=", 1) for a in sys.argv[1:])

def wait_for_end():
    while not os.path.exists(os.path.dirname(parameters["config_file"]) + "/recording.bag.played"):
        time.sleep(0.02)
"""
#: A node that does nothing until it is ended.
IDLE = "time.sleep(600)"


def write_ros_workspace(folder: Path, nodes: Mapping[str, str]) -> dict[str, str]:
    """Write roslaunch, the player and nodes (package -> Python code) below ``folder``.

    Returns the environment variables that sourcing such a workspace would set.
    """
    write_program(folder / "bin" / "roslaunch", ROSLAUNCH)
    write_program(folder / "lib" / "rosbag" / "play", PLAY)
    for package, code in nodes.items():
        write_program(folder / "lib" / package / package, f"{NODE}\n{code}")
    return {"CMAKE_PREFIX_PATH": str(folder), "ROS_PACKAGE_PATH": str(folder / "share"), "ROS_DISTRO": "stand-in"}
