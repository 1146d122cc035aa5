"""``geometry``: what does not move as the rigid scene does while the camera moves.

A few pairs of frames, spread over the sequence, with the camera's motion between them (``pairs``); per pair every
direction votes (``evidence``); the votes of all pairs add up in the camera's axes, for what carries the camera is
always in about the same direction there, and become a mask (``region``).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.reproject import Reprojector
from panobench.datasets.base import FrameSequence
from panobench.errors import UnsupportedError
from panobench.masks.base import MaskEstimate, MaskEstimator
from panobench.masks.evidence import Searcher, Small
from panobench.masks.pairs import Faces, Pair, find_pair
from panobench.masks.region import grown, hidden_region, to_camera
from panobench.methods.sparse.faces import FaceSet, build_faces

Array = NDArray[np.float64]

#: Width of the panorama the search works on, and pixels of the faces on which corners are followed.
WIDTH, FACE_PIXELS = 256, 120_000
#: Pairs looked at: one for so many frames, within bounds.
FRAMES_PER_PAIR, FEWEST_PAIRS, MOST_PAIRS = 15, 5, 12
#: Pixels of the panorama along the border of the view where nothing is compared: half the windows of the comparison.
BORDER = 8
#: Less than this share of the view is noise, more is a mistake.
LEAST, MOST = 0.003, 0.7
#: Fewer pairs with motion than these say nothing.
ENOUGH = 2


class GeometryMask(MaskEstimator):
    """See the module's text."""

    def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
        """Raises what reading the sequence raises."""
        camera = sequence.camera
        everything = camera.valid_mask()
        try:
            frames = _Frames(sequence)
        except UnsupportedError as error:
            return MaskEstimate(everything, ok=False, message=str(error))
        pairs = frames.pairs(np.random.default_rng(seed))
        details: dict[str, Any] = {"pairs": [[p.first, p.second] for p in pairs]}
        if len(pairs) < ENOUGH:
            message = "the camera hardly moves, so nothing can be told"
            return MaskEstimate(everything, ok=False, message=message, details=details)
        votes, weights = frames.votes(pairs)
        panorama = frames.searcher.panorama
        hidden = to_camera(panorama, hidden_region(panorama, votes, weights), camera.rays())
        share = view_share(camera.with_mask(None).solid_angle(), hidden)
        if share > MOST:
            message = f"{share:.0%} of the view does not move as a rigid scene: nothing was hidden"
            return MaskEstimate(everything, ok=False, message=message, details=details)
        if share < LEAST:
            return MaskEstimate(everything, message="nothing moves with the camera", details=details)
        message = f"{share:.1%} of the view moves with the camera"
        return MaskEstimate(everything & ~hidden, message=message, details=details)


class _Frames:
    """Small pictures of the frames that are looked at."""

    def __init__(self, sequence: FrameSequence) -> None:
        self.sequence = sequence
        self.searcher = Searcher(WIDTH)
        camera = sequence.camera
        self._reprojector = Reprojector(camera, self.searcher.panorama.camera)
        #: (H, W) of the panorama: the camera sees it, away from the border of what it sees.
        self.visible = ~grown(self.searcher.panorama, ~self._reprojector.valid, BORDER)
        self.searcher.only_where(self.visible)
        self._face_set: FaceSet = build_faces(camera, FACE_PIXELS, 1)
        self._faces: dict[int, Faces] = {}
        self._small: dict[int, Small] = {}
        self._panoramas: dict[int, NDArray[np.uint8]] = {}

    def pairs(self, rng: np.random.Generator) -> list[Pair]:
        count = len(self.sequence)
        wanted = int(np.clip(count // FRAMES_PER_PAIR, FEWEST_PAIRS, MOST_PAIRS))
        found = []
        for first in np.unique(np.linspace(0, max(0, count - 8), wanted).astype(int)):
            pair = find_pair(self._face_set, self._look, int(first), count, rng)
            self._faces.clear()
            if pair is not None:
                found.append(pair)
        return found

    def votes(self, pairs: list[Pair]) -> tuple[Array, Array]:
        """Sums (H, W) over the pairs, both ways, of votes and of their weights."""
        shape = self.visible.shape
        votes, weights = np.zeros(shape), np.zeros(shape)
        for pair in pairs:
            for way in (pair, pair.reversed()):
                v, w = self.searcher.votes(self._small_of(way.first), self._small_of(way.second), way)
                votes += np.where(self.visible, v, 0.0)
                weights += np.where(self.visible, w, 0.0)
        for early, late in zip(pairs, pairs[len(pairs) // 2 :]):
            if late.first > early.first:
                a, b = self._small_of(early.first), self._small_of(late.first)
                v, w = self.searcher.lasting(a, b, (early.t, late.t))
                votes += np.where(self.visible, v, 0.0)
                weights += np.where(self.visible, w, 0.0)
        return votes, weights

    def _look(self, index: int) -> Faces:
        if index not in self._faces:
            image = self.sequence.image(index)
            self._faces[index] = self._face_set.pyramid(image, 1)[0]
            self._panoramas[index] = self._reprojector.image(image)
        return self._faces[index]

    def _small_of(self, index: int) -> Small:
        if index not in self._small:
            self._small[index] = self.searcher.small(self._panoramas[index])
        return self._small[index]


def view_share(solid_angle: NDArray[np.float64], hidden: NDArray[np.bool_]) -> float:
    """Share of a view's solid angle (H, W) that is hidden."""
    total = float(solid_angle.sum())
    return float(np.where(hidden, solid_angle, 0.0).sum()) / total if total > 0 else 0.0
