"""``geometry``: what does not move as the rigid scene does while the camera moves.

A few pairs of frames, spread over the sequence, with the camera's motion between them (``pairs``); per pair every
direction votes (``evidence``); the votes of all pairs add up, for what carries the camera is always in about the same
direction, and become a mask (``region``). They add up in the picture's axes, or in those of the carrier (``turning``)
if they agree plainly better there; then every frame has a mask of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.cameras.reproject import Reprojector
from panobench.datasets.base import FrameSequence
from panobench.errors import UnsupportedError
from panobench.geometry import so3_log
from panobench.masks.base import NOT_RIGID, MaskEstimate, MaskEstimator
from panobench.masks.empty import empty_part
from panobench.masks.evidence import Searcher, Small
from panobench.masks.pairs import Faces, Pair, find_pair
from panobench.masks.panorama import Panorama
from panobench.masks.region import grown, hidden_region, to_camera
from panobench.masks.turning import Followed, follow_carrier, interpolated
from panobench.methods.sparse.faces import FaceSet, build_faces
from panobench.photometric.bands import WINDOW, BandRemover, find_bands, log_row_gains, small_luma

Array = NDArray[np.float64]

#: Width of the panorama the search works on, and pixels of the faces on which corners are followed.
WIDTH, FACE_PIXELS = 256, 120_000
#: Pairs looked at: one for so many frames, within bounds. Five left half a face that turns unhidden.
FRAMES_PER_PAIR, FEWEST_PAIRS, MOST_PAIRS = 15, 10, 12
#: Pixels of the panorama along the border of the view where nothing is compared: half the windows of the comparison.
BORDER = 8
#: Less than this share of the view is noise, more is a mistake; more still where pairs show a scene behind a carrier.
LEAST, MOST, MOST_BEHIND = 0.003, 0.7, 0.85
#: Fewer pairs with motion than these say nothing.
ENOUGH = 2
#: Frames on which a carrier is followed, at most, and seconds between two of them: at first, and if it is lost then.
MOST_FOLLOWED, STEPS = 600, (0.3, 0.1)
#: Radians by which it must turn for frames to get masks of their own, and the most that its look may differ from what
#: it was, over how much it would if it stayed in place. Anybody who walks sways by some ten degrees.
LEAST_TURN, MOST_APART = np.deg2rad(25), 0.85
#: Frames by which it is told what is always hidden.
SOME_FRAMES = 60


class GeometryMask(MaskEstimator):
    """See the module's text."""

    def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
        """Raises what reading the sequence raises."""
        empty = empty_part(sequence)
        found = self._carrier(sequence, sequence.camera.with_mask(sequence.camera.valid_mask() & ~empty), seed)
        if not empty.any():
            return found
        share = view_share(sequence.camera.with_mask(None).solid_angle(), empty)
        return replace(found, message=f"{share:.1%} of the view is black in all frames; {found.message}")

    def _carrier(self, sequence: FrameSequence, camera: Camera, seed: int) -> MaskEstimate:
        """What moves with the camera, of what ``camera`` sees."""
        everything = camera.valid_mask()
        try:
            frames = _Frames(sequence, camera)
        except UnsupportedError as error:
            return MaskEstimate(everything, ok=False, message=str(error))
        pairs = frames.pairs(np.random.default_rng(seed))
        details: dict[str, Any] = {"pairs": [[p.first, p.second] for p in pairs]}
        if len(pairs) < ENOUGH:
            message = "the camera hardly moves, so nothing can be told"
            return MaskEstimate(everything, ok=False, message=message, details=details)
        votes = frames.votes(pairs)
        panorama = frames.searcher.panorama
        region = hidden_region(panorama, *summed(votes))
        hidden = to_camera(panorama, region, camera.rays())
        share = view_share(camera.with_mask(None).solid_angle(), hidden)
        if share > (MOST_BEHIND if all(p.behind for p in pairs) else MOST):
            message = f"{share:.0%} of the view does not move as a rigid scene: nothing was hidden"
            details[NOT_RIGID] = round(share, 4)
            return MaskEstimate(everything, ok=False, message=message, details=details)
        if share < LEAST:
            return MaskEstimate(everything, message="nothing moves with the camera", details=details)
        turns = frames.turns(votes, region)
        turned = None if turns is None else hidden_region(panorama, *summed(votes, turns, panorama))
        # Where nothing is left in the carrier's axes, what was followed is none: a hand before a lens for a while.
        if turns is None or turned is None or not turned.any():
            message = f"{share:.1%} of the view moves with the camera"
            return MaskEstimate(everything & ~hidden, message=message, details=details)
        masks = TurnedMasks(panorama, turned, camera.rays(), turns)
        some = [~masks[i] for i in range(0, len(turns), max(len(turns) // SOME_FRAMES, 1))]
        always, area = np.all(some, axis=0), camera.with_mask(None).solid_angle()
        share = float(np.mean([view_share(area, one) for one in some]))
        angle = float(np.degrees(max(np.linalg.norm(so3_log(R)) for R in turns)))
        message = (
            f"{share:.1%} of the view moves with the camera and turns in the picture, by up to {angle:.0f} degrees: "
            "each frame has a mask of its own"
        )
        details["turned_deg"] = round(angle, 1)
        return MaskEstimate(everything & ~always, masks, True, message, details, everything & ~hidden)


@dataclass(frozen=True)
class Votes:
    """Votes and their weights (H, W) of the directions in frame ``index``.

    lasting: by two frames far apart, and so in the picture's axes alone.
    """

    index: int
    votes: Array
    weights: Array
    lasting: bool = False


def summed(
    votes: list[Votes], turns: list[Array] | None = None, panorama: Panorama | None = None
) -> tuple[Array, Array]:
    """Sums (H, W) of votes and of weights: in the picture's axes, or in the carrier's by its turns in all frames."""
    total, weights = np.zeros_like(votes[0].votes), np.zeros_like(votes[0].weights)
    for one in votes:
        if turns is None or panorama is None:
            total, weights = total + one.votes, weights + one.weights
        else:
            if one.lasting:
                continue
            both = np.stack([one.votes, one.weights], axis=-1).astype(np.float32)
            turned = panorama.at(both, panorama.rays @ turns[one.index].T)
            total, weights = total + turned[..., 0], weights + turned[..., 1]
    return total, weights


def agreement(total: Array, weights: Array) -> float:
    """How far votes agree with each other, direction by direction: 1 where none contradicts another."""
    return float(np.abs(total).sum() / max(float(weights.sum()), 1e-12))


class TurnedMasks(Mapping[int, NDArray[np.bool_]]):
    """By frame, where it shows the scene (H, W): a region of the carrier's axes hides the rest, as it lies there."""

    def __init__(self, panorama: Panorama, region: NDArray[np.bool_], rays: Array, turns: list[Array]) -> None:
        self._panorama, self._region, self._rays, self._turns = panorama, region, rays, turns

    def __getitem__(self, index: int) -> NDArray[np.bool_]:
        if index not in range(len(self._turns)):
            raise KeyError(index)
        return ~to_camera(self._panorama, self._region, self._rays @ self._turns[index])

    def __iter__(self) -> Iterator[int]:
        return iter(range(len(self._turns)))

    def __len__(self) -> int:
        return len(self._turns)


class _Frames:
    """Small pictures of the frames that are looked at."""

    def __init__(self, sequence: FrameSequence, camera: Camera) -> None:
        self.sequence = sequence
        self.searcher = Searcher(WIDTH)
        self._reprojector = Reprojector(camera, self.searcher.panorama.camera)
        #: (H, W) of the panorama: the camera sees it, away from the border of what it sees.
        self.visible = ~grown(self.searcher.panorama, ~self._reprojector.valid, BORDER)
        self.searcher.only_where(self.visible)
        self._face_set: FaceSet = build_faces(camera, FACE_PIXELS, 1)
        self._faces: dict[int, Faces] = {}
        self._small: dict[int, Small] = {}
        self._panoramas: dict[int, NDArray[np.uint8]] = {}
        self._remover = self._remover_at(0)
        self._flickers = self._remover is not None

    def pairs(self, rng: np.random.Generator) -> list[Pair]:
        count = len(self.sequence)
        wanted = int(np.clip(count // FRAMES_PER_PAIR, FEWEST_PAIRS, MOST_PAIRS))
        found = []
        for first in np.unique(np.linspace(0, max(0, count - 8), wanted).astype(int)):
            self._remover = self._remover_at(int(first)) if self._flickers else None
            pair = find_pair(self._face_set, self._look, int(first), count, rng)
            self._faces.clear()
            if pair is not None:
                found.append(pair)
        behind = [p for p in found if p.behind]  # the others may show how a carrier turns that is most of the view
        return behind if len(behind) >= 0.5 * len(found) else found

    def votes(self, pairs: list[Pair]) -> list[Votes]:
        """Of each pair, both ways."""
        found = []
        for pair in pairs:
            for way in (pair, pair.reversed()):
                v, w = self.searcher.votes(self._small_of(way.first), self._small_of(way.second), way)
                found.append(Votes(way.first, np.where(self.visible, v, 0.0), np.where(self.visible, w, 0.0)))
        for early, late in zip(pairs, pairs[len(pairs) // 2 :]):
            if late.first > early.first:
                a, b = self._small_of(early.first), self._small_of(late.first)
                v, w = self.searcher.lasting(a, b, (early.t, late.t))
                found.append(Votes(early.first, np.where(self.visible, v, 0.0), np.where(self.visible, w, 0.0), True))
        return found

    def turns(self, votes: list[Votes], region: NDArray[np.bool_]) -> list[Array] | None:
        """R (3, 3) by frame, from the carrier's axes to the picture's; None where votes agree as well in the latter.

        region (H, W): where the carrier is, by votes in the picture's axes.
        """
        if not self.visible.all():
            return None  # a mask that turns would leave the view
        count, panorama = len(self.sequence), self.searcher.panorama
        votes = [one for one in votes if not one.lasting]
        # What turns has swept over the region: most of that may be scene. One pair of frames saw where it was then.
        one = min(votes, key=lambda v: abs(v.index - count // 2))
        then = hidden_region(panorama, one.votes, one.weights) & region
        for step_s in STEPS:
            followed = self._followed(step_s, then if then.any() else region, one.index)
            if followed is None or followed.angle < LEAST_TURN:
                return None
            turns = interpolated(followed.turns, count)
            better = agreement(*summed(votes, turns, panorama)) > agreement(*summed(votes))
            if better and followed.apart <= MOST_APART:
                return turns
        return None

    def _followed(self, step_s: float, region: NDArray[np.bool_], start: int) -> Followed | None:
        """The carrier followed from frame ``start`` on, where it is in ``region`` (H, W), every ``step_s`` seconds.

        None if it is nowhere, or frames are too far apart.
        """
        count, small = len(self.sequence), self.searcher.half
        interval = float(np.median(np.diff(self.sequence.times)))
        step = max(count // MOST_FOLLOWED, int(step_s / interval), 1)
        if step > 1 and step * interval > step_s:
            return None
        where = cv2.resize(region.view(np.uint8), (small.width, small.height), interpolation=cv2.INTER_NEAREST) > 0
        if not where.any():
            return None
        wanted = sorted({*range(start % step, count, step), 0, count - 1})
        halves = {i: self.searcher.half_of(self._reprojector.image(self.sequence.image(i))) for i in wanted}
        return follow_carrier(small, halves, where, start)

    def _look(self, index: int) -> Faces:
        if index not in self._faces:
            image = self.sequence.image(index)
            if self._remover is not None:
                image = self._remover.steady(image, float(self.sequence.times[index]))
            self._faces[index] = self._face_set.pyramid(image, 1)[0]
            self._panoramas[index] = self._reprojector.image(image)
        return self._faces[index]

    def _remover_at(self, first: int) -> BandRemover | None:
        """Of bands of flickering light in the frames from ``first`` on, under which corners are not found again."""
        begin = max(0, min(first, len(self.sequence) - WINDOW - 1))
        frames = range(begin, min(begin + WINDOW + 1, len(self.sequence)))
        lumas = [small_luma(self.sequence.image(i)) for i in frames]
        gains = [log_row_gains(a, b) for a, b in pairwise(lumas)]
        times = [float(self.sequence.times[i]) for i in frames]
        bands = find_bands(gains, times) if len(gains) == WINDOW else None
        return BandRemover(bands, times[0]) if bands is not None and bands.evident else None

    def _small_of(self, index: int) -> Small:
        if index not in self._small:
            self._small[index] = self.searcher.small(self._panoramas[index])
        return self._small[index]


def view_share(solid_angle: NDArray[np.float64], hidden: NDArray[np.bool_]) -> float:
    """Share of a view's solid angle (H, W) that is hidden."""
    total = float(solid_angle.sum())
    return float(np.where(hidden, solid_angle, 0.0).sum()) / total if total > 0 else 0.0
