"""Kernels are compiled before anything is timed, by other processes, and what compiles later is noticed."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from numba import njit, typeof, types

from panobench.kernels import ahead
from panobench.kernels.signatures import parse, spell
from panobench.kernels.watch import CompileWatch

KERNELS = """
from numba import njit

@njit(cache=True)
def inner(x):
    return x * 2

@njit(cache=True)
def outer(values, by):
    total = 0.0
    for v in values:
        total += inner(v) * by
    return total

@njit(cache=True)
def other(values):
    return values[::-1].copy()
"""
ENTRIES = [
    ("some_kernels:outer", "(float32[::1], int64,)"),
    ("some_kernels:outer", "(float64[::1], int64,)"),
    ("some_kernels:other", "(float64[::1],)"),
    ("some_kernels:gone", "(float64,)"),
]


def own_cache(tmp_path: Path) -> dict[str, str]:
    """The environment of a process with a kernel cache of its own, to which the kernels above are known."""
    path = os.pathsep.join([str(tmp_path), *(p for p in sys.path if p)])
    return {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": path}


def in_process(tmp_path: Path, code: str) -> list:
    """What a fresh process with its own kernel cache prints, as JSON."""
    (tmp_path / "some_kernels.py").write_text(KERNELS)
    setup = f"""
        import json
        from panobench.kernels.ahead import EntryPoint, compile_ahead
        from panobench.kernels.watch import CompileWatch
        entries = [EntryPoint(f, a, 0.0, ()) for f, a in {ENTRIES!r}]
        steps = []
        import numba
        with CompileWatch() as watch:
            done = compile_ahead(entries, lambda k, n: steps.append([k, n]))
    """
    text = textwrap.dedent(setup) + textwrap.dedent(code)
    done = subprocess.run([sys.executable, "-c", text], env=own_cache(tmp_path), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_other_processes_compile_and_later_runs_load(tmp_path: Path) -> None:
    code = """
        import numpy as np, some_kernels
        with CompileWatch() as late:
            answer = some_kernels.outer(np.ones(3), 2)
        print(json.dumps([done.loaded, done.compiled, steps, len(watch.outermost), len(late.outermost), answer]))
    """
    first, second = in_process(tmp_path, code), in_process(tmp_path, code)
    assert first == [3, 3, [[0, 3], [1, 3], [2, 3], [3, 3]], 0, 0, 12.0]
    assert second == [3, 0, [], 0, 0, 12.0]


def test_a_kernel_of_other_types_compiles_late_and_is_named(tmp_path: Path) -> None:
    code = """
        import numpy as np, some_kernels
        with CompileWatch() as late:
            some_kernels.outer(np.ones(3, np.int32), 2)
        print(json.dumps([[d.py_func.__name__ for d, _, _ in late.outermost], late.seconds > 0, late.note()]))
    """
    names, took, note = in_process(tmp_path, code)
    assert names == ["outer"]  # inner was compiled for its sake
    assert took
    assert note is None or "compiling kernels (outer)" in note


def test_processes_that_compile_variants_at_once_do_not_mix_them_up(tmp_path: Path) -> None:
    code = """
        import json, sys
        import numpy as np
        from panobench.kernels.cache_lock import guard_cache
        guard_cache()
        import some_kernels
        print(some_kernels.other(np.arange(3, dtype=sys.argv[1])).dtype.str)
    """
    (tmp_path / "some_kernels.py").write_text(KERNELS)
    kinds = [np.dtype(k).str for k in ("i1", "i2", "i4", "u1", "u2", "u4")]
    for _ in range(2):  # compiled, then loaded
        commands = [[sys.executable, "-c", textwrap.dedent(code), k] for k in kinds]
        running = [subprocess.Popen(c, env=own_cache(tmp_path), stdout=subprocess.PIPE, text=True) for c in commands]
        assert [p.communicate()[0].strip() for p in running] == kinds
    index = next((tmp_path / "cache").rglob("*other*.nbi"))
    assert len(list(index.parent.glob("*other*.nbc"))) == len(kinds)


@pytest.mark.parametrize(
    "values",
    [
        (np.zeros((2, 3), np.float32), 1, 2.5, True),
        (np.zeros((2, 3, 4), np.uint8, order="F"), np.zeros(3)[::2], None),
        ((1, 2), (0.5, 0.5, 0.5), np.zeros((2, 2), bool)),
        (np.random.default_rng(0),),
    ],
)
def test_types_survive_being_written_down(values: tuple) -> None:
    kinds = tuple(map(typeof, values))
    text = spell(kinds)
    assert text is not None
    assert parse(text) == kinds


def test_types_without_words_are_left_to_be_compiled_late() -> None:
    assert spell((types.unicode_type,)) is None
    frozen = np.zeros(3)
    frozen.setflags(write=False)
    assert spell((typeof(frozen),)) is None
    assert parse(str(spell((types.Omitted(3),)))) == (types.Omitted(3),)


def test_the_record_names_kernels_that_exist_and_whose_types_can_be_read() -> None:
    found = ahead.entry_points()
    assert len(found) > 50
    assert [e.function for e in found if e.dispatcher() is None] == []
    taken = {e.function: len(inspect.signature(e.dispatcher().py_func).parameters) for e in found}
    assert [e.function for e in found if len(parse(e.arguments)) != taken[e.function]] == []  # else record them anew
    assert ahead.entry_points("panogs", "erp", "rooms")
    assert set(ahead.entry_points("panogs", "erp")) <= set(ahead.entry_points("panogs", None))
    assert set(ahead.entry_points("panogs", "no-such-camera")) == set(ahead.entry_points("panogs", None))
    assert ahead.entry_points("nobody's", "erp", "nothing") == []


@pytest.mark.parametrize("method", ["sparse", "panogs"])
def test_the_record_has_what_a_run_calls(method: str, tmp_path: Path) -> None:
    """Run `python scripts/record_kernels.py` when this fails."""
    code = """
        import sys
        from pathlib import Path
        import numba
        from panobench.bench.run.request import RunRequest
        from panobench.bench.run.runner import execute
        from panobench.kernels import ahead
        from panobench.kernels.signatures import spell
        from panobench.kernels.watch import CompileWatch
        with CompileWatch() as watch:
            request = RunRequest(method=sys.argv[1], dataset="rooms", width=64, max_frames=20, check="none")
            execute(request, Path(sys.argv[2]) / "run")
        known = {(e.function, e.arguments) for e in ahead.entry_points()}
        called = [(ahead.name_of(d), spell(t)) for d, t, _ in watch.outermost]
        if not called:  # nothing was compiled: what is loaded was called
            called = [(ahead.name_of(d), spell(t)) for d in ahead.dispatchers() for t in d.signatures]
        print(sorted({name for name, text in called if name and text and (name, text) not in known}))
    """
    command = [sys.executable, "-c", textwrap.dedent(code), method, str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"


def test_nothing_is_noticed_outside_of_the_watch() -> None:
    @njit
    def late(x):
        return x + 1

    with CompileWatch() as watch:
        pass
    late(1)
    assert watch.outermost == []
    with CompileWatch() as watch:
        late(1.5)
    assert [d.py_func.__name__ for d, _, _ in watch.outermost] == ["late"]
