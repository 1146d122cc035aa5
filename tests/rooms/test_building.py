"""A building: what its cells leave out cannot be seen, and the walk through the offices is one that people can walk."""

from __future__ import annotations

import numpy as np
import pytest

from panobench.cameras.erp import ErpCamera
from panobench.errors import UsageError
from panobench.rooms import offices, render
from panobench.rooms.builder import Builder
from panobench.rooms.building import WALL, Building, Space
from panobench.rooms.mesh import Material
from panobench.rooms.scene import make_geometry
from panobench.rooms.shell import SIDES, Room
from panobench.rooms.trace import clearances
from panobench.rooms.walks import Walk, walk_poses
from panobench.rooms.world import World

PLAIN = Material("", 1.0)


def box(b: Builder, room: Room) -> None:
    """A crate in the middle of a space."""
    x, y = (room.x0 + room.x1) / 2, (room.y0 + room.y1) / 2
    b.box((x - 0.3, y - 0.3, 0.0), (x + 0.3, y + 0.3, 0.7), PLAIN)


def three_rooms() -> tuple[Building, Builder]:
    """Two rooms side by side with a door between, and a third behind the second's other door, round the corner."""
    b = Builder(np.random.default_rng(0), node_spacing=5.0)
    building = Building(b)
    for name, x0, y0 in (("a", 0.0, 0.0), ("b", 4.0 + WALL, 0.0), ("c", 4.0 + WALL, 4.0 + WALL)):
        room = Room(x0, y0, x0 + 4, y0 + 4, 2.5, dict.fromkeys(SIDES, PLAIN), PLAIN, PLAIN, PLAIN, {}, WALL)
        building.add(name, Space(room, 0.0, box))
    building.link("a", "b", 0.8)
    building.link("b", "c", 7.4)
    building.build()
    return building, b


def test_cells_leave_out_only_what_cannot_be_seen() -> None:
    building, b = three_rooms()
    mesh = b.build()
    cells = building.cells(mesh)
    everything, culled = make_geometry(mesh), make_geometry(mesh, cells)
    bundle = render.ray_bundle(ErpCamera(128, 64))
    counts = []
    for point in (
        [0.5, 3.0, 1.5],
        [3.9, 0.8, 1.5],
        [4.08, 0.8, 1.2],
        [7.0, 3.5, 1.6],
        [5.0, 5.0, 0.9],
        [2.0, 2.0, 1.9],
    ):
        T = np.eye(4)
        T[:3, 3] = point
        np.testing.assert_array_equal(render.depth(culled, bundle, T), render.depth(everything, bundle, T))
        counts.append(len(cells.primitives(np.array(point))))
    assert min(counts) < 0.6 * len(mesh.p0)


def test_outside_of_all_cells_everything_is_kept() -> None:
    building, b = three_rooms()
    mesh = b.build()
    assert len(building.cells(mesh).primitives(np.array([-9.0, 0.0, 1.0]))) == len(mesh.p0)


def test_spaces_that_do_not_meet_cannot_be_linked() -> None:
    building, _ = three_rooms()
    with pytest.raises(ValueError, match="no side"):
        building.link("a", "c", 1.0)


@pytest.mark.slow
def test_the_walk_through_the_offices() -> None:
    plan = offices.office_building(np.random.default_rng(3))
    T_wc = walk_poses(plan.walk, Walk(6000), np.random.default_rng(3))
    centres = np.ascontiguousarray(T_wc[:, :3, 3])
    steps = np.linalg.norm(np.diff(centres, axis=0), axis=1)
    assert steps.sum() > 400.0
    assert steps.min() > 0.03
    assert steps.max() < 0.12
    mesh = plan.mesh
    assert clearances(mesh.p0, mesh.eu, mesh.ev, centres[::8]).min() > 0.3
    turns = np.einsum("nij,nij->n", T_wc[:-1, :3, :3], T_wc[1:, :3, :3])
    assert np.degrees(np.arccos(np.clip((turns.min() - 1) / 2, -1, 1))) < 15.0
    assert plan.cells is not None
    assert all(plan.cells.around(point) for point in centres[::50])


def test_parts_of_the_walk_lie_on_it() -> None:
    whole, part = World("building", 0, None), World("building-storey", 0, None)
    assert whole.folder == part.folder
    assert part.frames == 1000
    with pytest.raises(UsageError, match="ends after 4700"):
        World("building-storey", 0, 5000)
