"""Advisory locks on files, and going on without them where a file system has none (some network and FUSE mounts)."""

from __future__ import annotations

import errno
import fcntl
import warnings
from pathlib import Path

from panobench.errors import PanobenchWarning

#: What flock answers on a file system without locks.
_WITHOUT = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)


def lock(handle: int, path: Path, wait: bool = False) -> bool:
    """Hold the open file ``handle`` exclusively until it is closed. False: another process has it (and not ``wait``).

    On a file system without locks the answer is True, with one warning: two processes could then do the same work.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _WITHOUT:
            raise
        warn_without_locks(path)
    return True


_warned = False


def warn_without_locks(path: Path) -> None:
    """Say once that a second process would not be noticed."""
    global _warned
    if not _warned:
        _warned = True
        warnings.warn(
            f"{path.parent}: this file system has no locks; start no second panobench on the same folder",
            PanobenchWarning,
            stacklevel=3,
        )
