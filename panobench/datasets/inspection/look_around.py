"""A self-contained HTML page for looking around in panoramas: WebGL, inline images, no network."""

from __future__ import annotations

import base64
import html
import json
from importlib.resources import files
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.datasets.files.images import encode_image
from panobench.writing import write_whole


def look_around_page(title: str, panoramas: list[tuple[str, NDArray[np.uint8]]], *, quality: int = 88) -> str:
    """The page's HTML for pairs of label and full panorama (H, W, 3); with several, a slider chooses one."""
    frames = [
        {"label": label, "src": "data:image/jpeg;base64," + base64.b64encode(_jpeg(image, quality)).decode("ascii")}
        for label, image in panoramas
    ]
    template = (files("panobench.datasets.inspection") / "look_around.html").read_text(encoding="utf-8")
    data = json.dumps(frames).replace("</", "<\\/")
    return template.replace("{{title}}", html.escape(title)).replace("{{frames}}", data)


def write_look_around_page(path: Path, title: str, panoramas: list[tuple[str, NDArray[np.uint8]]]) -> None:
    """Write the page. Raises OutputError if it cannot be written."""
    write_whole(path, look_around_page(title, panoramas))


def _jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    return encode_image(image, ".jpg", quality=quality)
