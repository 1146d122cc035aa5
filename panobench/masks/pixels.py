"""What a picture that somebody made as a mask means: which pixels it hides.

White is seen and black is hidden. People also erase (transparency), paint over (opaque strokes on nothing), and write
labels (0 and 1, which look black both). Programs write what they found in colour.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: More than this share of hidden pixels is a reason to ask whether the mask is inverted.
_MUCH = 0.6
#: More values than this between the darkest and the brightest are no labels.
_LABELS = 32
_OPAQUE = 128
#: Between the channels of a colour that is neither grey nor a grey's JPEG.
_COLOUR = 64


@dataclass(frozen=True)
class MaskPixels:
    """valid: (H, W), True where the scene is seen. meaning: what was taken for hidden, "" for black on white.
    doubts: one line each on what looks wrong.
    """

    valid: NDArray[np.bool_]
    meaning: str = ""
    doubts: tuple[str, ...] = ()


def understand(pixels: NDArray[Any]) -> MaskPixels:
    """Pixels as stored, (H, W) or (H, W, 1 to 4), unsigned integers; the last of two or four channels is opacity.

    Raises ValueError, with a line, for a picture that cannot be a mask.
    """
    if pixels.ndim == 2:
        pixels = pixels[..., None]
    if pixels.dtype.kind not in "ub":
        raise ValueError(f"its pixels are of type {pixels.dtype}, not whole numbers")
    colours, opacity = (pixels[..., :-1], pixels[..., -1]) if pixels.shape[2] in (2, 4) else (pixels, None)
    value = _eight_bits(colours.max(axis=-1))
    if opacity is not None and opacity.min() != opacity.max():
        return _doubted(*_transparent(value, colours, _eight_bits(opacity) >= _OPAQUE))
    if opacity is not None and opacity.max() == 0:
        raise ValueError("it is transparent everywhere")
    if colours.shape[2] == 3 and (painted := _painted(_eight_bits(colours))) is not None:
        return _doubted(~painted, "what is painted in colour is hidden")
    return _doubted(*_opaque(value))


def _eight_bits(value: NDArray[Any]) -> NDArray[np.uint8]:
    """0..255. Sixteen bits may hold small numbers all the same."""
    if value.dtype != np.uint8 and value.max(initial=0) > 255:
        return np.asarray(value // 257, dtype=np.uint8)
    return np.asarray(value, dtype=np.uint8)


def _painted(colours: NDArray[np.uint8]) -> NDArray[np.bool_] | None:
    """(H, W): what is painted in colour on white, or less than half of a black ground; None for other pictures.

    Programs that segment images write what they found so. Colours between are those of JPEG at the edges.
    """
    low, high = colours.min(axis=-1), colours.max(axis=-1)
    painted = high - low >= _COLOUR
    share = float(painted.mean())
    ground = high[~painted] if share else high[:0]
    if not len(ground):
        return None
    white, black = float((low[~painted] > 191).mean()), float((ground < 64).mean())
    return painted if white > 0.97 or (black > 0.97 and share < 0.5) else None


def _opaque(value: NDArray[np.uint8]) -> tuple[NDArray[np.bool_], str]:
    low, high = int(value.min()), int(value.max())
    if high <= 1 and low != high:
        return value > 0, "0 is hidden, 1 is seen"
    if 1 < high < _LABELS and low == 0 and len(np.unique(value)) > 2:
        raise ValueError(f"it has the labels 0 to {high}: write 0 where the scene is hidden and 255 where it is seen")
    if low <= 127 < high or low == high:
        return value > 127, ""
    # Two levels on one side of the middle, such as 0 and 100.
    middle = (low + high) / 2
    return value > middle, f"{low} is hidden, {high} is seen"


def _transparent(
    value: NDArray[np.uint8], colours: NDArray[Any], opaque: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], str]:
    shown = _eight_bits(colours[opaque])
    dark, white = float((shown.max(axis=-1) < 64).mean()), float((shown.min(axis=-1) > 191).mean())
    if dark > 0.01 and white > 0.01 and dark + white > 0.98:
        return opaque & (value > 127), "black and transparent pixels are hidden"
    if dark > 0.98:
        return ~opaque, "what is painted black is hidden"
    one_colour = float(shown.std(axis=0).max(initial=0.0)) < 12
    if one_colour and white < 0.98 and opaque.mean() < 0.5:
        return ~opaque, "what is painted is hidden"
    return opaque, "transparent pixels are hidden"


def _doubted(valid: NDArray[np.bool_], meaning: str) -> MaskPixels:
    hidden = 1.0 - float(valid.mean())
    doubts = []
    if hidden == 0:
        doubts.append("it hides nothing: white pixels are seen, black ones hidden")
    elif hidden > _MUCH:
        doubts.append(f"it hides {hidden:.0%} of the picture; white is seen and black hidden: is it inverted?")
    return MaskPixels(valid, meaning, tuple(doubts))
