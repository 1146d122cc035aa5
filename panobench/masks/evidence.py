"""Which directions move as the rigid scene does between two frames, and which do not.

Along each direction of the first frame the second is searched where the scene can be: at the place each of a range of
depths leads to. The rival is that the thing moves with the camera: it stays in the picture but for a little swaying,
or it moves by itself, and then nothing fits better than chance. A direction votes between -1 (scene) and +1 (not), by
the difference of the two costs over their sum; without texture both are small and it does not vote.

Where the best depth leads to where the thing would be if it stayed, the match says nothing for the scene. So what is
far away and what moves with the camera look alike where the camera does not turn. Staying then counts against the
scene only as far as the corners around are near, and for less; and so does staying for long (``lasting``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.masks.pairs import Pair
from panobench.masks.panorama import Image, Panorama

Array = NDArray[np.float64]

#: Depths searched, from infinity to nearer than the nearest corner: one per so many pixels of parallax, within bounds.
STEP, FEWEST_DEPTHS, MOST_DEPTHS = 1.0, 8, 40
#: Swaying within which a thing moves with the camera, in pixels of the half-size panorama, and its price per pixel.
SWAY, SWAY_PRICE = 2, 0.06
#: A match costs at least this share of what a wrong match costs if nothing fits, or this many times the scene's own.
CHANCE, CHANCE_OF_SCENE = 0.5, 1.8
#: Cost of the scene over that of a wrong match, median over the view, below which a pair is good, and worthless above.
GOOD, POOR = 0.25, 0.6
#: Pixels by which a panorama is shifted to see what a wrong match costs.
WRONG = 3.0
#: Differences this small are noise.
FLOOR = 0.10
#: Cost of staying over that of a wrong match, median over the view: nothing has changed up to the first, all from the
#: second.
UNCHANGED, CHANGED = 0.5, 0.8
#: Sine of the angle to a direction of travel up to which staying says nothing, and from which it says all it can.
AHEAD, ASIDE = 0.4, 0.7
#: Weight of votes that rest on the scene being near.
FAR_WEIGHT = 0.3
#: The scene is not further away than this share of a low quantile of the inverse depths of corners around.
FARTHEST_SHARE, FARTHEST_QUANTILE, AROUND = 0.4, 0.25, 0.3


@dataclass(frozen=True)
class Small:
    """A frame as the search sees it: normalised panoramas of full and half size."""

    full: Image
    half: Image


@dataclass(frozen=True)
class SceneMatch:
    """Where the rigid scene fits best, all (H, W): the cost, the inverse depth, the least cost of depths that corners
    around make likely (None: they don't say), and whether some depth leads out of the view.
    """

    cost: Image
    inverse: Image
    near: Image | None
    unknown: NDArray[np.bool_]


class Searcher:
    """Compares frames on a panorama ``width`` pixels wide."""

    def __init__(self, width: int) -> None:
        self.panorama, self.half, self._coarse = Panorama(width), Panorama(width // 2), Panorama(16)
        self._seen: Image | None = None

    def only_where(self, seen: NDArray[np.bool_]) -> None:
        """The camera sees these directions (H, W); by default it sees all of them."""
        self._seen = None if seen.all() else seen.astype(np.float32)

    def small(self, image: NDArray[np.uint8]) -> Small:
        """Of an RGB panorama of the right size."""
        return Small(self.panorama.normalised(image.astype(np.float32)), self.half_of(image))

    def half_of(self, image: NDArray[np.uint8]) -> Image:
        """The half size of an RGB panorama of the right size, normalised."""
        x = image.astype(np.float32)
        half = cv2.resize(x, (self.half.width, self.half.height), interpolation=cv2.INTER_AREA)
        return self.half.normalised(np.asarray(half, dtype=np.float32))

    def votes(self, a: Small, b: Small, pair: Pair) -> tuple[Array, Array]:
        """Votes (H, W) of the directions in frame a, and the weights they had."""
        p = self.panorama
        turned = p.rays @ pair.R.T
        nearest_far = self._farthest(pair)
        scene = self._scene(a.full, b.full, turned, pair, nearest_far)
        texture = self._wrong_match(a.full)
        textured = texture > 0.15
        typical = float(np.median(scene.cost[textured] / (texture[textured] + 0.02))) if textured.any() else 0.0
        chance = max(CHANCE, CHANCE_OF_SCENE * typical) * texture
        # Where little of the view fits the motion, the motion or the pictures are doubtful.
        trust = float(np.clip((POOR - typical) / (POOR - GOOD), 0.1, 1.0))
        still = self._still(a.full, b.full)
        vote = _vote(scene.cost, np.minimum(np.minimum(still, self._swaying(a.half, b.half)), chance))
        # A match where the thing would be if it stayed says nothing for the scene.
        there = turned + scene.inverse[..., None] * pair.t
        cosine = np.sum(p.rays * there, axis=-1) / np.linalg.norm(there, axis=-1)
        told_apart = np.clip(np.arccos(np.clip(cosine, -1, 1)) * p.pixels_per_radian - 1.0, 0.0, 1.0)
        weight = trust * np.where(vote > 0, 1.0, told_apart)
        votes, weights = weight * vote, weight * np.abs(vote)
        if scene.near is not None and nearest_far is not None:
            parallax = np.linalg.norm(np.cross(turned, pair.t), axis=-1) * nearest_far * p.pixels_per_radian
            weight = trust * (1 - told_apart) * FAR_WEIGHT * np.clip(parallax - 1.5, 0.0, 1.0)
            vote = _vote(scene.near, np.minimum(still, chance))
            votes, weights = votes + weight * vote, weights + weight * np.abs(vote)
        # What may have left the view need not be found.
        doubtful = scene.unknown & (votes > 0)
        return np.where(doubtful, 0.0, votes), np.where(doubtful, 0.0, weights)

    def lasting(self, a: Small, b: Small, headings: Sequence[Array]) -> tuple[Array, Array]:
        """Votes and weights (H, W) of two frames far apart: what is where it was although the view has changed.

        That tells where the camera never turns. But what is very far away stays, too, and what lies in a direction of
        travel, ``headings``, stays for long.
        """
        still, wrong = self._still(a.full, b.full), self._wrong_match(a.full)
        textured = wrong > 0.15
        changed = float(np.median(still[textured] / wrong[textured])) if textured.any() else 0.0
        weight = FAR_WEIGHT * float(np.clip((changed - UNCHANGED) / (CHANGED - UNCHANGED), 0.0, 1.0))
        aside = np.ones(still.shape)
        for t in headings:
            if t.any():
                sine = np.linalg.norm(np.cross(self.panorama.rays, t), axis=-1)
                aside = np.minimum(aside, np.clip((sine - AHEAD) / (ASIDE - AHEAD), 0.0, 1.0))
        vote = _vote(CHANCE * wrong, still)
        return weight * aside * vote, weight * aside * np.abs(vote)

    def _scene(self, a: Image, b: Image, turned: Array, pair: Pair, nearest_far: Image | None) -> SceneMatch:
        p = self.panorama
        best = np.full((p.height, p.width), np.inf, dtype=np.float32)
        inverse, unknown = np.zeros_like(best), np.zeros(best.shape, dtype=bool)
        near = None if nearest_far is None else best.copy()
        for depth in self._inverse_depths(pair):
            along = turned + depth * pair.t
            cost = p.difference(a, p.at(b, along))
            if self._seen is not None:
                unknown |= p.at(self._seen, along) < 1
            better = cost < best
            best[better], inverse[better] = cost[better], depth
            if near is not None and nearest_far is not None:
                near = np.where(depth >= 0.8 * nearest_far, np.minimum(near, cost), near)
        return SceneMatch(best, inverse, near, unknown)

    def _inverse_depths(self, pair: Pair) -> Array:
        """From infinity to nearer than the nearest corners; infinity alone for a rotation."""
        if not pair.t.any():
            return np.zeros(1)
        known = pair.inverse[pair.inverse > 0]
        high = 1.5 * float(np.percentile(known, 98)) if len(known) else 1.0
        count = int(np.clip(np.ceil(high * self.panorama.pixels_per_radian / STEP), FEWEST_DEPTHS, MOST_DEPTHS))
        return np.linspace(0.0, high, count + 1)

    def _still(self, a: Image, b: Image) -> Image:
        """Least cost of staying in place, within a pixel."""
        p = self.panorama
        moves = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
        return np.asarray(np.min([p.difference(a, p.shifted(b, dx, dy)) for dx, dy in moves], axis=0))

    def _swaying(self, a: Image, b: Image) -> Image:
        """Least cost of moving a little, at full size."""
        h = self.half
        least = np.full((h.height, h.width), np.inf, dtype=np.float32)
        for dy in range(-SWAY, SWAY + 1):
            for dx in range(-SWAY, SWAY + 1):
                far = float(np.hypot(dx, dy))
                if far <= SWAY + 0.5:
                    cost = h.difference(a, h.shifted(b, dx, dy), 3) + np.float32(SWAY_PRICE * (1 + far))
                    np.minimum(least, cost, out=least)
        size = (self.panorama.width, self.panorama.height)
        return np.asarray(cv2.resize(least, size, interpolation=cv2.INTER_LINEAR))

    def _wrong_match(self, a: Image) -> Image:
        """What a match costs that is off by a few pixels."""
        p = self.panorama
        right, down = p.difference(a, p.shifted(a, WRONG, 0)), p.difference(a, p.shifted(a, 0, WRONG))
        return np.asarray(0.5 * (right + down))

    def _farthest(self, pair: Pair) -> Image | None:
        """Inverse depth (H, W) beyond which the scene is not, by the corners around each direction."""
        if not pair.t.any():
            return None
        ppr = self.panorama.pixels_per_radian
        parallax = pair.inverse * np.linalg.norm(np.cross(pair.bearings @ pair.R.T, pair.t), axis=1) * ppr
        # A corner that hardly moves at all may belong to what moves with the camera.
        moving = (pair.inverse > 0) & ((parallax > 1.0) | (pair.moved * ppr > 1.0))
        if int(moving.sum()) < 20:
            return None
        order = np.argsort(pair.inverse[moving])
        bearings, inverse = pair.bearings[moving][order], pair.inverse[moving][order]
        c = self._coarse
        weights = np.cumsum(np.exp((c.rays.reshape(-1, 3) @ bearings.T - 1) / AROUND) + 1e-4, axis=1)
        quantile = (weights > FARTHEST_QUANTILE * weights[:, -1:]).argmax(axis=1)
        low = (FARTHEST_SHARE * inverse[quantile]).astype(np.float32).reshape(c.height, c.width)
        return c.at(low, self.panorama.rays)


def _vote(scene: Image, other: Image) -> Array:
    return np.asarray((scene - other) / (scene + other + FLOOR), dtype=np.float64)
