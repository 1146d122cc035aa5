"""What frames see through goes from the map, and the hole it leaves is closed by what is around it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from panobench.datasets.synthetic.rooms import RoomsDataset
from panobench.methods.panogs.config import PanogsConfig
from panobench.methods.panogs.mapping.frame_votes import FrameVotes
from panobench.methods.panogs.mapping.ghosts import close_hole, ghosts_of, remove_ghosts
from panobench.methods.panogs.mapping.mapper import Mapper
from panobench.methods.panogs.trajectory import AnchoredTrajectory
from panobench.methods.splatting.views import View
from panobench.splat.gaussians import GaussianMap
from panobench.splat.render import Renderer
from panobench.types import Frame

WIDTH, FRAMES = 128, 24


@dataclass
class Room:
    """`tiny` mapped from its first frame, with views of it at their true poses."""

    mapper: Mapper
    votes: FrameVotes
    views: list[View]


@pytest.fixture
def room() -> Room:
    sequence = RoomsDataset().open("tiny", width=WIDTH)
    truth, depth = sequence.groundtruth, sequence.depth(0)
    assert truth is not None
    assert depth is not None
    trajectory = AnchoredTrajectory()
    mapper = Mapper(sequence.camera, Renderer(sequence.camera, "sphere", 0.1), PanogsConfig(), trajectory, 0)
    first = np.linalg.inv(truth.T_wc[0])
    views = [View(i, sequence.image(i), first @ truth.T_wc[i]) for i in range(0, FRAMES, 3)]
    mapper.initialise(views[0], 0.0, depth)
    votes = FrameVotes(sequence.camera, trajectory)
    for view in views:
        if view is not views[0]:
            trajectory.add(view.index, float(sequence.times[view.index]), view.T_wc, views[0])
            mapper.remember(view)
        votes.add(Frame(view.index, float(sequence.times[view.index]), view.image))
    return Room(mapper, votes, views)


def ghost(mapper: Mapper, view: View) -> GaussianMap:
    """Part of the walls that ``view`` sees, at half the distance and in other colours."""
    ahead = (mapper.map.gaussians.means - view.position) @ view.T_wc[:3, :3]
    near = np.flatnonzero(ahead[:, 2] > 0.97 * np.linalg.norm(ahead, axis=1))
    some = mapper.map.gaussians.select(near)
    means = (view.position + 0.5 * (some.means - view.position)).astype(np.float32)
    scales = some.log_scales + np.float32(np.log(0.5))
    return GaussianMap(means, scales, some.quats, some.opacity_logits + 2, np.float32(1) - some.colours)


def test_what_no_frame_has_seen_is_told_from_the_rest(room: Room) -> None:
    mapper = room.mapper
    assert not ghosts_of(mapper, room.views, room.votes).any()
    before = len(mapper.map)
    mapper.map.append(ghost(mapper, room.views[3]), 0)
    found = ghosts_of(mapper, room.views, room.votes)
    assert found[before:].mean() > 0.6
    assert found[:before].mean() < 0.1  # some of what lies behind goes with it, and is seeded again
    few = ghosts_of(mapper, room.views[:3], room.votes)  # three views are no evidence
    assert not few.any()


def test_somebody_who_walks_before_a_wall_does_not_disprove_it(room: Room) -> None:
    mapper = room.mapper
    votes = FrameVotes(mapper.camera, mapper.trajectory)
    chequered = 255 * (np.indices((WIDTH // 2, WIDTH)).sum(axis=0) // 6 % 2)
    views = []
    for number, view in enumerate(room.views):
        image = view.image.copy()
        if number < 5:
            image[20:48, 10 + 5 * number : 50 + 5 * number] = chequered[20:48, :40, None]
        views.append(View(view.index, image, view.T_wc))
        votes.add(Frame(view.index, float(view.index), image))
    render = mapper.renderer.forward(mapper.map.gaussians, views[2].T_wc)
    assert mapper.transients.contradicted(views[2].image, render).mean() > 0.08
    assert ghosts_of(mapper, views, votes).mean() < 0.01


def test_a_hole_is_closed_where_the_frames_agree_on_what_is_there(room: Room) -> None:
    mapper, view = room.mapper, room.views[4]
    ahead = (mapper.map.gaussians.means - view.position) @ view.T_wc[:3, :3]
    wall = ahead[:, 2] > 0.97 * np.linalg.norm(ahead, axis=1)
    depth = float(np.median(np.linalg.norm(ahead[wall], axis=1)))
    mapper.map.drop(wall)
    assert mapper.thin(mapper.renderer.forward(mapper.map.gaussians, view.T_wc)).any()
    somebody = View(view.index, 255 - view.image, view.T_wc)
    assert close_hole(mapper, somebody, room.votes) < 0.1 * wall.sum()  # grey is its own negative
    before = len(mapper.map)
    assert close_hole(mapper, view, room.votes) > 0.3 * wall.sum()
    new = np.linalg.norm(mapper.map.gaussians.means[before:] - view.position, axis=1)
    assert abs(np.median(new) / depth - 1) < 0.25
    assert mapper.thin(mapper.renderer.forward(mapper.map.gaussians, view.T_wc)).mean() < 0.01


def test_a_ghost_is_replaced_by_what_stands_behind_it(room: Room) -> None:
    mapper, view = room.mapper, room.views[3]
    mapper.map.append(ghost(mapper, view), 0)

    def error() -> float:
        return float(np.abs(mapper.renderer.forward(mapper.map.gaussians, view.T_wc).colour - view.image / 255).mean())

    before = error()
    assert remove_ghosts(mapper, room.votes) > 20
    assert error() < 0.7 * before
    left = remove_ghosts(mapper, room.votes)
    assert left < 10
