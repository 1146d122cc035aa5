"""Are the answers of the built-in methods still the same to the bit? For a change that should not change them.

    python benchmarks/unchanged.py record before.json        # on the commit before
    python benchmarks/unchanged.py compare before.json       # on the commit after; exit code 1 if an answer differs
    python benchmarks/unchanged.py compare before.json --only panogs sparse

An answer is the trajectory and the Gaussian map of a short run. Answers depend on the processor and on the versions
of the libraries, so a record is of use on the machine that made it and nowhere else.

A kernel rounds differently in the process that compiles it than in those that load it from Numba's cache, because the
compiler optimises a parallel loop once more for the cache. Each case therefore runs in a process of its own, and again
in a new one until nothing was compiled; a record made before this rule held has to be made again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from numba.core import event

from panobench.bench.records.record import read_record
from panobench.bench.run.request import RunRequest
from panobench.bench.run.runner import execute

#: Exit code of a process whose answer does not count.
_COMPILED = 75
#: Short runs by name: every built-in method, and panogs through each of its ways.
CASES: dict[str, RunRequest] = {
    "panogs": RunRequest(sequence="room1", width=256, max_frames=60),
    "panogs-holdout": RunRequest(sequence="room5", width=256, max_frames=48, holdout=8),
    "panogs-fast": RunRequest(sequence="room3", width=256, max_frames=40, preset="fast"),
    "panogs-paper": RunRequest(sequence="tiny", width=128, max_frames=12, preset="paper"),
    "panogs-fov": RunRequest(sequence="room2", width=256, max_frames=50, fov="120"),
    "panogs-pinhole": RunRequest(sequence="room1", width=192, max_frames=30, camera="pinhole:front"),
    "panogs-revisit": RunRequest(sequence="loop", width=128, max_frames=600, preset="fast"),
    "monogs": RunRequest(
        method="monogs", sequence="tiny", width=128, max_frames=12, preset="fast", camera="pinhole:front"
    ),
    "photoslam": RunRequest(method="photoslam", sequence="room1", width=256, max_frames=25),
    "sparse": RunRequest(method="sparse", sequence="room1", width=512, max_frames=40),
    "direct": RunRequest(method="direct", sequence="room1", width=256, max_frames=40),
    "reconstruct": RunRequest(method="reconstruct", sequence="tiny", width=128, max_frames=20, preset="fast"),
}  # fmt: skip


def answer(request: RunRequest) -> dict[str, Any]:
    """The run's status and figures, and digests of its trajectory and its map."""
    with tempfile.TemporaryDirectory() as folder:
        done = execute(request, Path(folder) / "run")
        record = read_record(done)
        found: dict[str, Any] = {"status": record.status, "frames": record.frames.tracked}
        found["ate_rmse_m"] = record.number("ate_rmse_m")
        for name in ("trajectory.tum", "map.ply"):
            path = done / name
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None
        return found


def answer_here(name: str) -> int:
    """Print the answer as JSON; exit code 75 if a kernel was compiled on the way."""
    with event.install_recorder("numba:compile") as recorder:
        print(json.dumps(answer(CASES[name])))
    return _COMPILED if recorder.buffer else 0


def answer_of(name: str) -> dict[str, Any]:
    """The case's answer from a process that loaded every kernel from the cache."""
    while True:
        command = [sys.executable, __file__, "answer", name]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
        if done.returncode == 0:
            return dict(json.loads(done.stdout.splitlines()[-1]))
        if done.returncode != _COMPILED:
            sys.exit(f"{name}: the run failed")


def main() -> int:
    if sys.argv[1:2] == ["answer"]:
        return answer_here(sys.argv[2])
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("record", "compare"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE", help=", ".join(CASES))
    arguments = parser.parse_args()
    before = json.loads(arguments.file.read_text(encoding="utf-8")) if arguments.what == "compare" else {}
    answers, differing = {}, 0
    for name in arguments.only:
        answers[name] = answer_of(name)
        if arguments.what == "record":
            print(name, answers[name], flush=True)
            continue
        old = before.get(name, {})
        changed = [key for key, value in answers[name].items() if old.get(key) != value]
        differing += bool(changed)
        was = ", ".join(f"{key} {old.get(key)} -> {answers[name][key]}" for key in changed)
        print(f"{name:16}{'the same' if not changed else was}", flush=True)
    if arguments.what == "record":
        arguments.file.write_text(json.dumps(answers, indent=2) + "\n", encoding="utf-8")
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
