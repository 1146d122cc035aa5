"""Record which kernels the built-in methods call, with their types: panobench/kernels/entry_points.json.

Runs every built-in method that has kernels on a few seconds of a built-in room, each in a process of its own, so that
what one loads does not count for another. Run it after kernels or their callers have changed:

    python scripts/record_kernels.py            # with a cache of its own: everything is compiled, some minutes
    python scripts/record_kernels.py sparse     # some methods; the others' entries stay
    python scripts/record_kernels.py direct --cache DIR     # and what the ones before compiled is not compiled again
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from panobench.kernels.ahead import RECORD, entry_points

#: Method -> runs that between them call its usual kernels: camera kind, and other options. `localise` calls some of
#: those of panogs, and needs a map first: its users are marked by hand.
RUNS: dict[str, list[dict[str, object]]] = {
    "sparse": [{"camera": "erp"}, {"camera": "pinhole"}, {"camera": "pal"}],
    "direct": [{"camera": "erp"}, {"camera": "pinhole"}, {"camera": "pal"}],
    "panogs": [{"camera": "erp"}, {"camera": "erp", "preset": "fast"}, {"camera": "pinhole"}],
    "monogs": [{"camera": "erp"}, {"camera": "pinhole"}],
    "photoslam": [{"camera": "erp"}, {"camera": "pinhole"}],
    "reconstruct": [{"camera": "erp"}, {"camera": "pinhole"}],
}
#: Cameras whose kernels are the same as those of the one that is run.
LIKE = {"pal": ("fisheye", "ds", "eucm", "omni", "cubemap")}


def main() -> None:
    """Record the methods named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("methods", nargs="*", metavar="METHOD", help=f"of {', '.join(RUNS)}; default: all")
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--cache", type=Path, help="a folder that keeps what is compiled for the next call")
    parser.add_argument("--camera", nargs="*", help="kinds of camera to run; kinds without a record use those of any")
    arguments = parser.parse_args()
    methods = arguments.methods or list(RUNS)
    known = entry_points()
    seconds = {(e.function, e.arguments): e.seconds for e in known}
    users = {(e.function, e.arguments): {u for u in e.users if u.partition("/")[0] not in methods} for e in known}
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.cache or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for method in methods:
            for options in RUNS[method]:
                if arguments.camera and options["camera"] not in arguments.camera:
                    continue
                # The first run compiles; in the second nothing is loaded for another kernel's sake.
                first, second = (one_run(method, options, arguments.frames, folder) for _ in range(2))
                seconds.update({(f, a): s for f, a, s in first["compiled"]})
                kind = str(options["camera"])
                for function, types in [*((f, a) for f, a, _ in first["compiled"]), *second["loaded"]]:
                    of_rooms = function.startswith("panobench.rooms.")
                    who = ["rooms"] if of_rooms else [f"{method}/{k}" for k in (kind, *LIKE.get(kind, ()))]
                    users.setdefault((function, types), set()).update(who)
                print(f"{method} {options}: {len(second['loaded'])} kernels", flush=True)
    rows = [
        {"function": f, "arguments": a, "seconds": round(seconds.get((f, a), 0.0), 2), "users": sorted(who)}
        for (f, a), who in users.items()
        if who
    ]
    rows.sort(key=lambda row: (-float(str(row["seconds"])), str(row["function"]), str(row["arguments"])))
    lines = ",\n".join(f" {json.dumps(row)}" for row in rows)
    RECORD.write_text(f'{{"entry_points": [\n{lines}\n]}}\n', encoding="utf-8")
    print(f"{RECORD}: {len(rows)} kernels, {sum(float(str(r['seconds'])) for r in rows):.0f} s to compile them all")


def one_run(method: str, options: dict[str, object], frames: int, folder: Path) -> dict[str, list[Any]]:
    """compiled: [function, arguments, seconds] of what Python called and had to be compiled; loaded: [function,
    arguments] of all that was loaded or compiled, for whatever reason.
    """
    request = {"method": method, "dataset": "rooms", "sequence": "room1", "width": 128, "max_frames": frames, **options}
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(folder / "kernels"),
        "PANOBENCH_CACHE": str(folder / "rooms"),
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
    }
    command = [sys.executable, __file__, "--child", json.dumps(request), str(folder)]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    found: dict[str, list[Any]] = json.loads(done.stdout.splitlines()[-1])
    return found


def child(request: str, folder: str) -> None:
    """Run without compiling anything ahead, and print the kernels that were called."""
    from panobench.bench.run.request import RunRequest
    from panobench.bench.run.runner import execute
    from panobench.kernels import ahead
    from panobench.kernels.signatures import spell
    from panobench.kernels.watch import CompileWatch

    ahead.RECORD = Path(folder) / "none.json"
    ahead.RECORD.write_text('{"entry_points": []}')
    import numba  # noqa: F401 - so that the watch sees everything

    with CompileWatch() as watch:
        execute(RunRequest(**json.loads(request)), Path(folder) / "run", force=True)
    compiled = [[ahead.name_of(d), spell(types), round(s, 2)] for d, types, s in watch.outermost]
    loaded = [[ahead.name_of(d), spell(types)] for d in ahead.dispatchers() for types in d.signatures]
    ours = [row for row in compiled if row[0] and row[1]], [row for row in loaded if row[0] and row[1]]
    print(json.dumps(dict(zip(("compiled", "loaded"), ours))))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        child(*sys.argv[2:])
    else:
        main()
