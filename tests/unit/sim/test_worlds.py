"""Every world can be driven, closes its loops, and is always the same."""

import numpy as np
import pytest

from aliasing_worlds import make_world
from gridslam.errors import ArgumentError
from gridslam.sim import Change, World
from gridslam.sim.floor_plan import clearance, join, near
from gridslam.sim.robot import RobotConfig
from gridslam.sim.worlds import WORLDS
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
