"""Compiling the kernels by NVRTC, NVIDIA's run-time compiler: a library, so that nobody needs a CUDA toolkit.

What was compiled is kept, because it takes seconds; the name of the file is a digest of all that it depends on.
"""

from __future__ import annotations

import contextlib
import ctypes
import hashlib
import importlib.util
import os
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from panobench.gpu.errors import DeviceError
from panobench.gpu.source import source

#: How to get it, for messages.
HOW = "install it by `pip install 'panobench[gpu]'`"
_OPTIONS = ("--std=c++17",)


@cache
def library() -> ctypes.CDLL:
    """NVRTC: of the wheels that torch or the extra `gpu` brings, else the system's. Raises DeviceError without one."""
    for path in _candidates():
        with contextlib.suppress(OSError):
            return ctypes.CDLL(path)
    raise DeviceError(f"NVRTC, the compiler of the GPU's kernels, is missing: {HOW}")


def _candidates() -> Iterator[str]:
    spec = importlib.util.find_spec("nvidia")
    for folder in spec.submodule_search_locations or () if spec else ():
        # nvidia/cuda_nvrtc/lib (CUDA 12), nvidia/cu13/lib
        yield from (str(p) for p in sorted(Path(folder).glob("*/lib/libnvrtc.so.*"), reverse=True))
    yield from (f"libnvrtc.so.{major}" for major in (13, 12))
    yield "libnvrtc.so"
    root = os.environ.get("CUDA_PATH", "/usr/local/cuda")
    yield from (str(p) for p in sorted(Path(root).glob("lib64/libnvrtc.so*")))


def version() -> str:
    major, minor = ctypes.c_int(), ctypes.c_int()
    _check(library().nvrtcVersion(ctypes.byref(major), ctypes.byref(minor)), "asking NVRTC for its version")
    return f"{major.value}.{minor.value}"


def architectures() -> list[str]:
    """The architectures that this NVRTC compiles for: "sm_90", ..."""
    count = ctypes.c_int()
    _check(library().nvrtcGetNumSupportedArchs(ctypes.byref(count)), "asking NVRTC for its architectures")
    found = (ctypes.c_int * count.value)()
    _check(library().nvrtcGetSupportedArchs(found), "asking NVRTC for its architectures")
    return [f"sm_{n}" for n in found]


def compiled(architecture: str) -> bytes:
    """The kernels for an architecture, from the cache where they are. Raises DeviceError."""
    text = source().encode()
    key = hashlib.sha256(text + repr((architecture, _OPTIONS, version())).encode()).hexdigest()[:24]
    kept = cache_folder() / f"{architecture}-{key}.cubin"
    with contextlib.suppress(OSError):
        return kept.read_bytes()
    code = compile_source(text, architecture)
    with contextlib.suppress(OSError):  # a cache that cannot be written costs seconds, no more
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(f".{os.getpid()}")
        part.write_bytes(code)
        part.replace(kept)
    return code


def cache_folder() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "panobench" / "cuda"


def compile_source(text: bytes, architecture: str) -> bytes:
    """Machine code (a cubin) of CUDA C. Raises DeviceError with the compiler's words if it does not compile."""
    lib, program = library(), ctypes.c_void_p()
    options = [f"--gpu-architecture={architecture}", *_OPTIONS]
    table = (ctypes.c_char_p * len(options))(*[o.encode() for o in options])
    _check(lib.nvrtcCreateProgram(ctypes.byref(program), text, b"panobench.cu", 0, None, None), "NVRTC")
    try:
        if lib.nvrtcCompileProgram(program, len(options), table):
            log = _bytes(lib.nvrtcGetProgramLogSize, lib.nvrtcGetProgramLog, program).rstrip(b"\0")
            raise DeviceError(f"the kernels do not compile for {architecture}: {log.decode(errors='replace').strip()}")
        return _bytes(lib.nvrtcGetCUBINSize, lib.nvrtcGetCUBIN, program)
    finally:
        lib.nvrtcDestroyProgram(ctypes.byref(program))


def _bytes(size_of: Any, get: Any, program: ctypes.c_void_p) -> bytes:
    size = ctypes.c_size_t()
    _check(size_of(program, ctypes.byref(size)), "NVRTC")
    buffer = ctypes.create_string_buffer(size.value)
    _check(get(program, buffer), "NVRTC")
    return buffer.raw


def _check(status: int, what: str) -> None:
    if status:
        raise DeviceError(f"{what} failed with NVRTC's error {status}")
