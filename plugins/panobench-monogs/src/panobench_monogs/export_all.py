"""Runs inside MonoGS's environment: ``python export_all.py HOME CONFIG FOLDER`` starts HOME/slam.py on CONFIG.

After the last frame, MonoGS's front end calls ``eval_ate(cameras, keyframes, ..., final=True)`` and then
``save_gaussians(gaussians, ..., final=True)`` of ``utils.slam_frontend``. Both are replaced: FOLDER gets all.tum,
keyframes.tum (camera to world, time = frame / 10) and map.ply. Then the process ends without MonoGS's own shutdown,
in which its back end sometimes hangs.
"""

from __future__ import annotations

import multiprocessing
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


def world_to_camera(camera: Any) -> tuple[Any, Any]:
    """R (3, 3) and t (3,) of a MonoGS camera. Newer versions keep both in T, a 4x4 matrix."""
    import numpy as np

    T = np.asarray(camera.T.detach().cpu().numpy(), dtype=np.float64)
    if T.shape == (4, 4):
        return T[:3, :3], T[:3, 3]
    return np.asarray(camera.R.detach().cpu().numpy(), dtype=np.float64), T


def write_tum(path: str, cameras: Any, numbers: Any) -> None:
    """The poses of the cameras with these frame numbers, in order."""
    with open(path, "w") as file:
        for i in sorted(numbers):
            R, t = world_to_camera(cameras[i])
            values = [*(-R.T @ t), *quaternion(R.T)]
            file.write(f"{i / 10:.6f} " + " ".join(repr(float(v)) for v in values) + "\n")


def end_at_once() -> None:
    """End this process and those that it started."""
    for child in multiprocessing.active_children():
        child.kill()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(0)


def main(home: str, config: str, folder: str) -> None:
    sys.path.insert(0, home)
    os.environ["PYTHONPATH"] = home  # for the processes that MonoGS starts
    from utils import slam_frontend

    original_eval, original_save = slam_frontend.eval_ate, slam_frontend.save_gaussians

    def export_poses(cameras: Any, keyframes: Any, *arguments: Any, **options: Any) -> Any:
        if not options.get("final"):
            return original_eval(cameras, keyframes, *arguments, **options)
        # a reset starts a new map in another world, and leaves the cameras of the old one where they are
        first = min(keyframes)
        print(f"MonoGS's last map starts at frame {first}", flush=True)
        write_tum(os.path.join(folder, "all.tum"), cameras, [i for i in cameras if i >= first])
        write_tum(os.path.join(folder, "keyframes.tum"), cameras, keyframes)
        return None

    def export_map(gaussians: Any, *arguments: Any, **options: Any) -> Any:
        if not options.get("final"):
            return original_save(gaussians, *arguments, **options)
        gaussians.save_ply(os.path.join(folder, "map.ply"))
        return end_at_once()

    slam_frontend.eval_ate, slam_frontend.save_gaussians = export_poses, export_map
    script = os.path.join(home, "slam.py")
    sys.argv = [script, "--config", config]
    runpy.run_path(script, run_name="__main__")


if __name__ == "__main__":
    main(*sys.argv[1:4])
