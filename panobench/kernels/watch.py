"""Notices what Numba compiles while a method is timed."""

from __future__ import annotations

import sys
import threading
import time
from types import TracebackType
from typing import Any


class CompileWatch:
    """A context in which compilation is noticed. outermost: (Numba's dispatcher, argument types, seconds) of what was
    compiled; a function compiled for the sake of another counts with that one. Of all threads.

    Where nobody has imported Numba yet, nothing is noticed.
    """

    def __init__(self) -> None:
        self.outermost: list[tuple[Any, tuple[Any, ...], float]] = []
        self._depth: dict[int, list[float]] = {}
        self._listener: Any = None

    def __enter__(self) -> CompileWatch:
        if "numba" in sys.modules:
            from numba.core import event

            watch = self

            class Listener(event.Listener):
                def on_start(self, what: Any) -> None:
                    watch._depth.setdefault(threading.get_ident(), []).append(time.perf_counter())

                def on_end(self, what: Any) -> None:
                    begun = watch._depth[threading.get_ident()]
                    spent = time.perf_counter() - begun.pop()
                    if not begun:
                        watch.outermost.append((what.data["dispatcher"], tuple(what.data["args"]), spent))

            self._listener = Listener()
            event.register("numba:compile", self._listener)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._listener is not None:
            from numba.core import event

            event.unregister("numba:compile", self._listener)

    @property
    def seconds(self) -> float:
        """Spent compiling."""
        return sum(seconds for _, _, seconds in self.outermost)

    def note(self) -> str | None:
        """One line about what was compiled; None for next to nothing."""
        if self.seconds < 0.1:
            return None
        names = sorted({dispatcher.py_func.__name__ for dispatcher, _, _ in self.outermost})
        some = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
        return (
            f"{self.seconds:.1f} s of the measured time went into compiling kernels ({some}): "
            "run it again for its real speed"
        )
