"""A process that compiles kernels into Numba's cache: a JSON line [function, arguments] in, a line out when done."""

from __future__ import annotations

import json
import sys

from panobench.kernels.ahead import EntryPoint, load
from panobench.kernels.cache_lock import guard_cache


def main() -> None:
    """Until standard input ends."""
    answers, sys.stdout = sys.stdout, sys.stderr  # nothing else may write there
    guard_cache()
    for line in sys.stdin:
        function, arguments = json.loads(line)
        ok = load(EntryPoint(function, arguments, 0.0, ()))
        print("compiled" if ok else "failed", file=answers, flush=True)


if __name__ == "__main__":
    main()
