"""Image quality of the map in the paper's three views, the panorama, held-out frames and novel views.

docs/protocol.md defines every number, and which frames are rendered.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.datasets.files.images import write_image
from panobench.errors import UnsupportedError
from panobench.metrics.alignment import match, world_alignment
from panobench.metrics.base import MetricInput, Render
from panobench.metrics.image_quality import psnr, ssim
from panobench.metrics.lpips import Lpips, find_lpips
from panobench.metrics.perspective import perspective_views

#: At least this many seen frames are rendered (all, if there are fewer than twice as many).
SEEN_FRAMES = 20
#: At most this many held-out frames.
HELD_OUT_FRAMES = 100
#: Frames whose pictures are stored for the report.
STORED_FRAMES = 8
Image = NDArray[np.float32]


@dataclass
class Means:
    """Means over images, without those that could not be measured."""

    values: dict[str, list[float]] = field(default_factory=dict)

    def add(self, key: str, value: float | None) -> None:
        if value is not None and np.isfinite(value):
            self.values.setdefault(key, []).append(value)

    def result(self) -> dict[str, float | None]:
        return {key: float(np.mean(v)) for key, v in self.values.items()}


def rendering_metrics(data: MetricInput) -> dict[str, float | None]:
    """Renders some frames at their estimated poses, and novel views at their true poses moved into the map."""
    trajectory = data.estimate.trajectory
    if data.render is None or len(trajectory) == 0:
        return {}
    index = np.searchsorted(data.sequence.times, trajectory.times)
    poses = dict(zip(index.tolist(), trajectory.T_wc))
    held = [i for i in data.holdout if i in poses]
    seen = [i for i in poses if i not in set(data.holdout)]
    judge = FrameJudge(data.sequence.camera, data.render, data.notes)
    means = Means()
    stored = set(spread(sorted(poses), STORED_FRAMES))
    for i in sorted({*thin(seen, SEEN_FRAMES), *held[:: max(1, -(-len(held) // HELD_OUT_FRAMES))], *stored}):
        truth = as_float(data.sequence.image(i))
        render = judge.render(data.sequence.camera, poses[i])
        if render is None:
            data.notes.setdefault("psnr_db", "the method has no map that can be rendered")
            return {}
        if i in stored and data.renders is not None:
            write_pair(data.renders, f"{i:06d}", render, truth)
        judge.add(means, truth, render, poses[i], held_out=i in held, visible=data.sequence.frame_mask(i))
    novel_views(data, judge, means)
    return means.result()


def as_float(image: NDArray[np.uint8]) -> Image:
    """uint8 -> 0..1."""
    return np.asarray(image / np.float32(255), dtype=np.float32)


def thin(frames: list[int], least: int) -> list[int]:
    """Each k-th frame, k the largest that leaves at least ``least`` of them."""
    return frames[:: max(1, len(frames) // least)]


def spread(frames: list[int], n: int) -> list[int]:
    """n of the frames, evenly spread, first and last included."""
    return [frames[i] for i in sorted({round(x) for x in np.linspace(0, len(frames) - 1, min(n, len(frames)))})]


class FrameJudge:
    """Compares frames of one camera: the panorama with its weights, and the perspective views cut from it."""

    def __init__(self, camera: Camera, renderer: Render, notes: dict[str, str]) -> None:
        self.camera, self._renderer = camera, renderer
        self.valid, self.solid_angle = camera.valid_mask(), camera.solid_angle()
        self.views = perspective_views(camera)
        self.lpips: Lpips | None = find_lpips(notes)
        if not self.views:
            notes["views"] = "the camera sees none of the three views wholly: its own frames are judged instead"

    def render(self, camera: Camera, T_wc: NDArray[np.float64]) -> Image | None:
        """RGB (H, W, 3) in 0..1; NaN becomes black."""
        image = self._renderer(camera, T_wc)
        if image is None:
            return None
        expected = (camera.height, camera.width, 3)
        if image.shape != expected:
            raise UnsupportedError(f"render() returned shape {image.shape}, expected {expected}")
        return np.clip(np.nan_to_num(np.asarray(image, np.float32)), 0.0, 1.0)

    def add(
        self,
        means: Means,
        truth: Image,
        render: Image,
        T_wc: NDArray[np.float64],
        held_out: bool,
        visible: NDArray[np.bool_] | None = None,
    ) -> None:
        """Compare a render with what it should show, where the frame shows the scene: ``visible`` (H, W)."""
        seen = self.valid if visible is None else self.valid & visible
        plain, weighted = psnr(render, truth, seen), psnr(render, truth, self.solid_angle * seen)
        means.add("holdout_psnr_db" if held_out else "pano_psnr_db", plain)
        means.add("holdout_ws_psnr_db" if held_out else "ws_psnr_db", weighted)
        for picture, reference, valid in self._view_pairs(truth, render, visible):
            means.add("holdout_views_psnr_db" if held_out else "psnr_db", psnr(picture, reference, valid))
            if not held_out:
                means.add("ssim", ssim(picture, reference, valid))
                if self.lpips is not None:
                    means.add("lpips", self.lpips(picture, reference, valid))
        if not held_out:
            self._add_direct(means, truth, T_wc, visible)

    def _view_pairs(
        self, truth: Image, render: Image, visible: NDArray[np.bool_] | None
    ) -> Iterable[tuple[Image, Image, NDArray[np.bool_]]]:
        """The views of the map and of the frame, both cut out in the same way."""
        if not self.views:
            yield render, truth, self.valid if visible is None else self.valid & visible
        for view in self.views:
            yield view.image(render), view.image(truth), view.valid if visible is None else view.shows(visible)

    def _add_direct(
        self, means: Means, truth: Image, T_wc: NDArray[np.float64], visible: NDArray[np.bool_] | None
    ) -> None:
        """Views rendered straight into the perspective camera, against the interpolated frame."""
        for view in self.views:
            picture = self.render(view.camera, view.pose(T_wc))
            if picture is not None:
                valid = view.valid if visible is None else view.shows(visible)
                means.add("direct_psnr_db", psnr(picture, view.image(truth), valid))


def novel_views(data: MetricInput, judge: FrameJudge, means: Means) -> None:
    """PSNR and SSIM at true poses apart from the trajectory, moved into the map's world by the inverse alignment."""
    views = data.sequence.novel_views()
    if not views:
        return
    matched = match(data.estimate.trajectory, data.sequence.groundtruth)
    if matched is None or len(matched) < 3:
        data.notes["novel_psnr_db"] = "novel views need three tracked frames with ground truth"
        return
    to_map = world_alignment(matched).inverse()
    for number, view in enumerate(views):
        render = judge.render(view.camera, to_map.apply_poses(view.T_wc))
        if render is None:
            return
        truth = as_float(view.image)
        valid = view.camera.valid_mask()
        means.add("novel_psnr_db", psnr(render, truth, valid))
        means.add("novel_ssim", ssim(render, truth, valid))
        if data.renders is not None and number < STORED_FRAMES:
            write_pair(data.renders, f"novel_{number:03d}", render, truth)


def write_pair(folder: Path, stem: str, render: Image, truth: Image) -> None:
    """STEM.jpg and STEM_gt.jpg, at full size."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in ((f"{stem}.jpg", render), (f"{stem}_gt.jpg", truth)):
        write_image(folder / name, np.uint8(np.round(image * 255)), quality=92)
