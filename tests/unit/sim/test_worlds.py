"""Every world can be driven, closes its loops, and is always the same."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from aliasing_worlds import make_world
from gridslam.errors import ArgumentError
from gridslam.sim import Change, World
from gridslam.sim.floor_plan import (
    box,
    clearance,
    join,
    near,
    polyline,
    wall,
)
from gridslam.sim.robot import RobotConfig
from gridslam.sim.world import wander
from gridslam.sim.worlds import WORLDS
from passages import carve, tour
from support.drives import drive, follow

NAMES = [*((name, 0) for name in WORLDS), *(("random", seed) for seed in range(12))]


def _length_of_drive(world, robot, period_s=0.1):
    """Once it is clear that the robot passes every wall that stands at the time."""
    poses, legs = follow(world.route, robot, period_s)
    for part, walls in world.stretches(legs, 500):
        path = poses[part, :2]
        some = near(walls, path, 1.0)
        assert clearance(some, path).min() > robot.radius_m + 0.1
        assert _crossings(some, path) == 0
    return np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()


def _crossings(walls, path):
    """How many steps of a path (N, 2) cross a wall: the ends of each lie on both sides of the other."""

    def side(a, b, c):
        return (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])

    a, b = path[:-1, None], path[1:, None]
    c, d = walls[None, :, :2], walls[None, :, 2:]
    return ((side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)).sum()


@pytest.mark.parametrize(("name", "seed"), NAMES)
def test_robot_passes_every_wall(name, seed):
    assert _length_of_drive(make_world(name, np.random.default_rng(seed)), RobotConfig()) > 30


@pytest.mark.parametrize(("name", "seed"), NAMES)
def test_route_comes_back_to_where_it_was_long_before(name, seed):
    path = drive(make_world(name, np.random.default_rng(seed)).route, RobotConfig(), 1.0)[:, :2]
    apart = np.hypot(*(path[:, None] - path[None]).transpose(2, 0, 1))
    later = np.subtract.outer(np.arange(len(path)), np.arange(len(path))) > 30
    assert apart[later].min() < 0.5


def test_demo_is_an_office_with_a_drive_of_about_100_m():
    world = WORLDS["demo"]()
    x, y = world.walls[:, [0, 2]], world.walls[:, [1, 3]]
    assert (x.min(), y.min()) == pytest.approx((0, 0))
    assert 24 <= x.max() < 26
    assert y.max() == pytest.approx(18)
    path = drive(world.route, RobotConfig(), 0.2)[:, :2]
    assert 90 < np.hypot(*np.diff(path, axis=0).T).sum() < 120


def test_unknown_world_is_refused_with_the_names_there_are():
    with pytest.raises(ArgumentError, match=r"demo.*random.*'castle'"):
        make_world("castle", np.random.default_rng(0))


@pytest.mark.parametrize("waypoints", [(0,), (3,), (2, 1), (1, 1)])
def test_changes_come_in_order_and_on_the_way(waypoints):
    with pytest.raises(ArgumentError, match="changes"):
        World.of("w", join(), [(0, 0), (1, 0), (2, 0), (3, 0)], [Change(k, join()) for k in waypoints])


JUNCTIONS = np.array([(0, 0), (10, 0), (20, 0), (20, 8), (10, 8), (30, 0)], dtype=float)
PASSAGES = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 1), (2, 5)]


@pytest.mark.parametrize("seed", range(5))
def test_tour_follows_passages_and_turns_back_only_in_dead_ends(seed):
    route = tour(JUNCTIONS, PASSAGES, 600.0, np.random.default_rng(seed))
    places = [int(np.flatnonzero((point == JUNCTIONS).all(axis=1))[0]) for point in route]
    ends = [frozenset(pair) for pair in pairwise(places)]
    assert ends[0] == {0, 1}
    assert set(ends) == {frozenset(pair) for pair in PASSAGES}
    assert all(place in (0, 5) for place, (a, b) in zip(places[1:-1], pairwise(ends), strict=True) if a == b)
    assert 600 <= np.hypot(*np.diff(route, axis=0).T).sum() < 610 + 8
    counts = [ends.count(frozenset(pair)) for pair in PASSAGES]
    assert max(counts) <= 2 * min(counts)


def test_wandering_keeps_the_waypoints_and_stays_near_the_line():
    line = np.array([(0, 0), (40, 0), (40, 3), (0, 3)], dtype=float)
    route, places = wander(line, np.random.default_rng(1), aside_m=0.2, every_m=5.0)
    assert np.array_equal(route[places], line)
    assert np.diff(places).tolist() == [8, 1, 8]
    away = clearance(polyline(line), route)
    assert 0.1 < away.max() <= 0.2
    assert np.hypot(*np.diff(route, axis=0).T).min() > 2.9


def _length(walls):
    return np.hypot(walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]).sum()


def test_wall_with_doors_keeps_its_thickness_and_leaves_the_openings_free():
    walls = wall((1, 2), (1, 12), [(3.0, 1.0), (8.0, 2.0)], thickness_m=0.2)
    assert walls.shape == (12, 4)  # three pieces of four faces
    assert _length(walls) == pytest.approx(2 * (10 - 3) + 6 * 0.2)
    middles = np.array([[1.0, 5.0], [1.0, 10.0], [1.0, 7.0]])
    assert clearance(walls, middles) == pytest.approx([0.5, 1.0, 0.1])


def test_clearance_to_faces_and_corners_and_to_nothing():
    points = np.array([[1.0, 1.0], [-3.0, -4.0], [2.0, 7.0]])
    assert clearance(box(0, 0, 4, 3), points) == pytest.approx([1.0, 5.0, 4.0])
    assert np.isinf(clearance(join(), points)).all()


def test_carved_room_and_corridor_by_hand():
    """A room of 2 m x 2 m above a corridor, with a doorway 1 m wide through a wall of 0.1 m."""
    walls = carve([(0, 0, 6, 1), (1.5, 1, 2.5, 1.1), (3, 3.1, 1, 1.1)])
    assert _length(walls) == pytest.approx((6 + 1 + 1 + 6 - 1) + 2 * 0.1 + (2 - 1 + 2 + 2 + 2))
    assert len(walls) == 12  # those in one line are one, but for the doorway
    assert clearance(walls, np.array([[2.0, 1.05], [2.0, 0.5], [2.0, 2.1]])) == pytest.approx([0.5, 0.5, 1.0])


corners = st.integers(0, 8)


@given(st.lists(st.tuples(corners, corners, corners, corners), min_size=1, max_size=8))
def test_carved_walls_stand_between_free_and_solid_and_nowhere_else(spaces):
    """A ray along a row of cells is in free space after an odd number of walls."""
    walls = carve(spaces)
    centres = np.arange(8) + 0.5
    x, y = np.meshgrid(centres, centres)
    free = np.zeros((8, 8), bool)
    for x0, y0, x1, y1 in spaces:
        free |= (min(x0, x1) < x) & (x < max(x0, x1)) & (min(y0, y1) < y) & (y < max(y0, y1))
    for horizontal in (True, False):
        a, b, c, d = (walls if horizontal else walls[:, [1, 0, 3, 2]]).T
        here, there = (x, y) if horizontal else (y, x)
        crossed = (b < there[..., None]) & (there[..., None] < d) & (a == c) & (a < here[..., None])
        assert np.array_equal(crossed.sum(axis=-1) % 2 == 1, free)
