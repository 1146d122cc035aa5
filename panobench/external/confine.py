"""Sandbox: start a program that can write only below given folders, by Landlock (Linux 5.13 and later).

Run as a script: ``python confine.py DIR [DIR ...] -- PROGRAM [ARGUMENT ...]``. It needs only the standard library,
so that it starts in milliseconds. Interface: the kernel's Documentation/userspace-api/landlock.rst.
"""

from __future__ import annotations

import ctypes
import os
import sys

_CREATE_RULESET, _ADD_RULE, _RESTRICT_SELF = 444, 445, 446  # system calls, the same on every architecture
_RULE_PATH_BENEATH = 1
_PR_SET_NO_NEW_PRIVS = 38
_WRITE_FILE = 1 << 1
_CHANGE_TREE = sum(1 << bit for bit in range(4, 13))  # create and remove files, folders, links, sockets and devices
_REFER, _TRUNCATE = 1 << 13, 1 << 14  # since interface versions 2 and 3
#: Every program may write to devices (terminals, GPUs, shared memory) and to its own process entries.
_SYSTEM = ("/dev", "/proc")
FAILED = 125


class _Ruleset(ctypes.Structure):
    _fields_ = [("handled_access_fs", ctypes.c_uint64)]


class _PathBeneath(ctypes.Structure):
    _pack_ = 1
    _layout_ = "ms"
    _fields_ = [("allowed_access", ctypes.c_uint64), ("parent_fd", ctypes.c_int32)]


def _syscall(*arguments: object) -> int:
    libc = ctypes.CDLL(None, use_errno=True)
    return int(libc.syscall(*arguments))


def landlock_version() -> int:
    """Version of the kernel's Landlock interface, 0 without one or if it is switched off."""
    if not sys.platform.startswith("linux"):
        return 0
    return max(0, _syscall(_CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(1)))


def confine(writable: list[str]) -> None:
    """Let this process and its children write only below ``writable`` from now on. Raises OSError if that fails."""
    version = landlock_version()
    if version == 0:
        raise OSError("the kernel has no Landlock")
    rights = _WRITE_FILE | _CHANGE_TREE | (_REFER if version >= 2 else 0) | (_TRUNCATE if version >= 3 else 0)
    attributes = _Ruleset(rights)
    ruleset = _syscall(_CREATE_RULESET, ctypes.byref(attributes), ctypes.sizeof(attributes), ctypes.c_uint32(0))
    if ruleset < 0:
        raise OSError(ctypes.get_errno(), "landlock_create_ruleset failed")
    for folder in (*writable, *_SYSTEM):
        if not os.path.isdir(folder):
            continue
        fd = os.open(folder, os.O_PATH | os.O_CLOEXEC)
        rule = _PathBeneath(rights, fd)
        if _syscall(_ADD_RULE, ruleset, _RULE_PATH_BENEATH, ctypes.byref(rule), ctypes.c_uint32(0)):
            raise OSError(ctypes.get_errno(), f"landlock_add_rule failed for {folder}")
        os.close(fd)
    ctypes.CDLL(None).prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)
    if _syscall(_RESTRICT_SELF, ruleset, ctypes.c_uint32(0)):
        raise OSError(ctypes.get_errno(), "landlock_restrict_self failed")
    os.close(ruleset)


def main(arguments: list[str]) -> int:
    split = arguments.index("--")
    try:
        confine(arguments[:split])
    except OSError as error:
        print(f"cannot confine the program to its work folder: {error}", file=sys.stderr)
        return FAILED
    program = arguments[split + 1 :]
    try:
        os.execvp(program[0], program)
    except OSError as error:
        print(f"cannot start {program[0]}: {error.strerror}", file=sys.stderr)
        return 127 if isinstance(error, FileNotFoundError) else 126


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
