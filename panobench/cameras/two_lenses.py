"""A panorama stitched from two lenses back to back: from where it sees each direction, and the parallax at the seam.

Each lens sees its half of the sphere from its own centre. Their pictures are laid on one sphere, on which things at one
distance fit together; everything else is shifted, the more the nearer it is to the seam.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from panobench.cameras.base import Array

#: Near the seam one lens's picture fades into the other's: up to this angle from it, radians.
BLEND = np.deg2rad(4.0)


@dataclass(frozen=True)
class TwoLenses:
    """Lenses along +z and -z, ``baseline`` apart, stitched for things at a distance of 1 / ``inverse_distance``.

    Both in the unit of the depths given; inverse_distance is 0 for things at infinity.
    """

    baseline: float
    inverse_distance: float

    def centres(self) -> Array:
        """(2, 3): of the front and of the back lens, in the camera's axes."""
        return np.array([[0.0, 0.0, 0.5], [0.0, 0.0, -0.5]]) * self.baseline

    def origins(self, rays: Array) -> Array:
        """(..., 3): the centre of the lens that sees along ``rays`` (..., 3)."""
        front, back = self.centres()
        return np.where(rays[..., 2:] >= 0, front, back)

    def seen(self, rays: Array) -> Array:
        """Unit directions (..., 3) in which the lenses saw what the panorama has along unit ``rays`` (..., 3)."""
        seen = rays - self.inverse_distance * self.origins(rays)
        return np.asarray(seen / np.linalg.norm(seen, axis=-1, keepdims=True))

    def stitched(self, rays: Array, inverse_depth: Array) -> Array:
        """Rays (..., 3) of the panorama that show what is along unit ``rays`` at 1 / ``inverse_depth`` (...).

        Where one lens fades into the other both show it, and this is the mean, by their shares.
        """
        x = np.clip(0.5 + 0.5 * np.arcsin(np.clip(rays[..., 2:], -1, 1)) / BLEND, 0.0, 1.0)
        front, back = (self._shown_by(centre, rays, inverse_depth) for centre in self.centres())
        return np.asarray(x * front + (1 - x) * back)

    def _shown_by(self, centre: Array, rays: Array, inverse_depth: Array) -> Array:
        """By one lens: where its ray hits the sphere on which things fit together, in that sphere's radius."""
        u = rays - inverse_depth[..., None] * centre
        u /= np.linalg.norm(u, axis=-1, keepdims=True)
        o = self.inverse_distance * centre
        along = u @ o[:, None]
        return np.asarray(o + (np.sqrt(along**2 + 1 - o @ o) - along) * u)

    def parallax(self, rays: Array, inverse_depth: Array) -> Array:
        """Angle (...) between where the two lenses would show the same thing, radians."""
        across = np.hypot(rays[..., 0], rays[..., 1])
        return np.asarray(self.baseline * across * np.abs(inverse_depth - self.inverse_distance))
