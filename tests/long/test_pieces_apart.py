"""Drives in other buildings stay apart, those in one building are joined: cases in which weaker rules were wrong."""

from dataclasses import replace

import numpy as np
import pytest

import gridslam
from aliasing_worlds import make_world
from gridslam.geometry.se2 import between, compose
from gridslam.io.carmen.writer import write_carmen
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, simulate
from gridslam.slam.full_slam import earlier_pieces
from support.furnished_floor import Floor, is_found

ELSEWHERE = np.array([10.0, 0.0, 2.0])


def drive(folder, name, world, seed):
    """Write the log of a drive whose odometry begins elsewhere."""
    rng = np.random.default_rng(seed)
    measurements = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(), rng).measurements
    begin = measurements[0].odometry.pose
    moved = [
        Measurement(replace(odometry, pose=compose(ELSEWHERE, between(begin, odometry.pose))), scan)
        for odometry, scan in measurements
    ]
    write_carmen(folder / f"{name}.clf", moved)
    return folder / f"{name}.clf"


def count_pieces(folder, worlds, seeds):
    """Number of pieces that two drives leave, one after the other and then merged."""
    session = gridslam.Session()
    session.add(drive(folder, "first", worlds[0], seeds[0]), repair="none")
    session.add(drive(folder, "second", worlds[1], seeds[1]), place="elsewhere", repair="none")
    session.merge()
    return len(session.pieces)


def other(kind, seed):
    """Two worlds of a kind."""
    return [make_world(kind, np.random.default_rng(2 * seed + k)) for k in range(2)]


@pytest.mark.parametrize(("kind", "seed"), [("random", 3), ("random", 4), ("equal_rooms", 1)])
def test_other_buildings_stay_apart(tmp_path, kind, seed):
    assert count_pieces(tmp_path, other(kind, seed), (1000 + seed, 1500 + seed)) == 2


@pytest.mark.parametrize("is_loose", [False, True])
def test_another_floor_of_the_same_plan_stays_apart(monkeypatch, is_loose):
    """All its furniture stands elsewhere, which contradicts what the walls show; by looser rules it is joined."""
    if is_loose:
        monkeypatch.setattr(earlier_pieces, "_MIN_AGREEMENT", 0.7)
        monkeypatch.setattr(earlier_pieces, "_MIN_LOG_LIKELIHOOD", 15.0)
    assert is_found(Floor(6).drive(60.0), Floor(106).drive(60.0), 6) == is_loose


@pytest.mark.parametrize("kind", ["random", "equal_rooms"])
def test_two_days_in_one_building_are_joined(tmp_path, kind):
    world = make_world(kind, np.random.default_rng(1))
    assert count_pieces(tmp_path, (world, world), (1001, 1501)) == 1
