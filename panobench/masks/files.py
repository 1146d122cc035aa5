"""Mask pictures beside recordings: which file it is, and what it hides."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.images import IMAGE_SUFFIXES, decode_stored, read_bytes
from panobench.datasets.files.natural import natural_paths
from panobench.errors import DatasetError
from panobench.masks.pixels import understand

if TYPE_CHECKING:
    from panobench.cameras.base import Camera

MASK = "mask.png"
#: Names without their ending, and signs, under which a mask may lie in a folder of images.
_BARE = ("mask", "masks", "validmask")
#: Proportions that differ by less than this are the same; encoders round sizes.
_SAME_SHAPE = 0.02


@dataclass(frozen=True)
class MaskFile:
    """A mask read from a file: valid (H, W) at the size that was asked for, and what one should know of it."""

    path: Path
    valid: NDArray[np.bool_]
    remarks: tuple[str, ...] = ()
    meaning: str = "black pixels are hidden"

    def about(self) -> dict[str, Any]:
        """For a sequence's provenance, under "mask"."""
        hidden = round(1 - float(self.valid.mean()), 6)
        return {"file": self.path.name, "meaning": self.meaning, "pixels_hidden": hidden}


@dataclass(frozen=True)
class BesideMask:
    """The mask that lies beside a recording, if there is one, and what to say of it and of files that look like one."""

    file: MaskFile | None = None
    remarks: tuple[str, ...] = ()

    def about(self) -> dict[str, Any]:
        """For a sequence's provenance."""
        return {} if self.file is None else {"mask": self.file.about()}

    def files(self) -> list[Path]:
        """The files read."""
        return [] if self.file is None else [self.file.path]

    def on(self, camera: Camera) -> Camera:
        """``camera``, which has the mask's size, without what the mask hides."""
        if self.file is None:
            return camera
        return camera.with_mask(self.file.valid if camera.mask is None else self.file.valid & camera.mask)


def read_mask_file(path: Path, size: tuple[int, int]) -> MaskFile:
    """A mask for pictures of ``size`` (width, height). Raises DatasetError where it does not fit, or hides them all."""
    from panobench.cameras.parametric import resize_mask

    try:
        found = understand(decode_stored(read_bytes(path, "mask"), path))
    except ValueError as error:
        raise DatasetError(f"this is no mask: {error}", path) from None
    valid = found.valid
    if not valid.any():
        raise DatasetError("the mask hides all of the view: white is seen, black hidden", path)
    remarks = [f"mask {path.name}: {doubt}" for doubt in found.doubts]
    if found.meaning:
        remarks.insert(0, f"mask {path.name}: {found.meaning}")
    height, width = valid.shape
    if (width, height) != size:
        if abs(width * size[1] - height * size[0]) > _SAME_SHAPE * width * size[1]:
            turned = ": it has to be that of the picture as it is shown" if (height, width) == size else ""
            raise DatasetError(f"the mask is {width}x{height} pixels, the images are {size[0]}x{size[1]}{turned}", path)
        valid = resize_mask(valid, *size)
        remarks.append(f"mask {path.name}: scaled from {width}x{height} to the images' {size[0]}x{size[1]}")
    return MaskFile(path, valid, tuple(remarks), found.meaning or "black pixels are hidden")


def beside_video(recording: Path, size: tuple[int, int]) -> BesideMask:
    """The mask of a video ``NAME.mp4``: NAME.mask.png, or the one picture whose name nearly is that.

    Raises DatasetError where several may be meant, and for a mask that cannot be used.
    """
    wanted = recording.with_name(f"{recording.stem}.mask.png")
    if wanted.is_file():
        return _read(wanted, size)
    own = _plain(recording.stem)
    spellings = {f"{own}mask", f"mask{own}", f"{_plain(recording.name)}mask", f"{own}masks", f"{own}masked"}
    others = [_plain(p.stem) for p in _siblings(recording) if p != recording]
    others = [name for name in others if not own.startswith(name)]
    pictures = [p for p in pictures_in(recording.parent) if "mask" in p.stem.lower()]
    pictures = [p for p in pictures if not _plain(p.stem).startswith(tuple(others))]
    near = [p for p in pictures if _plain(p.stem) in spellings]
    if not near and len(_siblings(recording)) == 1:
        near = [p for p in pictures if _plain(p.stem) in _BARE]
    return _nearly(near, pictures, wanted.name, size)


def mask_of_folder(folders: list[Path], size: tuple[int, int]) -> BesideMask:
    """The mask of a folder of images: mask.png in one of ``folders``, or the one picture whose name nearly is that.

    Raises DatasetError as ``beside_video``.
    """
    exact = next((folder / MASK for folder in folders if (folder / MASK).is_file()), None)
    if exact is not None:
        return _read(exact, size)
    pictures = [p for folder in folders for p in pictures_in(folder) if _plain(p.stem) in _BARE]
    if pictures:
        return _nearly(pictures, pictures, MASK, size)
    if any(pictures_in(folder / "masks") for folder in folders):
        line = f"masks/ has pictures of its own: masks of single frames are not read, one for all is ({MASK}, --mask)"
        return BesideMask(None, (line,))
    return BesideMask()


def looks_like_mask(picture: Path) -> bool:
    """Whether a picture among the images of a sequence is the mask of all of them."""
    return _plain(picture.stem) in _BARE


def pictures_in(folder: Path) -> list[Path]:
    """Images directly in a folder, in natural order; none where there is no such folder."""
    if not folder.is_dir():
        return []
    found = (p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and p.name[0] != "." and p.is_file())
    return natural_paths(found)


def _read(path: Path, size: tuple[int, int], said: tuple[str, ...] = ()) -> BesideMask:
    found = read_mask_file(path, size)
    return BesideMask(found, (*said, *found.remarks))


def _nearly(near: list[Path], pictures: list[Path], wanted: str, size: tuple[int, int]) -> BesideMask:
    if len(near) > 1:
        names = ", ".join(p.name for p in near)
        raise DatasetError(f"several pictures may be the mask ({names}): name the right one {wanted}", near[0].parent)
    if near:
        return _read(near[0], size, (f"mask {near[0].name} is used; its usual name is {wanted}",))
    if len(pictures) == 1:
        return BesideMask(None, (f"{pictures[0].name} is not used: a mask is called {wanted}, or given by --mask",))
    return BesideMask()


def _siblings(recording: Path) -> list[Path]:
    """Recordings of its kind in its folder."""
    return [p for p in recording.parent.iterdir() if p.suffix.lower() == recording.suffix.lower() and p.name[0] != "."]


def _plain(name: str) -> str:
    return re.sub(r"[\W_]+", "", name.lower())
