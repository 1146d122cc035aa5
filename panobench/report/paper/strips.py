"""Strips of pictures: the input frame, the render of the map, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from panobench.report.images import read, spread
from panobench.report.model import ImagePair, Run
from panobench.report.paper.style import Style, new_figure

#: The difference is shown this many times larger, as on the page.
GAIN = 4.0
#: Rows of one run alone, and pixels per inch of a picture.
_ROWS, _DPI = 3, 300
#: A part of a label that is longer is cut: rows are low, and their labels stand upright.
_LETTERS = 14


def strips(runs: Sequence[Run], labels: Sequence[str], style: Style) -> Any:
    """A row per method, of the middle frame that most of them have; a single method shows several frames.

    None where no run has pictures with their frames.
    """
    rows = _rows(runs, labels)
    if not rows:
        return None
    first = read(rows[0][1].render)
    ratio = 0.5 if first is None else first.shape[0] / first.shape[1]
    width = (style.width - 0.2) / 3
    figure, axes = new_figure(style, len(rows) * (width * ratio + 0.04) + 0.2, len(rows), 3)
    figure.get_layout_engine().set(w_pad=0.01, h_pad=0.01, wspace=0.01, hspace=0.01)
    for k, (label, pair, mask) in enumerate(rows):
        pictures = _pictures(pair, mask, round(width * _DPI))
        for axis, title, picture in zip(axes[k], ("Frame", "Render", f"Difference × {GAIN:g}"), pictures):
            axis.set_xticks([])
            axis.set_yticks([])
            axis.grid(False)
            axis.spines[:].set_visible(False)
            if picture is not None:
                axis.imshow(picture, interpolation="none", cmap="inferno", vmin=0, vmax=1)
            if k == 0:
                axis.set_title(style.text(title), fontsize=7, pad=2)
        parts = [part if len(part) <= _LETTERS else f"{part[: _LETTERS - 1]}…" for part in label.split(" · ")]
        axes[k, 0].set_ylabel(style.text("\n".join(parts)), fontsize=5.5, labelpad=2)
    return figure


def _rows(runs: Sequence[Run], labels: Sequence[str]) -> list[tuple[str, ImagePair, Any]]:
    """(label, pictures, mask) of each row."""
    with_pairs = {
        i: {p.frame: p for p in run.pairs if not p.novel and p.truth is not None} for i, run in enumerate(runs)
    }
    with_pairs = {i: pairs for i, pairs in with_pairs.items() if pairs}
    if len(with_pairs) == 1:
        ((i, pairs),) = with_pairs.items()
        frames = sorted(pairs)
        return [(f"frame {frames[k]}", pairs[frames[k]], runs[i].mask) for k in spread(len(frames), _ROWS)]
    counts: dict[int, int] = {}
    for pairs in with_pairs.values():
        for frame in pairs:
            counts[frame] = counts.get(frame, 0) + 1
    common = sorted(f for f, n in counts.items() if n == max(counts.values()))
    if not common:
        return []
    frame = common[len(common) // 2]
    return [(labels[i], pairs[frame], runs[i].mask) for i, pairs in with_pairs.items() if frame in pairs]


def _pictures(pair: ImagePair, mask: Any, width: int) -> list[NDArray[Any] | None]:
    """Frame and render (H, W, 3) RGB, and the mean absolute difference (H, W) 0..1, amplified; 0 where masked."""
    truth, render = (None if p is None else _small(read(p), width) for p in (pair.truth, pair.render))
    difference = None
    if truth is not None and render is not None and truth.shape == render.shape:
        difference = np.clip(GAIN * np.abs(truth.astype(np.float64) - render).mean(axis=2) / 255.0, 0.0, 1.0)
        hidden = None if mask is None else _small(read(mask), width)
        if hidden is not None and hidden.shape[:2] == difference.shape:
            difference[hidden.reshape(*difference.shape, -1).max(axis=2) < 128] = 0.0
    return [truth, render, difference]


def _small(image: NDArray[np.uint8] | None, width: int) -> NDArray[np.uint8] | None:
    import cv2

    if image is None:
        return None
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    if image.shape[1] > width:
        height = max(1, round(image.shape[0] * width / image.shape[1]))
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)
    return np.ascontiguousarray(image[..., ::-1])
