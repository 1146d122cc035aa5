"""Trajectory files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
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
    from panobench.datasets.trajectory_io import read_tum

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

    return lambda path: read_imported(path, ImportOptions(), np.arange(6) * 0.05)


TARGETS = (
    Target("tum", "trajectory.tum", text(TUM, _TUM_NS, words="nan inf #"), plain(_parse_tum)),
    Target("subprocess-trajectory", "answer.txt", text(TUM.replace("/15", "/20"), _TUM_NS, _KITTI, _EUROC, "", "\n",
           "0 0 0 0 0 0 0 1\n0.05 0 0 0 0 0 0 1\n0.1 1 0 0 0 0 0 1\n"), _parse_answer),
    Target("imported-trajectory", "theirs.txt", text(TUM, _TUM_NS, _KITTI, _EUROC, _NAMED, _ROS,
           words="time ts [ns] (ms) stamp secs nsecs qw qx q_x orientation.w pos_x ; , #"), _parse_import),
)  # fmt: skip
