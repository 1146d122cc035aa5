"""Handle Ctrl-C: the first asks a run to stop after this frame, the second stops it at once."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType
from typing import Any


class InterruptRequest:
    """A context manager that turns SIGINT and SIGTERM into ``requested``. It acts in the main thread only.

    at_once: raise KeyboardInterrupt at the first signal already, for work that cannot look at ``requested``.
    """

    def __init__(self, at_once: bool = False) -> None:
        self.requested = False
        self.at_once = at_once
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
            raise KeyboardInterrupt
