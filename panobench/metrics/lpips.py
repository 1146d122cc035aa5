"""LPIPS with AlexNet features, from weights that are found on this machine. Without them the value is "n/a".

Zhang et al., "The unreasonable effectiveness of deep features as a perceptual metric" (2018), version 0.1.
``$PANOBENCH_LPIPS`` names a folder with the two files as their publishers name them: AlexNet's weights
(``alexnet-owt-*.pth``, ImageNet) and the linear layers (``alex.pth``). Where it is not set, AlexNet is looked for in
torch's own cache, where torchvision, torchmetrics and lpips leave it, and the layers in the packages torchmetrics and
lpips, which bring them. Nothing is downloaded.
"""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.errors import InputError

VARIABLE = "PANOBENCH_LPIPS"
#: AlexNet's convolutions: index in the weights file, in, out, kernel, stride, padding; pooling before the layer.
_LAYERS = (
    (0, 3, 64, 11, 4, 2, False),
    (3, 64, 192, 5, 1, 2, True),
    (6, 192, 384, 3, 1, 1, True),
    (8, 384, 256, 3, 1, 1, False),
    (10, 256, 256, 3, 1, 1, False),
)
#: Packages that bring the linear layers, and where.
_PACKAGED = (("torchmetrics", "functional/image/lpips_models/alex.pth"), ("lpips", "weights/v0.1/alex.pth"))
_SHIFT, _SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
#: Smaller images have no pixel left after AlexNet's pooling.
_MIN_SIZE = 64


def find_lpips(notes: dict[str, str]) -> Lpips | None:
    """The metric if its weights are there, else None and a note. Raises InputError for wrong files."""
    files = weight_files()
    if not files:
        lacking = "the linear layers (pip install 'panobench[lpips]')" if _cached_features() else "AlexNet's weights"
        notes["lpips"] = (
            f"n/a: {lacking} are not on this machine; set {VARIABLE} to a folder with alexnet-owt-*.pth and alex.pth"
        )
        return None
    features, linear = files
    return Lpips(_read(features), _read(linear))


def weight_files(_: object = None) -> list[Path]:
    """AlexNet's file and that of the linear layers; none if they are not there. Raises InputError.

    A folder that ``$PANOBENCH_LPIPS`` names must have both.
    """
    folder = os.environ.get(VARIABLE)
    if not folder:
        found = [_cached_features(), _packaged_layers()]
        return [path for path in found if path is not None] if all(found) else []
    features = sorted(Path(folder).glob("alexnet*.pth"))
    linear = Path(folder) / "alex.pth"
    if not features or not linear.is_file():
        raise InputError("expected alexnet-owt-*.pth and alex.pth in the folder", folder)
    return [features[0], linear]


def _cached_features() -> Path | None:
    """AlexNet in torch's cache: $TORCH_HOME, or torch below $XDG_CACHE_HOME or ~/.cache."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    home = Path(os.environ.get("TORCH_HOME") or cache / "torch").expanduser()
    return next(iter(sorted((home / "hub" / "checkpoints").glob("alexnet-owt-*.pth"))), None)


def _packaged_layers() -> Path | None:
    """The linear layers that a package brings; it is not imported."""
    for package, place in _PACKAGED:
        spec = importlib.util.find_spec(package)
        for folder in spec.submodule_search_locations or () if spec is not None else ():
            if (path := Path(folder) / place).is_file():
                return path
    return None


def _read(path: Path) -> dict[str, Any]:
    import pickle

    import torch

    try:
        return dict(torch.load(path, map_location="cpu", weights_only=True))
    except (OSError, RuntimeError, ValueError, TypeError, EOFError, pickle.UnpicklingError) as error:
        raise InputError(f"not a weights file ({type(error).__name__})", path) from error


class Lpips:
    """features: "features.N.weight" and ".bias" of AlexNet. linear: "linK.model.1.weight", (1, C, 1, 1)."""

    def __init__(self, features: dict[str, Any], linear: dict[str, Any]) -> None:
        import torch

        self._layers: list[tuple[Any, Any, Any]] = []
        for k, (n, ins, outs, size, *_) in enumerate(_LAYERS):
            try:
                w, b = features[f"features.{n}.weight"], features[f"features.{n}.bias"]
                lin = linear[f"lin{k}.model.1.weight"]
            except KeyError as error:
                raise InputError(f"the LPIPS weights lack {error}") from None
            if tuple(w.shape) != (outs, ins, size, size) or lin.numel() != outs:
                raise InputError(f"the LPIPS weights of layer {n} have shape {tuple(w.shape)}")
            self._layers.append((w.float(), b.float(), lin.float().reshape(1, outs, 1, 1)))
        self._shift, self._scale = (torch.tensor(v).reshape(1, 3, 1, 1) for v in (_SHIFT, _SCALE))

    def __call__(
        self, a: NDArray[np.float32], b: NDArray[np.float32], valid: NDArray[np.bool_] | None = None
    ) -> float | None:
        """Distance of (H, W, 3) images in 0..1; pixels not ``valid`` are black in both. None when too small."""
        import torch

        if min(a.shape[:2]) < _MIN_SIZE:
            return None
        mask = np.float32(1) if valid is None else valid[..., None].astype(np.float32)
        pair = torch.from_numpy(np.stack([a * mask, b * mask])).permute(0, 3, 1, 2)
        x = (2 * pair - 1 - self._shift) / self._scale
        total = 0.0
        with torch.no_grad():
            for (_, _, _, _, stride, padding, pool), (w, bias, lin) in zip(_LAYERS, self._layers):
                if pool:
                    x = torch.nn.functional.max_pool2d(x, 3, 2)
                x = torch.relu(torch.nn.functional.conv2d(x, w, bias, stride, padding))
                unit = x / (torch.sqrt((x * x).sum(dim=1, keepdim=True)) + 1e-10)
                total += float((((unit[:1] - unit[1:]) ** 2) * lin).sum(dim=1).mean())
        return total
