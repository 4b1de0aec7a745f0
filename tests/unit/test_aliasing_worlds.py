"""In worlds made to deceive, places that are not the same look the same; `test_worlds` drives through them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from aliasing_worlds import cross, make_world, ring, serpentine, twins
from gridslam.geometry import se2
from gridslam.sim import RobotConfig
from gridslam.sim.lidar import LidarConfig, cast_rays
from support.drives import follow

KINDS = ["equal_rooms", "symmetric", "bare_corridors", "moved_furniture"]
BEARINGS = LidarConfig().bearings


@pytest.mark.parametrize("name", [*KINDS, "campus", "grounds"])
def test_each_seed_has_its_own_and_always_the_same(name):
    one, again, other = (make_world(name, np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert one.name == name
    assert one.walls.tobytes() == again.walls.tobytes()
    assert one.route.tobytes() == again.route.tobytes()
    assert [c.walls.tobytes() for c in one.changes] == [c.walls.tobytes() for c in again.changes]
    assert one.route.tobytes() != other.route.tobytes()


@pytest.mark.parametrize(("maker", "turn"), [(ring, math.pi / 2), (cross, math.pi / 2), (twins, math.pi)])
@pytest.mark.parametrize("seed", range(4))
def test_a_symmetric_building_looks_the_same_after_a_turn(maker, turn, seed):
    world = maker(np.random.default_rng(seed))
    ends = world.walls.reshape(-1, 2)
    centre = (ends.min(axis=0) + ends.max(axis=0)) / 2
    here = follow(world.route, RobotConfig(), 5.0)[0]
    about = se2.compose([*centre, turn], se2.compose(se2.inverse(np.array([*centre, 0.0])), here))
    one, other = (cast_rays(world.walls, poses, BEARINGS) for poses in (here, about))
    # A beam that grazes a corner may pass it on either side.
    assert np.isclose(one, other, atol=1e-4).mean() > 0.999


@pytest.mark.parametrize("seed", range(4))
def test_the_middles_of_parallel_corridors_look_the_same(seed):
    world = serpentine(np.random.default_rng(seed))
    x = world.walls[:, [0, 2]]
    poses, _ = follow(world.route, RobotConfig(), 0.2)
    middle = poses[np.abs(poses[:, 0] - (x.min() + x.max()) / 2) < 0.07]
    rows = np.unique(np.round(middle[:, 1] / 1.0))
    assert len(rows) >= 3
    straight = np.column_stack([middle[:, :2], np.where(np.cos(middle[:, 2]) > 0, 0.0, -math.pi)])
    widths = cast_rays(world.walls, straight, np.array([-math.pi / 2, math.pi / 2])).sum(axis=1)
    assert np.ptp(widths) < 1e-6
