"""Trajectory files."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
from mutate import Material
from target import Parse, Target, plain, text

from panobench.errors import PanobenchError

TUM = "# time x y z qx qy qz qw\n" + "".join(f"{i / 15:.6f} {0.1 * i} 0 0.2 0 0 0 1\n" for i in range(6))
_TUM_NS = "".join(f"{i * 50_000_000} {0.1 * i} 0 0.2 0 0.6 0 0.8\n" for i in range(6))
_KITTI = "".join(f"1 0 0 {0.1 * i} 0 1 0 0 0 0 1 {i}\n" for i in range(6))
_NAMED = "ts (ns),tx (m),ty,tz,qx,qy,qz,qw,vx\n" + "".join(f"{i * 50_000_000},{i},0,0,0,0,0,1,9\n" for i in range(6))
_ROS = "%time;header.stamp.secs;header.stamp.nsecs;position.x;position.y;position.z;qw;qx;qy;qz\n" + "".join(
    f"9;0;{i * 50_000_000};{i},5;0;0;1;0;0;0\n" for i in range(6)
)
_EUROC = "#timestamp [ns],x,y,z,qw,qx,qy,qz\n" + "".join(f"{i * 50_000_000},{i},0,0,1,0,0,0,9,9\n" for i in range(6))


def _parse_tum(path: Path) -> None:
    from panobench.datasets.files.trajectory_io import read_tum

    assert len(read_tum(path))


def _parse_answer(folder: Path) -> Parse:
    from panobench.external.trajectory import TrajectoryFormat, read_answer

    times = np.arange(6) * 0.05
    forms = [TrajectoryFormat(kind) for kind in ("tum", "tum-ns", "kitti", "euroc")]  # type: ignore[arg-type]
    forms.append(TrajectoryFormat("tum", inverse=True, index_rate=20.0, T_body_camera=np.eye(4)))

    def parse(path: Path) -> None:
        refusals = []
        for form in forms:
            try:
                found = read_answer(path, form, times)
                assert np.isin(found.times, times).all()
                assert np.isfinite(found.T_wc).all()
            except PanobenchError as error:
                refusals.append(error)
        if len(refusals) == len(forms):
            raise refusals[0]

    return parse


def _parse_import(folder: Path) -> Parse:
    from panobench.external.imported import ImportOptions, read_imported
    from panobench.trajectories.matching import Frames, place

    return lambda path: place(read_imported(path, ImportOptions()), Frames(np.arange(6) * 0.05), path)


_Q = "0.9 0.1 -0.2 0.374165738677"
_COLMAP = "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME\n" + "".join(
    f"{i + 1} {_Q} {0.1 * i} 0 0.2 1 {i:06d}.png\n{'1.0 2.0 -1 3 4 17' * (i % 2)}\n" for i in range(6)
)
_EYE = [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]
_TRANSFORMS = json.dumps(
    {"applied_scale": 0.5, "frames": [{"file_path": f"images/{i:06d}.png", "transform_matrix": _EYE} for i in range(6)]}
)
_MONOGS = json.dumps({"trj_id": [0, 2, 5], "trj_est": [_EYE] * 3, "trj_gt": [_EYE] * 3})
_ROWS16 = "".join(f"1 0 0 {0.1 * i} 0 1 0 0 0 0 1 {i} 0 0 0 1\n" for i in range(6))
_ROWS13 = (
    ",".join(["frame", *(f"r{k}" for k in range(12))])
    + "\n"
    + "".join(f"{i},1,0,0,2,0,1,0,3,0,0,1,4\n" for i in range(6))
)
_BLOCKS = "".join(f"{i} {i} {i + 1}\n1 0 0 {i}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n" for i in range(6))


def _colmap_binary() -> Material:
    data = struct.pack("<Q", 6)
    for i in range(6):
        data += struct.pack("<I7dI", i + 1, 1.0, 0, 0, 0, 0.1 * i, 0, 0, 1) + b"%06d.png\0" % i
        data += struct.pack("<Q", i % 3) + struct.pack("<2dq", 1.0, 2.0, -1) * (i % 3)
    return Material((data,), (b"\xff" * 8, b"\0", b"../x.png", struct.pack("<d", float("nan"))))


def _placed(folder: Path) -> Parse:
    """Read, and matched to frames with names and without."""
    from panobench.trajectories.matching import Frames, place
    from panobench.trajectories.reading import read_poses

    times = np.arange(6) * 0.05
    named = Frames(times, [f"{i:06d}.png" for i in range(6)])

    def parse(path: Path) -> None:
        found = read_poses(path)
        assert np.isfinite(found.T_wc).all()
        placed = place(found, named, path)
        assert (np.diff(placed.index) > 0).all()
        place(found, Frames(times), path)

    return parse


TARGETS = (
    Target("colmap-images", "images.txt", text(_COLMAP, words="000003.png ../x.png nan #"), _placed),
    Target("colmap-images-binary", "images.bin", _colmap_binary, _placed),
    Target("json-trajectory", "transforms.json", text(_TRANSFORMS, _MONOGS, words='"frames" "trj_est" "trj_id" null '
           "[] {} 1e400 true images/000003 000009.png"), _placed),
    Target("matrix-rows", "poses.txt", text(_KITTI, _ROWS16, _ROWS13, _BLOCKS, words="nan frame time , ;"), _placed),
    Target("tum", "trajectory.tum", text(TUM, _TUM_NS, words="nan inf #"), plain(_parse_tum)),
    Target("subprocess-trajectory", "answer.txt", text(TUM.replace("/15", "/20"), _TUM_NS, _KITTI, _EUROC, "", "\n",
           "0 0 0 0 0 0 0 1\n0.05 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n"), _parse_answer),
    Target("imported-trajectory", "theirs.txt", text(TUM, _TUM_NS, _KITTI, _EUROC, _NAMED, _ROS,
           words="time ts [ns] (ms) stamp secs nsecs qw qx q_x orientation.w pos_x ; , #"), _parse_import),
)  # fmt: skip
