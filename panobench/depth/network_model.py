"""Running a network: ONNX through onnxruntime, TorchScript through torch."""

from __future__ import annotations

import contextlib
import importlib.util
import io
import os
import zipfile
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.depth.network_description import NetworkInput
from panobench.depth.onnx_file import MAX_BYTES, check_contents
from panobench.errors import InputError, UnavailableError, UsageError

F32 = NDArray[np.float32]
ONNX_SUFFIXES = (".onnx",)
TORCH_SUFFIXES = (".pt", ".pts", ".ts", ".torchscript")
#: Users who trust the TorchScript files they name set this to 1: TorchScript is a program that can access files.
TRUST_VARIABLE = "PANOBENCH_TRUST_TORCHSCRIPT"
#: Most values that an output may have.
MAX_VALUES = 1 << 26


class NetworkModel(ABC):
    """A loaded network."""

    def __init__(self, path: Path, description: NetworkInput) -> None:
        self.path, self.description = path, description

    @abstractmethod
    def outputs(self, tensor: F32) -> dict[str | int, Any]:
        """All outputs for one input, by position, and by name if they have one."""

    def output(self, tensor: F32) -> NDArray[Any]:
        """The output that counts, without axes of length 1. Raises InputError where there is none, or no numbers."""
        wanted = self.description.output
        try:
            outputs = self.outputs(tensor)
        except Exception as error:
            raise InputError(f"the network failed: {one_line(error)}", self.path) from error
        if wanted not in outputs:
            names = ", ".join(k for k in outputs if isinstance(k, str)) or f"{len(outputs)} without names"
            raise InputError(f"the network has no output '{wanted}'; it has {names}", self.path)
        answer = np.asarray(outputs[wanted])
        if answer.size > MAX_VALUES or answer.dtype.kind not in "fiu":
            raise InputError(
                f"output '{wanted}' has {answer.size} values of type {answer.dtype}: no picture", self.path
            )
        return answer.reshape([n for n in answer.shape if n != 1])

    def __call__(self, tensor: F32) -> F32:
        """The output (h, w), one value per pixel in the network's own unit. Raises InputError for another shape."""
        answer = self.output(tensor)
        if answer.ndim != 2:
            raise InputError(
                f"output '{self.description.output}' has shape {answer.shape}; one value a pixel is needed", self.path
            )
        self.check_aspect(answer)
        return np.ascontiguousarray(answer, dtype=np.float32)

    def check_aspect(self, answer: NDArray[Any]) -> None:
        """Raises InputError where an output (h, w) has not the input's proportions."""
        h, w = answer.shape
        if abs(w * self.description.height - h * self.description.width) > max(h, w):
            wanted = self.description.output
            raise InputError(f"output '{wanted}' is {w}x{h}, another aspect ratio than the input's", self.path)


class OnnxModel(NetworkModel):
    """ONNX on the CPU, without custom operators and without files from outside the network's folder."""

    def __init__(self, path: Path, description: NetworkInput) -> None:
        super().__init__(path, description)
        check_contents(path)
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = worker_threads()
        options.inter_op_num_threads = 1
        options.log_severity_level = 4
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            with contextlib.redirect_stdout(io.StringIO()):  # onnxruntime prints banners about damaged files
                self._session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
            # onnxruntime notices some faults, such as names that are no text, only when they are read
            inputs = [(i.name, i.type, i.shape) for i in self._session.get_inputs()]
            self._outputs = [o.name for o in self._session.get_outputs()]
        except Exception as error:  # onnxruntime has no common base class for its errors
            raise InputError(f"onnxruntime cannot load it: {one_line(error)}", path) from None
        if len(inputs) != 1:
            names = ", ".join(name for name, _, _ in inputs)
            raise InputError(f"the network has {len(inputs)} inputs ({names}); export it with the image alone", path)
        self._name, kind, shape = inputs[0]
        self._type = _INPUT_TYPES.get(kind)
        if self._type is None:
            raise InputError(f"the network's input is {kind}; float32 or float16 is needed", path)
        _check_shape(shape, description, path)

    def outputs(self, tensor: F32) -> dict[str | int, Any]:
        values = self._session.run(None, {self._name: tensor.astype(self._type)})
        out: dict[str | int, Any] = dict(enumerate(values))
        out.update(zip(self._outputs, values))
        return out


class TorchScriptModel(NetworkModel):
    """A TorchScript archive. Loading it runs a program, so the user has to say that it is trusted."""

    def __init__(self, path: Path, description: NetworkInput) -> None:
        super().__init__(path, description)
        _check_archive(path)
        import torch

        try:
            self._module = torch.jit.load(str(path), map_location="cpu").eval()
        except Exception as error:
            raise InputError(f"torch cannot load it: {one_line(error)}", path) from None

    def outputs(self, tensor: F32) -> dict[str | int, Any]:
        import torch

        with torch.no_grad():
            answer = self._module(torch.from_numpy(tensor))
        named = {str(k): v for k, v in answer.items()} if isinstance(answer, dict) else {}
        values = list(answer) if isinstance(answer, (tuple, list)) else list(named.values()) or [answer]
        found: dict[str | int, Any] = dict(enumerate(values))
        found.update(named)
        return {k: v.float().numpy() for k, v in found.items() if isinstance(v, torch.Tensor)}


def load_model(path: Path, description: NetworkInput) -> NetworkModel:
    """Load a network by its suffix. Raises InputError, UsageError (untrusted TorchScript) or UnavailableError."""
    check_loadable(path)
    return (OnnxModel if path.suffix.lower() in ONNX_SUFFIXES else TorchScriptModel)(path, description)


def check_loadable(path: Path) -> None:
    """Check what can be checked without reading the file. Raises the errors of ``load_model``."""
    suffix = path.suffix.lower()
    if suffix not in ONNX_SUFFIXES + TORCH_SUFFIXES:
        known = ", ".join(ONNX_SUFFIXES + TORCH_SUFFIXES)
        raise InputError(f"a network's file ends in one of {known}; export it first (docs/depth.md)", path)
    if not path.is_file():
        raise InputError("there is no such network", path)
    if suffix in ONNX_SUFFIXES and importlib.util.find_spec("onnxruntime") is None:
        raise UnavailableError("ONNX networks need the Python package 'onnxruntime': pip install 'panobench[onnx]'")
    if suffix in TORCH_SUFFIXES and os.environ.get(TRUST_VARIABLE) != "1":
        raise UsageError(
            f"{path}: TorchScript is a program that can read and write your files; if you trust it, set "
            f"{TRUST_VARIABLE}=1, or use ONNX"
        )


def one_line(error: BaseException) -> str:
    """The error's message in one line of bounded length. TorchScript's last line says most."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
    text = lines[0] if len(lines) == 1 else f"{lines[0]} ... {lines[-1]}"
    return text if len(text) <= 300 else text[:297] + "..."


def worker_threads() -> int:
    """Processors that this process may use, at most OMP_NUM_THREADS."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(usable, int(asked)) if asked.isdecimal() else usable)


_INPUT_TYPES = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


def _check_shape(shape: list[Any], description: NetworkInput, path: Path) -> None:
    expected = description.input_shape
    fits = len(shape) == 4 and all(not isinstance(n, int) or n < 1 or n == m for n, m in zip(shape, expected))
    if not fits:
        raise InputError(
            f"the network's input is {'x'.join(map(str, shape))}, its description says {'x'.join(map(str, expected))}",
            path,
        )


def _check_archive(path: Path) -> None:
    """Raises InputError unless it is a TorchScript zip of bounded size. Bare weights and pickles are refused."""
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (OSError, zipfile.BadZipFile, NotImplementedError):
        raise InputError("not a TorchScript archive; make one with torch.jit.trace(...).save(...)", path) from None
    if sum(e.file_size for e in entries) > MAX_BYTES:
        raise InputError(f"over {MAX_BYTES >> 30} GiB unpacked, too large for a network", path)
    names = {e.filename.partition("/")[2] for e in entries}
    if "constants.pkl" not in names or not any(n.startswith("code/") for n in names):
        raise InputError("weights without a network; export it with torch.jit.trace(...).save(...)", path)
