"""Compiling or loading the kernels that a run is going to call, before its clock starts.

Which those are has been recorded (``entry_points.json``, by ``scripts/record_kernels.py``): functions that Python
calls, with their argument types; what they call in turn is compiled with them. What is not in Numba's cache yet is
compiled by several processes at once, then loaded as at every later run: what Numba has compiled in memory may differ
from that in the last bits. A kernel that the record lacks compiles when it is first called, and ``CompileWatch``
tells.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from panobench.kernels.cache_lock import exclusive, guard_cache
from panobench.kernels.signatures import parse

RECORD = Path(__file__).with_name("entry_points.json")
#: A process that compiles needs about 300 MiB.
_MAX_WORKERS = 8


@dataclass(frozen=True)
class EntryPoint:
    """A kernel that Python calls. function: "module:name"; arguments: its types, as ``signatures`` writes them;
    seconds: what compiling it took when it was recorded. users: what calls it, "METHOD/CAMERA" or a dataset.
    """

    function: str
    arguments: str
    seconds: float
    users: tuple[str, ...]

    def dispatcher(self) -> Any:
        """Numba's object for the function; None if there is no such function any more."""
        module, _, name = self.function.partition(":")
        try:
            return getattr(importlib.import_module(module), name, None)
        except ImportError:
            return None


@dataclass(frozen=True)
class Prepared:
    """What ``compile_ahead`` did: kernels that are loaded, how many of them it compiled, and seconds in all."""

    loaded: int = 0
    compiled: int = 0
    seconds: float = 0.0


#: Is told how many kernels are compiled, of how many that are not compiled yet; first of none.
Progress = Callable[[int, int], None]


def entry_points(method: str | None = None, kind: str | None = None, dataset: str | None = None) -> list[EntryPoint]:
    """The recorded kernels of a method with a kind of camera (None: any), and of a dataset; all without a method.

    For a kind that was not recorded, those of any kind: most are the same. Those that take longest come first.
    """
    rows = json.loads(RECORD.read_text(encoding="utf-8"))["entry_points"]
    found = [EntryPoint(r["function"], r["arguments"], r["seconds"], tuple(r["users"])) for r in rows]
    if method is None:
        return found
    exactly = {dataset, f"{method}/{kind}"}
    recorded = any(f"{method}/{kind}" in e.users for e in found)
    prefix = "\0" if recorded else f"{method}/"
    return [e for e in found if exactly & set(e.users) or any(user.startswith(prefix) for user in e.users)]


def compile_ahead(wanted: list[EntryPoint], progress: Progress) -> Prepared:
    """Have kernels compiled and loaded. Never raises: what cannot be compiled here fails when it is called."""
    begin = time.perf_counter()
    if not wanted:
        return Prepared()
    guard_cache()
    missing = [e for e in wanted if not _is_cached(e)]
    if missing:
        with exclusive(_cache_folder(missing[0])):
            missing = [e for e in missing if not _is_cached(e)]  # another process may have compiled them meanwhile
            if missing:
                _compile(missing, progress)
    loaded = sum(load(e) for e in wanted)
    return Prepared(loaded, len(missing), time.perf_counter() - begin)


def dispatchers() -> list[Any]:
    """Numba's objects for the compiled functions of the modules of panobench that are imported."""
    from numba.core.dispatcher import Dispatcher

    modules = [module for name, module in list(sys.modules.items()) if name.split(".")[0] == "panobench"]
    return [
        value
        for module in modules
        for value in list(vars(module).values())
        if isinstance(value, Dispatcher) and value.py_func.__module__ == module.__name__
    ]


def name_of(dispatcher: Any) -> str | None:
    """ "module:name" of a compiled function of panobench that can be found by it, else None."""
    module, name = dispatcher.py_func.__module__, dispatcher.py_func.__name__
    known = module.split(".")[0] == "panobench" and getattr(sys.modules.get(module), name, None) is dispatcher
    return f"{module}:{name}" if known else None


def _compile(missing: list[EntryPoint], progress: Progress) -> None:
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    workers = min(cores, _MAX_WORKERS, len(missing))
    progress(0, len(missing))
    for done, _ in enumerate(_in_processes(missing, workers), start=1):
        progress(done, len(missing))


def _in_processes(missing: list[EntryPoint], workers: int) -> Iterator[object]:
    """Yields whenever one is compiled. A worker that dies leaves its kernel to whoever calls it first."""
    waiting: queue.SimpleQueue[EntryPoint] = queue.SimpleQueue()
    for entry in missing:
        waiting.put(entry)
    finished: queue.SimpleQueue[None] = queue.SimpleQueue()
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in sys.path if p)}
    command = [sys.executable, "-m", "panobench.kernels.compile_worker"]
    processes: list[subprocess.Popen[str]] = []

    def feed(process: subprocess.Popen[str]) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        while True:
            try:
                entry = waiting.get_nowait()
            except queue.Empty:
                break
            with contextlib.suppress(OSError, ValueError):
                process.stdin.write(json.dumps([entry.function, entry.arguments]) + "\n")
                process.stdin.flush()
                process.stdout.readline()
            finished.put(None)
        with contextlib.suppress(OSError, ValueError):
            process.stdin.close()

    try:
        for _ in range(workers):
            processes.append(
                subprocess.Popen(
                    command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.DEVNULL,
                    text=True,
                    env=environment,
                )
            )
        for process in processes:
            threading.Thread(target=feed, args=(process,), daemon=True).start()
        for _ in missing:
            yield finished.get()
        for process in processes:
            process.wait()
    finally:
        for process in processes:
            process.kill()
            process.wait()


def _is_cached(entry: EntryPoint) -> bool:
    """Whether the kernel is loaded, or on disk for this machine and version; False where Numba does not let us see."""
    dispatcher = entry.dispatcher()
    if dispatcher is None:
        return True  # nothing to compile
    try:
        types = parse(entry.arguments)
        if types in dispatcher.overloads:
            return True
        cache = dispatcher._cache
        key = cache._index_key(types, dispatcher.targetctx.codegen())
        return key in cache._cache_file._load_index()
    except Exception:  # Numba's internals are not a promise
        return False


def load(entry: EntryPoint) -> bool:
    """Load the kernel from the cache, or compile it; whether that went well."""
    dispatcher = entry.dispatcher()
    try:
        dispatcher.compile(parse(entry.arguments))
    except Exception:  # a record of other code than this
        return False
    return True


def _cache_folder(entry: EntryPoint) -> Path:
    dispatcher = entry.dispatcher()
    return Path(dispatcher.stats.cache_path)
