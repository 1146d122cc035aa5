"""Runs inside MonoGS's environment: python export_all.py HOME CONFIG OUT starts HOME/slam.py on CONFIG.

MonoGS calls ``eval_ate(frames, keyframes, ..., final=True)`` of ``utils.slam_frontend`` at the end, with the cameras of
all frames; their poses (R, T world-to-camera) go to OUT as TUM rows, camera-to-world, time = frame / 10.
"""

from __future__ import annotations

import os
import runpy
import sys
from typing import Any


def quaternion(R: Any) -> Any:
    """(x, y, z, w) of a 3x3 rotation (Shepperd 1978)."""
    import numpy as np

    candidates = np.array([R[0, 0], R[1, 1], R[2, 2], np.trace(R)])
    i = int(candidates.argmax())
    q = np.zeros(4)
    if i == 3:
        q[:] = [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], 1 + np.trace(R)]
    else:
        j, k = (i + 1) % 3, (i + 2) % 3
        q[i] = 1 + 2 * R[i, i] - np.trace(R)
        q[j], q[k] = R[j, i] + R[i, j], R[k, i] + R[i, k]
        q[3] = R[k, j] - R[j, k]
    return q / np.linalg.norm(q)


def write_tum(path: str, frames: Any, wanted: Any) -> None:
    """Poses of the frames whose numbers are wanted, in order."""
    import numpy as np

    with open(path, "w") as file:
        for i in sorted(wanted):
            R = np.asarray(frames[i].R.detach().cpu().numpy(), dtype=np.float64)
            t = np.asarray(frames[i].T.detach().cpu().numpy(), dtype=np.float64)
            values = [*(-R.T @ t), *quaternion(R.T)]
            file.write(f"{i / 10:.6f} " + " ".join(repr(float(v)) for v in values) + "\n")


def main(home: str, config: str, out: str) -> None:
    sys.path.insert(0, home)
    os.environ["PYTHONPATH"] = home  # for the processes MonoGS spawns
    from utils import slam_frontend

    original = slam_frontend.eval_ate

    def with_export(frames: Any, kf_ids: Any, *arguments: Any, **options: Any) -> Any:
        if options.get("final"):
            write_tum(out, frames, frames)
            write_tum(os.path.join(os.path.dirname(out), "keyframes.tum"), frames, kf_ids)
        return original(frames, kf_ids, *arguments, **options)

    slam_frontend.eval_ate = with_export
    script = os.path.join(home, "slam.py")
    sys.argv = [script, "--config", config]
    runpy.run_path(script, run_name="__main__")


if __name__ == "__main__":
    main(*sys.argv[1:4])
