"""The size of a target pixel in the source image, which decides how much is filtered before sampling."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from panobench.cameras.base import Array, Camera

#: Source pixels between neighbouring samples above which aliasing is visible.
_MAX_STEP = 1.6
#: Images enlarged more than this show that they were: they have no detail at the size of their pixels.
ENLARGED = 1.5
#: ``cv2.remap`` addresses pixels with 16 bits.
_MAX_REMAP_SIDE = 32767


@dataclass(frozen=True)
class Sampling:
    """Shrink the source by ``shrink`` (area filter), then take ``grid`` x ``grid`` samples in each target pixel."""

    shrink: int = 1
    grid: int = 1


def stretch(source: Camera, target: Camera, R_target_source: Array, samples: int = 128) -> tuple[Array, Array]:
    """Source pixels per target pixel along the target's rows and columns, (n,) each, on a coarse grid.

    From the source's Jacobian, so seams do not matter. A panorama's columns are weighted by cos(latitude), since near
    the poles its extra columns carry no detail.
    """
    u = (np.arange(min(samples, target.width)) + 0.5) * max(1.0, target.width / samples)
    v = (np.arange(min(samples, target.height)) + 0.5) * max(1.0, target.height / samples)
    centre = np.stack(np.meshgrid(u, v), axis=-1)
    rays = target.unproject(centre) @ R_target_source
    pixels, seen = source.project(rays)
    if source.mask is not None:
        column, row = (np.where(seen, pixels[..., i], 0).astype(np.intp) for i in (0, 1))
        seen = seen & source.mask[row, column]
    J = source.jacobian(rays)
    if source.kind == "erp":
        J = J * np.stack([np.hypot(rays[..., 0], rays[..., 2]), np.ones(rays.shape[:-1])], axis=-1)[..., None]
    steps = []
    for offset in ([0.25, 0.0], [0.0, 0.25]):
        difference = (target.unproject(centre + offset) - target.unproject(centre - offset)) @ R_target_source
        with np.errstate(invalid="ignore"):
            steps.append(np.linalg.norm((J @ (2 * difference[..., None]))[..., 0], axis=-1))
    ok = seen & np.isfinite(steps[0]) & np.isfinite(steps[1])
    return steps[0][ok], steps[1][ok]


def enlargement(source: Camera, target: Camera, R_target_source: Array) -> float:
    """Target pixels per source pixel along one axis where the target is enlarged least; 1 keeps the resolution.

    The edges of a wide perspective view are always enlarged, so its middle says whether it has pixels to spare.
    """
    along, down = stretch(source, target, R_target_source)
    return float(1 / np.percentile(np.sqrt(along * down), 95)) if along.size else 1.0


def enlarged_remark(factor: float, target: Camera, source: Camera | None = None) -> list[str]:
    """A line that says how much larger than recorded ``target``'s images are; none if they hardly are."""
    if factor <= ENLARGED:
        return []
    size = f"{f'{source.width}x{source.height} ' if source else ''}to {target.kind} {target.width}x{target.height}"
    return [f"images are enlarged {factor:.1f} times or more ({size}), which blurs them; give a smaller --width"]


def choose_sampling(source: Camera, target: Camera, R_target_source: Array) -> Sampling:
    """The sampling of a reprojection: plain when magnifying; supersampled, perhaps after shrinking, when minifying."""
    along, down = stretch(source, target, R_target_source)
    if along.size == 0:
        return Sampling()
    largest = float(np.percentile(np.maximum(along, down), 99))
    smallest = float(np.percentile(np.minimum(along, down), 5))
    if largest <= 1.25:
        return Sampling()
    # The pre-filter must not blur what the least minified pixels could still show.
    shrink = max(1, int(min(largest / 2 + 0.5, smallest)))
    grid = 2
    while largest / (shrink * grid) > _MAX_STEP and grid < 8:
        grid *= 2
    while grid > 1 and grid * max(target.width, target.height) >= _MAX_REMAP_SIDE:
        grid //= 2
    return Sampling(shrink, grid)
