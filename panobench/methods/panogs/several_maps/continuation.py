"""A saved map at both ends of a run: keyframes as views to go on with, and views as keyframes to save.

Keyframes of an earlier run have negative frame indices, so that they are never mistaken for frames of this one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from panobench.cameras.base import Camera
from panobench.errors import UsageError
from panobench.maps.saved import SavedKeyframe, SavedMap
from panobench.methods.panogs.factor_graph.place_recognition import Places
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import SeenGaussians, View
from panobench.photometric.pyramid import luma_of_planes
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Render, Renderer


def earlier_views(saved: SavedMap, renderer: Renderer) -> list[View]:
    """The map's keyframes as views that training can go on with.

    Pixels that the map's camera hid are taken from the map itself, so that training leaves them alone.
    """
    hidden = ~saved.camera.valid_mask()
    views = []
    for n, k in enumerate(saved.keyframes):
        image = k.image
        if hidden.any():
            render = renderer.forward(saved.gaussians, k.T_wc)
            image = np.where(hidden[..., None], picture(render), image)
        views.append(View(n - len(saved.keyframes), image, k.T_wc.copy()))
    return views


def check_camera(saved: SavedMap, camera: Camera) -> None:
    """Raises UsageError unless the map's keyframes were taken by such a camera, whatever its mask hides."""
    if saved.camera.to_dict() != camera.to_dict():
        theirs, ours = (f"{c.kind} of {c.width}x{c.height} pixels" for c in (saved.camera, camera))
        raise UsageError(
            f"the saved map was made through {theirs}, these frames come through {ours}: give the same --camera, --fov "
            "and --width to map on; `panobench localize` takes any"
        )


def continue_map(saved: SavedMap, camera: Camera, mapper: Mapper, trajectory: AnchoredTrajectory) -> None:
    """Make a saved map the one that is mapped on; its newest keyframe is the whole window."""
    check_camera(saved, camera)
    mapper.map.append(saved.gaussians, saved.anchors)
    mapper.optimiser.scene_depth = saved.scene_depth
    for view, k in zip(earlier_views(saved, mapper.renderer), saved.keyframes):
        trajectory.add_keyframe(view, k.time)
    newest = trajectory.keyframes[-1]
    render = mapper.renderer.forward(mapper.map.gaussians, newest.T_wc, count_touched=True)
    assert render.touched is not None
    newest.seen = SeenGaussians.of(render.touched, mapper.map.ids, mapper.map.next_id)
    mapper.optimiser.window = [newest]
    trajectory.frames.extend(trajectory.keyframes[:-1])


def add_places(
    places: Places, gaussians: GaussianMap, poses: Sequence[NDArray[np.float64]], renderer: Renderer
) -> None:
    """Thumbnails of the map at ``poses``, as the renderer's camera sees it: it need not be the one that mapped."""
    for T_wc in poses:
        places.add(places.thumbnail(luma_of_planes(renderer.forward(gaussians, T_wc).planes)))


def saved_map(
    mapper: Mapper, camera: Camera, trajectory: AnchoredTrajectory, metric: bool, made_by: str
) -> SavedMap | None:
    """The map with its keyframes; None if nothing was mapped. A keyframe without its image gets the map's picture."""
    gaussians, keyframes = mapper.map.gaussians, trajectory.keyframes
    if not len(gaussians) or not keyframes:
        return None
    kept = []
    for view in keyframes:
        image = view.image if view.image.size else picture(mapper.renderer.forward(gaussians, view.T_wc))
        kept.append(SavedKeyframe(view.index, trajectory.time(view.index), view.T_wc.copy(), image))
    return SavedMap(
        gaussians.copy(), mapper.map.anchors.copy(), camera, tuple(kept), mapper.scene_depth, metric, made_by
    )


def picture(render: Render) -> NDArray[np.uint8]:
    """(H, W, 3) RGB uint8."""
    return np.asarray(np.round(np.clip(render.colour, 0, 1) * 255).astype(np.uint8))
