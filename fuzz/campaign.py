"""Feed damaged documents to parsers and keep what crashes them: ``python fuzz/campaign.py [TARGET ...]``.

Single-threaded. A crash is any exception but a PanobenchError, an input that takes longer than --seconds, or one
that needs more memory than --gib. Inputs that crash are written to --crashes, one per place in the code.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import math
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

sys.path.insert(0, str(Path(__file__).resolve().parent))

from mutate import change, damaged
from targets import TARGETS, material


class TooSlow(BaseException):
    """An input exceeded its time."""


class Campaign:
    """Counts what happens to a target's inputs. ``feed`` never raises."""

    def __init__(self, name: str, run: Callable[[bytes], str], crashes: Path, seconds: float) -> None:
        self.name, self.run, self.crashes, self.seconds = name, run, crashes, seconds
        self.read = self.refused = 0
        self.slowest = 0.0
        self.messages: Counter[str] = Counter()
        self.found: dict[str, str] = {}
        self.seen: set[bytes] = set()

    @property
    def inputs(self) -> int:
        return self.read + self.refused + sum(self.messages.values())

    def feed(self, data: bytes) -> None:
        self.seen.add(hashlib.blake2b(data, digest_size=8).digest())
        clock = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, self.seconds)  # of the processor: the machine may be busy
        try:
            message = self.run(data)
        except (Exception, TooSlow) as error:
            self._crash(data, error)
            return
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            self.slowest = max(self.slowest, time.process_time() - clock)
        if message:
            self.refused += 1
            if "\n" in message.strip() and "Traceback" in message:
                self._crash(data, ValueError(message))
        else:
            self.read += 1

    def _crash(self, data: bytes, error: BaseException) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [f for f in frames if "panobench" in f.filename] or frames
        where = f"{type(error).__name__} at {Path(ours[-1].filename).name}:{ours[-1].lineno} {ours[-1].name}"
        self.messages[where] += 1
        if where in self.found:
            return
        self.found[where] = str(error)[:200]
        place = self.crashes / self.name
        place.mkdir(parents=True, exist_ok=True)
        stem = hashlib.sha256(where.encode()).hexdigest()[:10]
        (place / f"{stem}.input").write_bytes(data)
        text = "".join(traceback.format_exception(error))
        (place / f"{stem}.txt").write_text(f"{where}\n{text}", encoding="utf-8", errors="replace")

    def summary(self, seconds: float) -> dict[str, object]:
        return {
            "target": self.name,
            "inputs": self.inputs,
            "distinct": len(self.seen),
            "read": self.read,
            "refused": self.refused,
            "crashes": sum(self.messages.values()),
            "places": dict(self.messages),
            "slowest_s": round(self.slowest, 3),
            "seconds": round(seconds, 1),
        }


def with_random(campaign: Campaign, inputs: int, seed: int, until: float = math.inf) -> None:
    """Uniformly random documents and one to six changes, ten times as fast as Hypothesis."""
    rng = random.Random(seed)
    start = material(campaign.name)
    for _ in range(inputs):
        if time.perf_counter() > until:
            break
        changes = [change(rng.getrandbits(51)) for _ in range(rng.randint(1, 6))]
        campaign.feed(damaged(start, rng.getrandbits(16), changes))


def with_hypothesis(campaign: Campaign, inputs: int, seed: int, until: float = math.inf) -> None:
    """Hypothesis draws the document and up to six changes, each as one number."""
    from hypothesis import HealthCheck, Phase, given, settings
    from hypothesis import seed as seeded
    from hypothesis import strategies as st

    start = material(campaign.name)
    numbers = st.lists(st.integers(0, (1 << 51) - 1), min_size=2, max_size=7)  # few draws: Hypothesis takes its time
    # Hypothesis keeps a tree of all it has drawn; batches bound its memory and the time to search it.
    batch, done = 5000, 0
    while done < inputs and time.perf_counter() < until:
        n = min(batch, inputs - done)

        @seeded(seed * 1_000_003 + done)
        @settings(
            max_examples=n,
            deadline=None,
            database=None,
            phases=[Phase.generate],
            suppress_health_check=list(HealthCheck),
        )
        @given(numbers)
        def go(drawn: list[int]) -> None:
            campaign.feed(damaged(start, drawn[0], map(change, drawn[1:])))

        go()
        done = campaign.inputs


@contextlib.contextmanager
def limits(gib: float) -> Iterator[None]:
    """Memory limit for the process, an alarm that raises, and no core dumps."""

    def late(_: int, __: FrameType | None) -> None:
        raise TooSlow

    signal.signal(signal.SIGPROF, late)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + int(gib * 2**30), resource.RLIM_INFINITY))
    yield


def run_target(name: str, options: argparse.Namespace) -> dict[str, object]:
    """One target in this process."""
    base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    with tempfile.TemporaryDirectory(prefix="fuzz-", dir=base) as folder:
        run = TARGETS[name].runner(Path(folder))
        for document in material(name).documents:  # warm up: imports belong to no input
            with contextlib.suppress(Exception):
                run(document)
        campaign = Campaign(name, run, options.crashes, options.seconds)
        clock = time.perf_counter()
        with limits(options.gib):
            engine = with_random if options.engine == "random" else with_hypothesis
            engine(campaign, options.inputs, options.seed, clock + options.limit)
        return campaign.summary(time.perf_counter() - clock)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"default: all of {', '.join(TARGETS)}")
    parser.add_argument("--inputs", type=int, default=100_000, help="inputs per target")
    parser.add_argument("--verbose", action="store_true", help="show what parsers print")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0, help="longest processor time for one input")
    parser.add_argument("--gib", type=float, default=2.0, help="memory an input may take beside what is loaded")
    parser.add_argument(
        "--limit", type=float, default=math.inf, help="seconds after which a target ends with what it did"
    )
    parser.add_argument("--engine", choices=("random", "hypothesis"), default="random")
    parser.add_argument("--crashes", type=Path, default=Path("fuzz-crashes"))
    options = parser.parse_args()
    for name in options.targets:
        if name not in TARGETS:
            parser.error(f"no target '{name}'; there are {', '.join(TARGETS)}")
    bad = False
    for name in options.targets or TARGETS:
        pid = os.fork()  # each target in a process of its own: a segmentation fault ends only that one
        if pid == 0:
            if not options.verbose:  # image decoders talk about every damaged picture
                os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            found = run_target(name, options)
            print(json.dumps({**found, "engine": options.engine, "seed": options.seed}), flush=True)
            os._exit(1 if found["crashes"] else 0)
        _, status = os.waitpid(pid, 0)
        if os.WIFSIGNALED(status):
            print(json.dumps({"target": name, "died": f"signal {os.WTERMSIG(status)}"}), flush=True)
        bad |= status != 0
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
