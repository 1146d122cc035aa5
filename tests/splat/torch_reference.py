"""The renderer once more in plain, dense torch: the oracle that the kernels are tested against.

Every Gaussian meets every pixel, which is slow, but there are no tiles, bounds or early stop to get wrong. It works in
any dtype and on any device (tests use float64), and is differentiable in all parameters and in a twist of the pose.

Formulas: compositing and the pinhole's conic are those of Kerbl et al., "3D Gaussian splatting for real-time radiance
field rendering" (2023), after Zwicker et al., "EWA volume splatting" (2001); the panorama's conic uses the Jacobian of
the equirectangular projection; ``_sphere`` describes the projection on the sphere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from panobench.cameras.base import Camera
from panobench.errors import UnknownNameError, UnsupportedError

ALPHA_MAX = 0.99
ALPHA_MIN = 1.0 / 255.0
TOUCH_TRANSMITTANCE = 0.5
MIN_COSINE = 0.1
"""The sphere projection's tangent plane is used up to this cosine from its centre."""
FOV_MARGIN = 1.3
"""The pinhole Jacobian is evaluated at most this many half fields of view off axis."""

Exponent = Callable[[Tensor, Tensor], Tensor]
"""(rays (P, 3), pixels (P, 2)) -> Mahalanobis distances squared (P, M), inf where there is no footprint."""


class ReferenceOutput(NamedTuple):
    """colour (H, W, 3), depth (H, W) = sum of w * dist, opacity (H, W) = sum of w, touched (N,) int64 counts."""

    colour: Tensor
    depth: Tensor
    opacity: Tensor
    touched: Tensor


def render_reference(
    means: Tensor,
    log_scales: Tensor,
    quats: Tensor,
    opacity_logits: Tensor,
    colours: Tensor,
    camera: Camera,
    T_cw: ArrayLike | Tensor,
    tau: Tensor | None = None,
    projection: str = "sphere",
    low_pass: float = 0.3,
    near: float = 0.01,
    chunk: int = 1 << 21,
    alpha_min: float = ALPHA_MIN,
) -> ReferenceOutput:
    """Render Gaussians (shapes as ``GaussianMap``, one dtype and device) from world-to-camera ``T_cw`` (4, 4).

    ``tau`` (6,) = (translation, rotation) moves the camera: T_cw <- exp(tau) T_cw; None means zero.
    ``chunk`` bounds pixels x Gaussians held at a time; with gradients every chunk is recomputed backwards.
    ``alpha_min`` is the hard cut; tests move it a little to find the pixels where rounding decides.
    Raises UnsupportedError when the projection does not fit the camera.
    """
    dtype, device = means.dtype, means.device
    if not isinstance(T_cw, Tensor):
        T_cw = torch.as_tensor(np.asarray(T_cw, dtype=np.float64))
    T = T_cw.to(device=device, dtype=dtype)
    if tau is not None:
        T = se3_exp(tau.to(device=device, dtype=dtype)) @ T
    mu = means @ T[:3, :3].T + T[:3, 3]
    A = T[:3, :3] @ rotation_matrices(quats) * torch.exp(log_scales)[:, None, :]
    sigma = A @ A.transpose(1, 2)

    n = len(mu)
    dist = mu.norm(dim=1)
    seen = (mu[:, 2] if projection == "pinhole" else dist) >= near
    keep = torch.nonzero(seen & torch.isfinite(dist))[:, 0]
    keep = keep[torch.argsort(dist.detach()[keep], stable=True)]
    mu, sigma, dist = mu[keep], sigma[keep], dist[keep]
    exponent = _projection(projection, camera)(mu, sigma, dist, camera, low_pass)
    opacity = torch.sigmoid(opacity_logits[keep])
    payload = torch.cat([colours[keep], dist[:, None], torch.ones_like(dist)[:, None]], dim=1)

    rays = torch.as_tensor(np.ascontiguousarray(camera.rays()), dtype=dtype, device=device).reshape(-1, 3)
    pixels = torch.as_tensor(camera.pixel_grid(), dtype=dtype, device=device).reshape(-1, 2)

    def block(r: Tensor, p: Tensor) -> tuple[Tensor, Tensor]:
        alpha = (opacity * torch.exp(-0.5 * exponent(r, p))).clamp(max=ALPHA_MAX)
        alpha = torch.where(alpha >= alpha_min, alpha, torch.zeros_like(alpha))
        through = torch.cumprod(1.0 - alpha, dim=1)
        before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], dim=1)
        touches = ((alpha > 0) & (before > TOUCH_TRANSMITTANCE)).sum(dim=0)
        return (before * alpha) @ payload, touches

    step = max(1, chunk // max(1, len(keep)))
    parts: list[Tensor] = []
    counts = torch.zeros(len(keep), dtype=torch.int64, device=device)
    for r, p in zip(rays.split(step), pixels.split(step)):
        image, touches = (
            checkpoint(block, r, p, use_reentrant=False)
            if torch.is_grad_enabled() and step < len(rays)
            else block(r, p)
        )
        parts.append(image)
        counts = counts + touches
    image = torch.cat(parts).reshape(camera.height, camera.width, 5)
    touched = torch.zeros(n, dtype=torch.int64, device=device)
    touched[keep] = counts
    return ReferenceOutput(image[..., :3], image[..., 3], image[..., 4], touched)


def rotation_matrices(quats: Tensor) -> Tensor:
    """Quaternions (N, 4) as (w, x, y, z), normalised here -> (N, 3, 3)."""
    w, x, y, z = (quats / quats.norm(dim=1, keepdim=True)).unbind(dim=1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], dim=1),
        torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], dim=1),
        torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], dim=1),
    ]
    return torch.stack(rows, dim=1)


def se3_exp(tau: Tensor) -> Tensor:
    """Twist (6,) = (translation, rotation) -> (4, 4), by the matrix exponential: exact and smooth at zero."""
    zero = torch.zeros_like(tau[0])
    t, (a, b, c) = tau[:3], tau[3:].unbind()
    rows = [
        torch.stack([zero, -c, b, t[0]]),
        torch.stack([c, zero, -a, t[1]]),
        torch.stack([-b, a, zero, t[2]]),
        torch.stack([zero, zero, zero, zero]),
    ]
    return torch.linalg.matrix_exp(torch.stack(rows))


def _projection(name: str, camera: Camera) -> Callable[[Tensor, Tensor, Tensor, Any, float], Exponent]:
    known = {"sphere": _sphere, "erp": _erp, "pinhole": _pinhole}
    if name not in known:
        raise UnknownNameError("projection", name, known)
    if name != "sphere" and camera.kind != name:
        raise UnsupportedError(
            f"projection '{name}' cannot render a '{camera.kind}' camera; 'sphere' renders every camera"
        )
    return known[name]


def _pixel_angle(camera: Any) -> float:
    """Radians that the sphere projection's low-pass takes for one pixel."""
    if camera.kind == "erp":
        return 2 * math.pi / camera.width
    if camera.kind == "pinhole":
        return 1.0 / float(camera.fx)
    area = camera.solid_angle()
    return float(np.sqrt(np.median(area[area > 0])))


def _sphere(mu: Tensor, sigma: Tensor, dist: Tensor, camera: Any, low_pass: float) -> Exponent:
    """Gaussians on the tangent planes of the unit sphere at m = mu / |mu|.

    A ray meets the tangent plane at r / (m.r), so D = r / (m.r) - m is the 3-vector e1 d1 + e2 d2 whatever
    the basis. With P = I - m m^T the covariance there is C = P Sigma P / dist^2 + low_pass pix^2 P, singular
    along m only; (C + k m m^T)^-1 gives the same q = D^T C^+ D for every k > 0, and no basis is needed. With
    L L^T that inverse, q = |L^T D|^2.
    """
    m = mu / dist[:, None]
    mm = m[:, :, None] * m[:, None, :]
    P = torch.eye(3, dtype=mu.dtype, device=mu.device) - mm
    pix = _pixel_angle(camera)
    C = P @ sigma @ P / (dist * dist)[:, None, None] + low_pass * pix * pix * P
    k = 0.5 * C.diagonal(dim1=1, dim2=2).sum(dim=1).detach()
    L = torch.linalg.cholesky(torch.linalg.inv(C + k[:, None, None] * mm))
    offset = torch.einsum("ni,nij->nj", m, L)

    def exponent(rays: Tensor, pixels: Tensor) -> Tensor:
        rays = torch.nan_to_num(rays)
        cosine = rays @ m.T
        inside = cosine > MIN_COSINE
        safe = torch.where(inside, cosine, torch.ones_like(cosine))
        q = sum((((rays @ L[:, :, j].T) / safe - offset[:, j]).square() for j in range(3)), torch.zeros_like(safe))
        return torch.where(inside, q, torch.full_like(q, torch.inf))

    return exponent


def _erp(mu: Tensor, sigma: Tensor, dist: Tensor, camera: Any, low_pass: float) -> Exponent:
    """First-order conics in the panorama; the nearest copy of a Gaussian across the seam counts."""
    W, H = camera.width, camera.height
    x, y, z = mu.unbind(dim=1)
    horizontal = torch.hypot(x, z).clamp(min=1e-9)
    u = W * (0.5 + torch.atan2(x, z) / (2 * math.pi))
    v = H * (0.5 - torch.atan2(-y, horizontal) / math.pi)
    du, dv = W / (2 * math.pi), H / math.pi
    h2, d2 = horizontal * horizontal, dist * dist
    J = torch.stack(
        [
            torch.stack([du * z / h2, torch.zeros_like(x), -du * x / h2], dim=1),
            torch.stack(
                [-dv * x * y / (horizontal * d2), dv * horizontal / d2, -dv * y * z / (horizontal * d2)], dim=1
            ),
        ],
        dim=1,
    )
    return _conic(J, sigma, u, v, low_pass, wrap=float(W))


def _pinhole(mu: Tensor, sigma: Tensor, dist: Tensor, camera: Any, low_pass: float) -> Exponent:
    """First-order EWA conics; the Jacobian's off-axis angle is bounded as in 3DGS."""
    x, y, z = mu.unbind(dim=1)
    fx, fy = float(camera.fx), float(camera.fy)
    limit_x = FOV_MARGIN * 0.5 * camera.width / fx
    limit_y = FOV_MARGIN * 0.5 * camera.height / fy
    a, b = (x / z).clamp(-limit_x, limit_x), (y / z).clamp(-limit_y, limit_y)
    zero = torch.zeros_like(z)
    J = torch.stack(
        [torch.stack([fx / z, zero, -fx * a / z], dim=1), torch.stack([zero, fy / z, -fy * b / z], dim=1)], dim=1
    )
    return _conic(J, sigma, fx * x / z + camera.cx, fy * y / z + camera.cy, low_pass)


def _conic(J: Tensor, sigma: Tensor, u: Tensor, v: Tensor, low_pass: float, wrap: float | None = None) -> Exponent:
    """Exponent of 2-D Gaussians at (u, v) px with covariance J Sigma J^T + low_pass I px^2."""
    S = J @ sigma @ J.transpose(1, 2)
    a, b, c = S[:, 0, 0] + low_pass, S[:, 0, 1], S[:, 1, 1] + low_pass
    det = a * c - b * b

    def exponent(rays: Tensor, pixels: Tensor) -> Tensor:
        dx, dy = pixels[:, :1] - u, pixels[:, 1:] - v
        if wrap is not None:
            dx = dx - wrap * torch.round(dx / wrap).detach()
        return (c * dx * dx - 2 * b * dx * dy + a * dy * dy) / det

    return exponent
