"""Any sequence as another camera at the same position would have recorded it."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from panobench.cameras.base import Camera
from panobench.cameras.footprint import ENLARGED, enlargement
from panobench.cameras.reproject import Reprojector
from panobench.datasets.base import FrameSequence
from panobench.datasets.wrapped import WrappedSequence
from panobench.errors import UnsupportedError
from panobench.types import Imu, NovelView, Trajectory

#: A view is narrow if it takes at most this share of a panorama's columns, and worth a remark if its pictures have this
#: many times as many.
NARROW, SPARE = 0.5, 1.5


class ConvertedSequence(WrappedSequence):
    """``source`` seen by ``camera``, whose axes are the source's rotated by ``R_target_source``.

    Images and depth are reprojected on demand; the ground truth is that of the new camera; inertial samples stay those
    of the body. ``self.camera`` is ``camera`` with a mask of what the source covers; other pixels are black.
    Raises UnsupportedError when the two cameras see nothing in common.
    """

    def __init__(self, source: FrameSequence, camera: Camera, R_target_source: ArrayLike | None = None) -> None:
        self.source = source
        self.reprojector = Reprojector(source.camera, camera, R_target_source)
        self.camera = with_valid(camera, self.reprojector.valid)
        self.name, self.dataset, self.times = source.name, source.dataset, source.times
        self._novel: list[NovelView] | None = None

    def image(self, index: int) -> NDArray[np.uint8]:
        return self.reprojector.image(self.source.image(index))

    def depth(self, index: int) -> NDArray[np.float32] | None:
        depth = self.source.depth(index)
        return None if depth is None else self.reprojector.depth(depth)

    @cached_property
    def _groundtruth(self) -> Trajectory | None:
        truth = self.source.groundtruth
        return None if truth is None else Trajectory(truth.times, self.reprojector.poses(truth.T_wc))

    @property
    def groundtruth(self) -> Trajectory | None:
        return self._groundtruth

    @property
    def recorded_truth(self) -> Trajectory | None:
        truth = self.source.recorded_truth
        return None if truth is None else Trajectory(truth.times, self.reprojector.poses(truth.T_wc))

    @property
    def imu(self) -> Imu | None:
        imu = self.source.imu
        return None if imu is None else seen_from(imu, self.reprojector)

    def novel_views(self) -> list[NovelView]:
        """The source's novel views; those of the source's kind of camera are reprojected as its frames are.

        Views of another kind were not taken by this rig and stay as they are. Views that the new camera would not see
        are left out.
        """
        if self._novel is None:
            self._novel = [v for v in map(self._convert_view, self.source.novel_views()) if v is not None]
        return self._novel

    def _convert_view(self, view: NovelView) -> NovelView | None:
        if view.camera.kind != self.source.camera.kind:
            return view
        reprojector = self._view_reprojector(view.camera)
        if reprojector is None:
            return None
        camera = with_valid(reprojector.target, reprojector.valid)
        return NovelView(view.name, reprojector.image(view.image), camera, reprojector.poses(view.T_wc))

    def _view_reprojector(self, camera: Camera) -> Reprojector | None:
        if camera == self.source.camera:
            return self.reprojector
        key = (camera.width, camera.height)
        known = self._view_maps.get(key)
        if known is None or known.source != camera:
            try:
                known = Reprojector(camera, self.reprojector.target, self.reprojector.R_target_source)
            except UnsupportedError:
                return None
            self._view_maps[key] = known
        return known

    @cached_property
    def _view_maps(self) -> dict[tuple[int, int], Reprojector]:
        return {}

    @property
    def enlargement(self) -> float:
        return self._enlargement

    @cached_property
    def _enlargement(self) -> float:
        r = self.reprojector
        return max(1.0, self.source.enlargement * enlargement(r.source, r.target, r.R_target_source))

    def remarks(self) -> list[str]:
        said = [] if self.enlargement > ENLARGED else narrow_remark(self.source.camera, self.camera)
        return [*self.source.remarks(), *said]

    def provenance(self) -> dict[str, Any]:
        return {
            **self.source.provenance(),
            "conversion": {
                "source_camera": self.source.camera.to_dict(),
                "camera": self.reprojector.target.to_dict(),
                "R_target_source": self.reprojector.R_target_source.tolist(),
                "samples_per_pixel": self.reprojector.sampling.grid**2,
                "source_shrunk_by": self.reprojector.sampling.shrink,
            },
        }


def narrow_remark(source: Camera, target: Camera) -> list[str]:
    """A line that says how few of a panorama's columns a narrow view gets, if it has pixels for more; else none.

    target: with what the source covers as its mask.
    """
    seen = target.valid_mask()
    columns = int(seen.sum(axis=1).max())
    narrow = columns <= NARROW * target.width and columns * SPARE <= source.width
    if target.kind != "erp" or source.kind == "erp" or not narrow:
        return []
    return [
        f"the view takes {columns} of the panorama's {target.width} columns, its pictures have {source.width}; "
        f"--camera {source.kind} gives it all of --width"
    ]


def seen_from(imu: Imu, reprojector: Reprojector) -> Imu:
    """The same samples with the pose of the reprojector's target camera on the body."""
    T_body_cam = np.eye(4) if imu.T_body_cam is None else imu.T_body_cam
    return replace(imu, T_body_cam=reprojector.poses(T_body_cam))


def with_valid(camera: Camera, valid: NDArray[np.bool_]) -> Camera:
    """``camera`` with ``valid`` (H, W) as its mask, or with none if the model's own limits are the same."""
    plain = camera.with_mask(None)
    return plain if np.array_equal(valid, plain.valid_mask()) else plain.with_mask(valid)
