"""Locks on file systems that have none."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from panobench import locking
from panobench.cameras.erp import ErpCamera
from panobench.datasets.writing.writer import SequenceWriter
from panobench.errors import PanobenchWarning, UsageError


@pytest.fixture
def handle(tmp_path: Path) -> Any:
    number = os.open(tmp_path / "lock", os.O_RDWR | os.O_CREAT)
    yield number
    os.close(number)


def test_another_holder_is_noticed(tmp_path: Path, handle: int) -> None:
    assert locking.lock(handle, tmp_path / "lock")
    other = os.open(tmp_path / "lock", os.O_RDWR)
    assert not locking.lock(other, tmp_path / "lock")
    os.close(other)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS, errno.EINVAL])
def test_without_locks_it_goes_on_with_one_warning(
    tmp_path: Path, handle: int, number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", refuse)
    monkeypatch.setattr(locking, "_warned", False)
    with pytest.warns(PanobenchWarning, match="this file system has no locks; start no second panobench"):
        assert locking.lock(handle, tmp_path / "lock")
    assert locking.lock(handle, tmp_path / "lock")  # a second warning would be an error
    with contextlib.closing(SequenceWriter(tmp_path / "out", ErpCamera(16, 8))) as writer:
        writer.add(0, 0.0, np.zeros((8, 16, 3), np.uint8))
        writer.finish()
    assert (tmp_path / "out" / "images" / "000000.png").is_file()


def test_any_other_failure_is_not_taken_for_one(tmp_path: Path, handle: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EIO, "broken")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with pytest.raises(OSError, match="broken"):
        locking.lock(handle, tmp_path / "lock")


def test_a_second_writer_is_still_refused(tmp_path: Path) -> None:
    first = SequenceWriter(tmp_path / "out", ErpCamera(16, 8))
    with pytest.raises(UsageError, match="is being written by another process"):
        SequenceWriter(tmp_path / "out", ErpCamera(16, 8))
    first.close()
