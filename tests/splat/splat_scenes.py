"""Small scenes and the oracle in the kernels' terms, shared by the renderer's tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch_reference import ALPHA_MIN, ReferenceOutput, render_reference

from panobench.cameras.base import Camera
from panobench.cameras.erp import ErpCamera
from panobench.cameras.pinhole import PinholeCamera
from panobench.geometry import invert_pose, make_pose, so3_exp
from panobench.splat.gaussians import GaussianMap
from panobench.splat.view import Projection

NAMES = ("means", "log_scales", "quats", "opacity_logits", "colours")

# Sizes that are not multiples of the tile, and a principal point that is not the centre.
CAMERAS: dict[str, Camera] = {
    "erp": ErpCamera(72, 36),
    "pinhole": PinholeCamera(70, 50, fx=42.0, fy=45.0, cx=31.0, cy=27.5),
}
CASES: list[tuple[str, Projection]] = [("erp", "sphere"), ("erp", "erp"), ("pinhole", "sphere"), ("pinhole", "pinhole")]
POSE = make_pose(so3_exp([0.3, -0.5, 0.2]), [0.2, -0.1, 0.3])


def gaussian_map(means: Any, scale: Any = 0.1, logit: Any = 1.0, colour: Any = 0.7, quats: Any = None) -> GaussianMap:
    """Gaussians from whatever broadcasts; ``scale`` is the standard deviation."""
    means = np.atleast_2d(np.asarray(means, dtype=np.float64))
    n = len(means)
    q = np.tile([1.0, 0, 0, 0], (n, 1)) if quats is None else quats
    shapes = [(means, (n, 3)), (np.log(scale), (n, 3)), (q, (n, 4)), (logit, (n,)), (colour, (n, 3))]
    return GaussianMap(*(np.broadcast_to(a, shape).astype(np.float32) for a, shape in shapes))


def random_scene(n: int, seed: int, camera: str, projection: str = "sphere", logit: float = 0.5) -> GaussianMap:
    """n anisotropic Gaussians 1-4 m from the camera at ``POSE``, for a pinhole mostly in front of it.

    For the first-order panorama none is nearer than 30 degrees to a pole: there its footprints exceed half the
    panorama, and which of the two copies a pixel takes is a matter of convention.
    """
    rng = np.random.default_rng(seed)
    T_wc = POSE
    d = rng.normal(size=(4 * n, 3)) + ([0, 0, 2.5] if camera == "pinhole" else 0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    if projection == "erp":
        d = d[np.abs(d[:, 1]) < np.sin(np.deg2rad(60))]
    d = d[:n]
    points = d * rng.uniform(1, 4, size=(n, 1))
    return gaussian_map(
        points @ T_wc[:3, :3].T + T_wc[:3, 3],
        scale=np.exp(rng.normal(-2.0, 0.5, size=(n, 3))),
        quats=rng.normal(size=(n, 4)) * rng.uniform(0.5, 2, size=(n, 1)),
        logit=rng.normal(logit, 1.5, size=n),
        colour=rng.uniform(size=(n, 3)),
    )


@dataclass
class Reference:
    """The oracle's parameters (float64 leaves), pose twist, output, and where rounding does not decide.

    steady (H, W) is False where an alpha is so near the cut at 1/255 that float32 may fall on the other side.
    """

    parameters: list[torch.Tensor]
    tau: torch.Tensor
    out: ReferenceOutput
    steady: np.ndarray

    def gradients(self) -> dict[str, np.ndarray]:
        """After ``backward`` on something of ``out``: the leaves' gradients, "pose" among them."""
        leaves = dict(zip((*NAMES, "pose"), (*self.parameters, self.tau)))
        return {name: np.asarray(leaf.grad) for name, leaf in leaves.items()}


def render_oracle(
    parameters: Sequence[torch.Tensor], camera: Camera, T_wc: np.ndarray, **options: Any
) -> ReferenceOutput:
    """``render_reference`` of the five parameter tensors from camera-to-world ``T_wc``."""
    means, log_scales, quats, logits, colours = parameters
    return render_reference(means, log_scales, quats, logits, colours, camera, invert_pose(T_wc), **options)


def reference(
    gaussians: GaussianMap,
    camera: Camera,
    T_wc: np.ndarray,
    projection: Projection,
    margin: float = 1e-3,
    **options: Any,
) -> Reference:
    parameters = [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in gaussians.arrays()]
    tau = torch.zeros(6, dtype=torch.float64, requires_grad=True)
    options = {"projection": projection, "tau": tau, **options}
    out = render_oracle(parameters, camera, T_wc, **options)
    with torch.no_grad():
        low, high = (
            render_oracle(parameters, camera, T_wc, alpha_min=ALPHA_MIN * f, **options).opacity
            for f in (1 - margin, 1 + margin)
        )
    return Reference(parameters, tau, out, (low == high).numpy())
