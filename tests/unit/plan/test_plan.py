"""A floor plan has the walls, doors, rooms and furniture of a map, wherever and however it lies."""

import numpy as np
import pytest

from gridslam.plan import SurfacePoints, make_plan, points_of_scans
from gridslam.types import OccupancyGrid
from support.drawn_maps import DOOR, TABLE, draw_two_rooms

AREAS = [24.0, 15.4]


@pytest.mark.parametrize("angle_deg", [0.0, 3.0, 17.0, -40.0, 90.0])
def test_rooms_doors_and_walls_are_those_of_the_map(angle_deg):
    plan = make_plan(draw_two_rooms(np.deg2rad(angle_deg)))
    assert [room.area_m2 for room in plan.rooms] == pytest.approx(AREAS, rel=0.04)
    assert [room.name for room in plan.rooms] == ["room 1", "room 2"]
    (door,) = plan.openings
    assert door.width_m == pytest.approx(DOOR[3] - DOOR[1], abs=0.1)  # two cells
    assert door.kind == "door"
    thick = [wall.thickness_m for wall in plan.walls if wall.thickness_m is not None]
    assert len(thick) == 2  # the wall between the rooms, on both sides of the door
    assert thick == pytest.approx([0.15, 0.15], abs=0.06)
    off = (np.rad2deg(plan.dominant_rad) - angle_deg + 45) % 90 - 45
    assert abs(off) < 0.3


def test_a_table_is_furniture_and_no_wall():
    plan = make_plan(draw_two_rooms())
    (table,) = plan.furniture
    assert table.min(axis=0) == pytest.approx(TABLE[:2], abs=0.06)
    assert table.max(axis=0) == pytest.approx(TABLE[2:], abs=0.06)
    assert len(plan.walls) == len(make_plan(draw_two_rooms(table=None)).walls)
    assert plan.rooms[0].area_m2 == pytest.approx(AREAS[0], rel=0.04)  # the floor goes on beneath it


def test_a_table_against_a_wall_is_furniture_too():
    against = make_plan(draw_two_rooms(table=(2.0, 3.2, 3.6, 4.0)))
    assert len(against.furniture) == 1
    assert sum(wall.length_m for wall in against.walls) == pytest.approx(
        sum(wall.length_m for wall in make_plan(draw_two_rooms(table=None)).walls), abs=0.5
    )


def test_without_a_door_there_is_no_opening():
    plan = make_plan(draw_two_rooms(door=None))
    assert not plan.openings
    assert len(plan.rooms) == 2


@pytest.mark.parametrize("x", [3.0, 8.0])
def test_a_room_that_was_only_looked_into_comes_after_those_that_were_entered(x):
    plan = make_plan(draw_two_rooms(), path=np.array([[x, 1.0], [x, 3.0]]))
    assert [room.name for room in plan.rooms] == ["room 1", "not entered 1"]
    assert [room.is_entered for room in plan.rooms] == [True, False]
    assert [room.area_m2 for room in plan.rooms] == pytest.approx(AREAS if x == 3.0 else AREAS[::-1], rel=0.04)
    assert [room.is_entered for room in make_plan(draw_two_rooms()).rooms] == [None, None]


@pytest.mark.parametrize("shape", [(1, 1), (30, 40)])
@pytest.mark.parametrize("known", [False, True])
def test_a_map_without_walls_has_an_empty_plan(shape, known):
    nothing = OccupancyGrid(np.full(shape, -4.0, np.float32), np.full(shape, known), 0.05, (0.0, 0.0))
    plan = make_plan(nothing)
    assert not plan.walls
    assert not plan.rooms


def _scans(noise_m=0.01, seed=0, extra=None):
    """Scans from two places in the left room, without the table: end points on its four walls."""
    rng = np.random.default_rng(seed)
    for _ in range(40):
        origin = rng.uniform((1.0, 1.0), (5.0, 3.0))
        angles = rng.uniform(0, 2 * np.pi, 180)
        ways = np.column_stack([np.cos(angles), np.sin(angles)])
        with np.errstate(divide="ignore"):
            reach = np.where(ways > 0, (np.array([6.0, 4.0]) - origin) / ways, -origin / ways).min(axis=1)
        ranges = reach + rng.normal(0, noise_m, len(reach))
        ends = origin + ranges[:, None] * ways
        ends = ends[~((ends[:, 0] > 5.9) & (np.abs(ends[:, 1] - 2.0) < 0.6))]  # the door
        yield origin, ends if extra is None else np.concatenate([ends, extra])


def test_end_points_are_exacter_than_cells():
    grid = draw_two_rooms(table=None)
    points = points_of_scans(_scans(), grid.resolution_m)
    bottom = [face for face in make_plan(grid, points).faces if face.normal[1] > 0.99]
    (face,) = bottom
    assert abs(face.middle[1]) < 0.002
    by_cells = [face for face in make_plan(grid).faces if face.normal[1] > 0.99 and face.middle[0] < 6]
    assert abs(by_cells[0].middle[1]) > 0.01  # the middle of the cells


def test_normals_point_to_where_the_laser_was():
    points = points_of_scans(_scans(), 0.05)
    to_middle = np.array([3.0, 2.0]) - points.positions
    assert (np.einsum("ij,ij->i", points.normals, to_middle) > 0).mean() > 0.99
    assert np.hypot(*points.normals.T) == pytest.approx(np.ones(len(points)))


def test_who_has_gone_leaves_no_wall():
    """End points where the map is free are of people, who have gone."""
    grid = draw_two_rooms(table=None)
    person = np.column_stack([np.linspace(1.5, 2.7, 40), np.full(40, 2.0)])
    plan = make_plan(grid, points_of_scans(_scans(extra=person), grid.resolution_m))
    assert not any(abs(face.middle[1] - 2.0) < 0.5 and 0.5 < face.middle[0] < 5 for face in plan.faces)


def test_no_points_and_few_points_are_no_face():
    nothing = np.zeros((0, 2))
    grid = draw_two_rooms()
    assert not make_plan(grid, SurfacePoints(nothing, nothing, np.zeros(0))).faces
    assert not make_plan(grid, points_of_scans([(np.zeros(2), np.array([[1.0, 0.0]]))], 0.05)).faces


def test_what_was_seen_through_a_window_bounds_nothing():
    """A wall outside, at the end of a few beams, is left out; the sheet ends at the rooms."""
    grid = draw_two_rooms(margin_m=6.0)
    log_odds, known = grid.log_odds.copy(), grid.known.copy()
    x, y = np.meshgrid(
        *(low + (np.arange(n) + 0.5) * 0.05 for low, n in zip(grid.origin, grid.shape[::-1], strict=True))
    )
    beam = (np.abs(x - 3.0) < 0.05) & (y > 3.9) & (y < 7.0)  # 10 cm wide
    beam |= (np.abs(x - 3.2) < 0.6) & (np.abs(y - 6.95) < 0.05)
    log_odds[beam], known[beam] = -4.0, True
    wall = (np.abs(x - 3.2) < 0.6) & (np.abs(y - 7.05) < 0.05)
    log_odds[wall], known[wall] = 4.0, True
    outside = OccupancyGrid(log_odds, known, grid.resolution_m, grid.origin)
    plan, alone = make_plan(outside), make_plan(grid)
    assert any(face.middle[1] > 6.9 for face in plan.faces)
    tops = [max(wall.ends[:, 1].max() for wall in one.walls) for one in (plan, alone)]
    assert tops[0] == pytest.approx(tops[1], abs=0.1)
    assert [room.area_m2 for room in plan.rooms] == pytest.approx(AREAS, rel=0.04)
