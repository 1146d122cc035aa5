"""Which frames of which runs are shown as pictures, and the data the panorama viewer works from."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.bench.run.masking import FRAME_MASKS, HIDDEN_COLOUR, MOVING, MOVING_COLOUR
from panobench.masks.frame_masks import mask_name
from panobench.report.images import BUDGET, Picture, Plan, encode, encode_file, plan, read, spread
from panobench.report.model import Collection, Run
from panobench.report.ranking import failure
from panobench.writing import write_whole


@dataclass
class Gallery:
    """Pictures of a report. ``store`` maps a short key to a data URI; equal files are kept once.

    assets: folder for full-size copies (None: none are made); ``links`` maps a key to its relative path there.
    pages: names of the pages written there.
    """

    plan: Plan
    assets: Path | None = None
    store: dict[str, str] = field(default_factory=dict)
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    links: dict[str, str] = field(default_factory=dict)
    pages: set[str] = field(default_factory=set)

    def add(self, path: Path | None) -> str | None:
        """The key of a picture file, None when it is absent or cannot be read."""
        if path is None:
            return None
        try:
            digest = hashlib.sha1(path.read_bytes(), usedforsecurity=False).hexdigest()[:12]
        except OSError:
            return None
        if digest not in self.store:
            picture: Picture | None = encode_file(path, self.plan.width, self.plan.quality)
            if picture is None:
                return None
            self.store[digest] = picture.uri
            self.sizes[digest] = (picture.width, picture.height)
            if self.assets is not None:
                target = self.assets / f"{digest}{path.suffix.lower()}"
                if not target.exists():
                    write_whole(target, path.read_bytes())
                self.links[digest] = f"{self.assets.name}/{target.name}"
        return digest

    def add_mask(self, path: Path | None) -> str | None:
        """The key of a picture that is black over what a mask hides and clear elsewhere; None without a mask."""
        image = None if path is None else read(path)
        if image is None:
            return None
        key = f"mask-{hashlib.sha1(image.tobytes(), usedforsecurity=False).hexdigest()[:12]}"
        if key not in self.store:
            cover = np.zeros((*image.shape[:2], 4), np.uint8)
            cover[..., 3] = np.where(image.reshape(*image.shape[:2], -1).max(axis=2) < 128, 255, 0)
            self.store[key] = encode(cover, self.plan.width, 100).uri
        return key

    def add_tint(self, run: Run, frame: int) -> str | None:
        """The key of a picture to lay over a frame: red where it was hidden from the method, yellow where the method
        left out what moves, clear elsewhere; None where all of it was used.
        """
        name = mask_name(frame)
        files = (run.mask, run.folder / FRAME_MASKS / name), (run.folder / MOVING / name,)
        hidden, moving = (_hidden_in([path for path in group if path is not None]) for group in files)
        shown = hidden if hidden is not None else moving
        if shown is None:
            return None
        tint = np.zeros((*shown.shape, 4), np.uint8)
        for where, colour in ((moving, MOVING_COLOUR), (hidden, HIDDEN_COLOUR)):
            if where is not None and where.shape == shown.shape:
                tint[where] = (*colour[::-1], 140)
        key = f"tint-{hashlib.sha1(tint.tobytes(), usedforsecurity=False).hexdigest()[:12]}"
        if key not in self.store:
            self.store[key] = encode(tint, self.plan.width, 60).uri
        return key


def _hidden_in(paths: Sequence[Path]) -> NDArray[np.bool_] | None:
    """(H, W): what any of the masks (black) hides; None without masks of one size."""
    found = [
        image.reshape(*image.shape[:2], -1).max(axis=2) < 128 for path in paths if (image := read(path)) is not None
    ]
    return np.any(found, axis=0) if found and len({mask.shape for mask in found}) == 1 else None


def copy_map(run: Run, gallery: Gallery, number: int) -> str | None:
    """Copy the run's map.ply to the assets; the link to it, None without assets or map."""
    source = run.folder / "map.ply"
    if gallery.assets is None or not source.is_file():
        return None
    target = gallery.assets / f"map-{number}.ply"
    write_whole(target, source.read_bytes())
    return f"{gallery.assets.name}/{target.name}"


def write_walk_page(run: Run, gallery: Gallery, number: int) -> str | None:
    """Write the page in which one walks through the run's map to the assets; the link to it, None without."""
    if gallery.assets is None or not (run.folder / "map.ply").is_file():
        return None
    from panobench.api import Run as Opened
    from panobench.errors import PanobenchError

    target = gallery.assets / f"walk-{number}.html"
    if target.name not in gallery.pages:
        try:
            Opened(run.folder).walk(target)
        except PanobenchError:  # a map that is damaged, or with nothing to show
            return None
        gallery.pages.add(target.name)
    return f"{gallery.assets.name}/{target.name}"


def make_gallery(collection: Collection, assets: Path | None = None, budget: int = BUDGET) -> Gallery:
    """A gallery whose plan (frames, width, quality) fits this collection into the budget, bytes."""
    sets = [[path for pair in run.pairs for path in (pair.render, pair.truth) if path] for run in collection.runs]
    return Gallery(plan(sets, budget), assets)


def viewer(runs: Sequence[Run], labels: Sequence[str], gallery: Gallery) -> dict[str, Any] | None:
    """Data of the viewer of one sequence, None without pictures.

    Keys: frames (indices), start (which entry of runs is shown first), panorama (whether one can look around in any),
    runs (each label, run, width, height, panorama, mask: the key of a cover for what was not compared or None,
    images: frame -> [render key, truth key or None], and tints: frame -> key of what was hidden, where anything was).
    """
    frames = choose_frames(runs, gallery.plan.frames)
    shown: list[dict[str, Any]] = []
    for i, run in enumerate(runs):
        by_frame = {pair.frame: pair for pair in run.pairs if not pair.novel}
        images: dict[str, list[str | None]] = {}
        tints: dict[str, str] = {}
        for frame in frames:
            pair = by_frame.get(frame)
            if pair is None:
                continue
            render = gallery.add(pair.render)
            if render is not None:
                images[str(frame)] = [render, gallery.add(pair.truth)]
                tint = gallery.add_tint(run, frame)
                if tint is not None:
                    tints[str(frame)] = tint
        if images:
            width, height = gallery.sizes[str(next(iter(images.values()))[0])]
            around = width == 2 * height and run.variant.get("camera", "erp").startswith("erp")
            about = {"label": labels[i], "run": i, "width": width, "height": height, "panorama": around}
            about["mask"] = gallery.add_mask(run.mask)
            shown.append({**about, "images": images, "tints": tints})
    if not shown:
        return None
    present = sorted({int(f) for entry in shown for f in entry["images"]})
    return {
        "frames": present,
        "runs": shown,
        # a panorama before the views of other cameras, whose scores are not comparable
        "start": max(range(len(shown)), key=lambda k: (shown[k]["panorama"], *_quality(runs[shown[k]["run"]]))),
        "panorama": any(entry["panorama"] for entry in shown),
    }


def _quality(run: Run) -> tuple[bool, float, float]:
    """Sorts runs by whether they succeeded, how well they render, and how well they track."""
    psnr, ate = run.number("pano_psnr_db"), run.number("ate_rmse_m")
    return failure(run) is None, -1.0 if psnr is None else psnr, -1e9 if ate is None else -ate


def choose_frames(runs: Sequence[Run], keep: int) -> list[int]:
    """At most ``keep`` frames, evenly spread over those that most runs have."""
    counts = Counter(pair.frame for run in runs for pair in run.pairs if not pair.novel)
    if not counts:
        return []
    most = max(counts.values())
    common = sorted(f for f, n in counts.items() if n == most)
    return [common[i] for i in spread(len(common), keep)]


def depth_pictures(run: Run, gallery: Gallery) -> dict[str, str] | None:
    """{"depth": key, "confidence": key} of the initial depth, None when the run has no such picture."""
    if run.depth is None:
        return None
    found = {"depth": gallery.add(run.depth.depth), "confidence": gallery.add(run.depth.confidence)}
    keys = {name: key for name, key in found.items() if key is not None}
    return keys or None


def hidden_picture(run: Run, gallery: Gallery) -> str | None:
    """Key of the frame on which what was hidden is drawn, None when the run has no such picture."""
    said = run.record.mask is not None or run.record.moving is not None
    return gallery.add(run.hidden) if said else None


def novel_pictures(run: Run, gallery: Gallery) -> list[tuple[str, str | None, int]]:
    """(render key, truth key, number) of views off the trajectory, at most four."""
    pairs = [pair for pair in run.pairs if pair.novel]
    out = []
    for i in spread(len(pairs), min(4, max(1, gallery.plan.frames // 2))):
        render = gallery.add(pairs[i].render)
        if render is not None:
            out.append((render, gallery.add(pairs[i].truth), pairs[i].frame))
    return out
