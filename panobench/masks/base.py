"""The mask-estimator contract: it sees a sequence before the method does and says which pixels show the scene."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from panobench.datasets.base import FrameSequence


#: A number that ``details`` may have: the share of the view that does not move as a rigid scene, too much to hide.
NOT_RIGID = "not_rigid"


@dataclass(frozen=True)
class MaskEstimate:
    """What an estimator found.

    valid:   (H, W) bool at the camera's size, True where the view may show the scene.
    frames:  by frame index, masks (H, W) of single frames, which hide more; others show the scene wherever ``valid``.
    ok:      False: it could not tell, and ``valid`` is all the camera sees; ``message`` says why in one line.
    details: JSON-serialisable numbers for run.json.
    whole:   (H, W) bool, ``valid`` for methods that honour no masks of single frames; None: what all of these show.
    """

    valid: NDArray[np.bool_]
    frames: Mapping[int, NDArray[np.bool_]] = field(default_factory=dict)
    ok: bool = True
    message: str = ""
    details: dict[str, Any] = field(default_factory=dict)
    whole: NDArray[np.bool_] | None = None


class MaskEstimator(ABC):
    """Finds what moves with the camera. ``argument`` is what followed the colon in `--mask NAME:ARGUMENT`."""

    def __init__(self, argument: str = "") -> None:
        self.argument = argument

    @abstractmethod
    def estimate(self, sequence: FrameSequence, seed: int = 0) -> MaskEstimate:
        """Look at as few frames of ``sequence`` (images, times, camera; no truth) as will do, in seconds."""
