"""What a recording's pictures hold, by their metadata, their proportions and what they look like."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from panobench.layouts.cells import (
    CUBE_1X6,
    CUBE_3X2,
    CUBE_6X1,
    CUBE_CROSS,
    CUBE_STRIP,
    EAC,
    Packing,
    Panorama,
    TwoFisheyes,
)
from panobench.layouts.evidence import alike, bars, outside_circles, tear, vacant
from panobench.layouts.layout import WHOLE, Layout
from panobench.layouts.metadata import Said
from panobench.layouts.names import LAYOUTS

Pictures = Sequence[NDArray[np.uint8]]
Size = tuple[int, int]
#: Proportions that differ by so little are an encoder's rounding (for 2:1 by no more than so many pixels).
_ROUNDED, _ROUNDED_PX = 0.03, 16
#: How torn a picture looks: 0 as the sphere, 1 as any two places. Below the first it is packed so, above the other not.
_SPHERE, _TORN = 0.4, 0.55
#: A picture of 2:1 that is more torn than this is looked at more closely; and no panorama if another fits better by so
#: much. Black corners, as around a circle, are alike, which hides a tear.
_DOUBTFUL, _BETTER = 0.2, 0.25
#: The seam alone is looked at up to so far from the horizon; less torn than this, it is closed.
_SEAM_DEG, _CLOSED = 45.0, 0.25
#: Halves that are as alike as this show the same from two eyes.
_EYES = 0.75
#: How to say which lens took the pictures.
CALIBRATION = "--calibration FILE which lens took them"
_RIMS_DEG = (180.0, 185.0, 190.0, 195.0, 200.0, 205.0, 210.0, 220.0)


@dataclass(frozen=True)
class Recognised:
    """layout: how to read the pictures. refusal: why they are not read without being told how, in one line; "" if they
    are. The layout is then what they most likely are.
    """

    layout: Layout
    refusal: str = ""


def recognise(pictures: Pictures, size: Size, said: Said, lens: str = CALIBRATION) -> Recognised:
    """Of some of a recording's pictures (h, w, 3), small, of stored ``size``; ``said``: by the metadata.

    lens: how to say that they are no panoramas at all.
    """
    if said.unreadable:
        return _refused(Layout(), f"its metadata say that its projection is {said.unreadable}, which is not read", lens)
    if said.layout is not None:
        return Recognised(_rounded(said.layout, size))
    width, height = size
    ratio = width / height
    torn = tornness(pictures, Panorama())
    if abs(width - 2 * height) <= min(_ROUNDED * width, _ROUNDED_PX) or width == 2 * height:
        return _two_to_one(pictures, size, torn, lens)
    framed = _framed(pictures, size)
    if framed is not None:
        return framed
    best = _packed(pictures, ratio)
    if best is not None:
        return best
    if torn is not None and torn < _SPHERE and 1.6 < ratio < 2.4 and _closed(pictures):
        remark = f"{width}x{height} pixels are taken for a full panorama, stretched to 2:1 (as --layout erp does)"
        return Recognised(Layout(remark=remark))
    what = f"the pictures are {width}x{height}: a full equirectangular panorama is twice as wide as high"
    return _refused(Layout(), what, lens)


def tornness(
    pictures: Pictures,
    packing: Packing,
    part: tuple[float, float, float, float] = WHOLE,
    within_deg: float = 90.0,
) -> float | None:
    """Median over pictures of how torn they are where the packing tears: 0 not at all, 1 wholly. None: too plain.

    within_deg: see ``tear``.
    """
    found = []
    for picture in pictures:
        h, w = picture.shape[:2]
        left, top, right, bottom = part
        cut = picture[round(top * h) : round(bottom * h), round(left * w) : round(right * w)]
        told = tear(cut, packing, within_deg=within_deg) if min(cut.shape[:2]) >= 16 else None
        if told is not None:
            found.append((told.ratio - 1) / max(told.far - 1, 1e-6))
    return float(np.median(found)) if found else None


def _rounded(layout: Layout, size: Size) -> Layout:
    """``layout``, with a word on proportions that are not quite the packing's."""
    left, top, right, bottom = layout.part
    width, height = (right - left) * size[0], (bottom - top) * size[1]
    ratio = width / height / layout.packing.proportions
    if abs(ratio - 1) < 1e-3 or layout.remark.endswith("2:1"):
        return layout
    words = f"{width:.0f}x{height:.0f} pixels are stretched to {layout.packing.proportions:.3g}:1"
    return replace(layout, remark=f"{layout.remark}; {words}" if layout.remark else words)


def _two_to_one(pictures: Pictures, size: Size, torn: float | None, lens: str) -> Recognised:
    plain = _rounded(Layout(), size)
    if torn is None or torn < _DOUBTFUL:
        return Recognised(plain)
    rims = {rim: told for rim in _RIMS_DEG if (told := tornness(pictures, TwoFisheyes(rim))) is not None}
    rim = min(rims, key=rims.__getitem__) if rims else 190.0
    fits = bool(rims) and rims[rim] < min(_SPHERE, torn - _BETTER)
    if fits or min(outside_circles(p) for p in pictures) > 0.9:
        what = f"the pictures show two fisheye circles (about {rim:g} degrees), no panorama"
        return Recognised(
            replace(LAYOUTS["fisheyes"][1](), packing=TwoFisheyes(rim)),
            f"{what}: --layout fisheyes:{rim:g} stitches them as ideal lenses, "
            "data set insta360-dual-fisheye with a calibration",
        )
    if torn < _TORN or _closed(pictures):
        return Recognised(plain)
    if float(np.median([alike(p, "beside") for p in pictures])) > _EYES:
        what = "the two halves of the pictures show the same: two eyes, no panorama"
        return _refused(LAYOUTS["vr180"][1](), what, lens)
    remark = (
        f"this may be no panorama: its left and right edges and its poles do not continue each other "
        f"({min(torn, 1.0):.0%} as unlike as any two places); what it is can be said with --layout"
    )
    return Recognised(replace(plain, remark=f"{plain.remark}; {remark}" if plain.remark else remark))


def _closed(pictures: Pictures, part: tuple[float, float, float, float] = WHOLE) -> bool:
    """Whether left and right edges continue each other: what is torn are the poles then, by a logo or a stand."""
    torn = tornness(pictures, Panorama(), part, _SEAM_DEG)
    return torn is not None and torn < _CLOSED


def _framed(pictures: Pictures, size: Size) -> Recognised | None:
    """A panorama between black bars."""
    part = bars(pictures)
    if part == WHOLE:
        return None
    left, top, right, bottom = part
    width, height = (right - left) * size[0], (bottom - top) * size[1]
    centred = abs(left - (1 - right)) < _ROUNDED and abs(top - (1 - bottom)) < _ROUNDED
    if abs(width / height / 2 - 1) > 2 * _ROUNDED or not centred:
        return None
    if right - left > 1 - _ROUNDED:  # bars above and below, as players make them
        share = size[0] / 2 / size[1]
        left, top, right, bottom = part = (0.0, (1 - share) / 2, 1.0, (1 + share) / 2)
        width, height = float(size[0]), size[0] / 2
    torn = tornness(pictures, Panorama(), part)
    if torn is not None and torn > _TORN and not _closed(pictures, part):
        return None
    remark = f"black bars are cut off: a panorama of {width:.0f}x{height:.0f} pixels is left of {size[0]}x{size[1]}"
    return Recognised(Layout("erp", part=part, remark=remark))


def _packed(pictures: Pictures, ratio: float) -> Recognised | None:
    """Two panoramas, or a cubemap, where the proportions and the picture's edges agree."""
    eyes = {"top-bottom": ("above", 1.0), "left-right": ("beside", 4.0)}
    for name, (where, wanted) in eyes.items():
        if abs(ratio / wanted - 1) < _ROUNDED and float(np.median([alike(p, where) for p in pictures])) > _EYES:
            layout = LAYOUTS[name][1]()
            torn = tornness(pictures, Panorama(), layout.part)
            if torn is None or torn < _TORN:
                side = "upper" if name == "top-bottom" else "left"
                remark = f"two panoramas, one per eye: the {side} one is used ({name})"
                return Recognised(replace(layout, remark=remark))
    cubes = {"eac": EAC, "cube-3x2": CUBE_3X2, "cube-6x1": CUBE_6X1, "cube-strip": CUBE_STRIP, "cube-1x6": CUBE_1X6}
    cubes["cube-cross"] = CUBE_CROSS
    told = {
        name: torn
        for name, cube in cubes.items()
        if (abs(ratio / cube.proportions - 1) < _ROUNDED or (name == "eac" and 1.4 < ratio < 1.9))  # YouTube's is 16:9
        and all(vacant(p, cube.cells) for p in pictures)
        and (torn := tornness(pictures, cube)) is not None
    }
    if not told:
        return None
    name = min(told, key=told.__getitem__)
    if told[name] > _SPHERE:
        return None
    kind = "an equi-angular cubemap (EAC)" if name == "eac" else "a cubemap"
    return Recognised(replace(LAYOUTS[name][1](), remark=f"the pictures are taken for {kind}: its edges fit ({name})"))


def _refused(layout: Layout, what: str, lens: str) -> Recognised:
    if layout.name != "erp":
        return Recognised(layout, f"{what}; --layout {layout.name} reads them so")
    return Recognised(layout, f"{what}; say what they are with --layout ({', '.join(LAYOUTS)}), or with {lens}")
