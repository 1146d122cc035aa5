"""LPIPS from given weights; the numbers are checked against an independent evaluation of the definition."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from panobench.errors import InputError
from panobench.metrics import lpips as module
from panobench.metrics.lpips import VARIABLE, Lpips, find_lpips

SHAPES = {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)}


def weights() -> tuple[dict, dict]:
    import torch

    g = torch.Generator().manual_seed(0)
    features, linear = {}, {}
    for k, (n, (o, i, s)) in enumerate(SHAPES.items()):
        features[f"features.{n}.weight"] = torch.randn(o, i, s, s, generator=g) / (i * s * s) ** 0.5
        features[f"features.{n}.bias"] = 0.1 * torch.randn(o, generator=g)
        linear[f"lin{k}.model.1.weight"] = torch.rand(1, o, 1, 1, generator=g)
    return features, linear


def reference(a: np.ndarray, b: np.ndarray, features: dict, linear: dict) -> float:
    """The same network as torch modules, distances per layer as in the paper's equation 1."""
    import torch
    from torch import nn

    convs = [nn.Conv2d(3, 64, 11, 4, 2), nn.Conv2d(64, 192, 5, 1, 2), nn.Conv2d(192, 384, 3, 1, 1)]
    convs += [nn.Conv2d(384, 256, 3, 1, 1), nn.Conv2d(256, 256, 3, 1, 1)]
    total = 0.0
    mean, std = torch.tensor([0.485, 0.456, 0.406]), torch.tensor([0.229, 0.224, 0.225])
    with torch.no_grad():
        for conv, n in zip(convs, SHAPES):
            conv.weight.copy_(features[f"features.{n}.weight"])
            conv.bias.copy_(features[f"features.{n}.bias"])
        xs = [((torch.from_numpy(im) - mean) / std).permute(2, 0, 1)[None] for im in (a, b)]
        for k, conv in enumerate(convs):
            if k in (1, 2):
                xs = [nn.MaxPool2d(3, 2)(x) for x in xs]
            xs = [nn.ReLU()(conv(x)) for x in xs]
            y = [x / x.norm(dim=1, keepdim=True).clamp_min(1e-10) for x in xs]
            w = linear[f"lin{k}.model.1.weight"]
            total += float((w * (y[0] - y[1]) ** 2).sum(dim=1).mean())
    return total


def test_distance_is_its_definition() -> None:
    rng = np.random.default_rng(0)
    a, b = rng.random((2, 70, 90, 3)).astype(np.float32)
    lpips = Lpips(*weights())
    value = lpips(a, b)
    # the published constants are ImageNet's mean and deviation for values in -1..1, rounded to three digits
    assert value == pytest.approx(reference(a, b, *weights()), rel=0.02)
    assert lpips(a, a) == 0.0
    assert lpips(a[:30], b[:30]) is None


def test_without_weights_the_value_is_not_available(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    notes: dict[str, str] = {}
    assert find_lpips(notes) is None
    assert notes["lpips"].startswith("n/a: AlexNet's weights are not on this machine")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    with pytest.raises(InputError, match=r"alex\.pth"):
        find_lpips(notes)


def test_weights_from_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import torch

    features, linear = weights()
    torch.save(features, tmp_path / "alexnet-owt-7be5be79.pth")
    torch.save(linear, tmp_path / "alex.pth")
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    assert isinstance(find_lpips({}), Lpips)
    del linear["lin3.model.1.weight"]
    torch.save(linear, tmp_path / "alex.pth")
    with pytest.raises(InputError, match=r"lack 'lin3\.model\.1\.weight'"):
        find_lpips({})
    (tmp_path / "alex.pth").write_bytes(b"\x80\x04cos\nsystem\n(S'true'\ntR.")
    with pytest.raises(InputError, match="not a weights file"):
        find_lpips({})


@pytest.mark.parametrize("package", [("torchmetrics", "functional/image/lpips_models"), ("lpips", "weights/v0.1")])
def test_weights_from_the_usual_caches(
    package: tuple[str, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import torch

    features, linear = weights()
    cache, site = tmp_path / "torch" / "hub" / "checkpoints", tmp_path / "site"
    cache.mkdir(parents=True)
    torch.save(features, cache / "alexnet-owt-7be5be79.pth")
    monkeypatch.delenv(VARIABLE, raising=False)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.setattr(module, "_PACKAGED", ((f"fake_{package[0]}", f"{package[1]}/alex.pth"),))
    notes: dict[str, str] = {}
    assert find_lpips(notes) is None
    assert "panobench[lpips]" in notes["lpips"]
    (site / f"fake_{package[0]}" / package[1]).mkdir(parents=True)
    (site / f"fake_{package[0]}" / "__init__.py").write_text("raise ImportError('only its files are needed')")
    torch.save(linear, site / f"fake_{package[0]}" / package[1] / "alex.pth")
    monkeypatch.syspath_prepend(str(site))
    found = find_lpips(notes)
    assert isinstance(found, Lpips)
    rng = np.random.default_rng(1)
    a, b = rng.random((2, 70, 90, 3)).astype(np.float32)
    assert found(a, b) == Lpips(features, linear)(a, b)


def test_the_layers_of_torchmetrics_are_those_of_version_0_1() -> None:
    pytest.importorskip("torchmetrics")
    path = module._packaged_layers()
    assert path is not None
    layers = module._read(path)
    assert [layers[f"lin{k}.model.1.weight"].numel() for k in range(5)] == [64, 192, 384, 256, 256]
    assert min(float(v.min()) for v in layers.values()) >= 0
