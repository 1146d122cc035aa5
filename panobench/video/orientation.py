"""How a video is to be turned before it is shown: the display matrix of its container (ISO/IEC 14496-12, 8.5.2)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Orientation:
    """The stored picture, its axes exchanged if ``transposed``, then mirrored left-right and top-bottom."""

    transposed: bool = False
    mirror_x: bool = False
    mirror_y: bool = False

    @classmethod
    def from_matrix(cls, matrix: bytes) -> Orientation:
        """From nine int32; upright for anything else, and for a matrix that is no turn by right angles."""
        if len(matrix) != 36:
            return cls()
        # x' = a x + c y, y' = b x + d y
        a, b, _, c, d = struct.unpack("=9i", matrix)[:5]
        if a and d and not b and not c:
            return cls(False, a < 0, d < 0)
        if b and c and not a and not d:
            return cls(True, c < 0, b < 0)
        return cls()

    def __bool__(self) -> bool:
        return self != Orientation()

    def size(self, width: int, height: int) -> tuple[int, int]:
        """The (width, height) shown for one that is stored, and the other way round."""
        return (height, width) if self.transposed else (width, height)

    def apply(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """A stored picture (H, W, 3) as it is to be shown."""
        if self.transposed:
            image = image.swapaxes(0, 1)
        image = image[:: -1 if self.mirror_y else 1, :: -1 if self.mirror_x else 1]
        return np.ascontiguousarray(image)

    def describe(self) -> str:
        """In words, for run.json: "turned by 180 degrees"."""
        names = {
            (False, True, True): "turned by 180 degrees",
            (True, True, False): "turned by 90 degrees clockwise",
            (True, False, True): "turned by 90 degrees counterclockwise",
            (False, True, False): "mirrored left to right",
            (False, False, True): "mirrored top to bottom",
        }
        return names.get((self.transposed, self.mirror_x, self.mirror_y), "turned and mirrored" if self else "upright")
