"""Handle Ctrl-C: the first asks a run to stop after this frame, the second stops it at once; writing goes on."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any

#: Further signals within so many seconds of one that stopped the work would only hit its tidying up.
_PATIENCE_S = 1.0


class InterruptRequest:
    """A context manager that turns SIGINT and SIGTERM into ``requested``. It acts in the main thread only.

    at_once: raise KeyboardInterrupt at the first signal already, for work that cannot look at ``requested``.
    tell: called at the first signal, from its handler.
    """

    def __init__(self, at_once: bool = False, tell: Callable[[], None] | None = None) -> None:
        self.requested = False
        self.at_once = at_once
        self.tell = tell
        self._raised = float("-inf")
        self._old: dict[int, Any] = {}

    def __enter__(self) -> InterruptRequest:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._old[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._old.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        again, self.requested = self.requested, True
        if again or self.at_once:
            now = time.monotonic()
            if now - self._raised < _PATIENCE_S:
                return
            self._raised = now
            raise KeyboardInterrupt
        if self.tell is not None:
            self.tell()


class KeepWriting:
    """A context manager for what must not be cut off: once ``begin`` is called, SIGINT and SIGTERM are not heard.

    Within ``interruptible`` the first of them raises KeyboardInterrupt. Only acts in the main thread.
    """

    def __init__(self) -> None:
        self._deaf = False
        self._old: dict[int, Any] = {}

    def __enter__(self) -> KeepWriting:
        return self

    def begin(self) -> None:
        """Call it before the handlers of an InterruptRequest are set, which this one's then follow without a gap."""
        if threading.current_thread() is threading.main_thread():
            self._deaf = True
            for number in (signal.SIGINT, signal.SIGTERM):
                self._old[number] = signal.signal(number, self._handle)

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        self._deaf = False
        try:
            yield
        finally:
            self._deaf = True

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._old.items():
            signal.signal(number, handler)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if not self._deaf:
            self._deaf = True
            raise KeyboardInterrupt
