"""Sessions: what is cut goes on, what was moved is found again, what shows the same becomes one map, or stays apart."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest

import gridslam
from gridslam.config import override
from gridslam.errors import ArgumentError, InputError
from gridslam.geometry.se2 import between, compose
from gridslam.io.csv import write_csv_log
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

CONFIG = override(gridslam.Configuration(), "particles=5")
CUTS = (0, 111, 200, 280)
ELSEWHERE = np.array([10.0, 0.0, 2.0])


def write(folder, name, measurements):
    """Write a log."""
    path = folder / f"{name}.csv"
    write_csv_log(path, measurements)
    return path


def moved(measurements, frame=ELSEWHERE, later_s=86_400):
    """The same measurements another day: the odometry begins at `frame`, and the clock goes on."""
    begin = measurements[0].odometry.pose
    passed = round(later_s * 1e9)
    return [
        Measurement(
            replace(odometry, pose=compose(frame, between(begin, odometry.pose)), stamp_ns=odometry.stamp_ns + passed),
            replace(scan, stamp_ns=scan.stamp_ns + passed),
        )
        for odometry, scan in measurements
    ]


class Drive(NamedTuple):
    """What a robot measures, and its true poses (N, 3)."""

    measurements: tuple[Measurement, ...]
    truth: np.ndarray


def drive(world, seed, first=0, last=None):
    """The scans from `first` to `last` of a drive through a world, each seed with noise of its own."""
    log = simulate(world, RobotConfig(), OdometryNoise(), LidarConfig(beams=120), np.random.default_rng(seed))
    return Drive(log.measurements[first:last], log.truth.poses[first:last])


@pytest.fixture(scope="module")
def building():
    return make_world("random", np.random.default_rng(5))


@pytest.fixture(scope="module")
def first(building):
    return drive(building, 1, 0, 400)


@pytest.fixture(scope="module")
def second(building):
    """Another day in the same building, from elsewhere on the way."""
    return drive(building, 2, 200, 420)


@pytest.fixture(scope="module")
def one_day(first, tmp_path_factory):
    """A session of the first day, saved."""
    folder = tmp_path_factory.mktemp("day")
    session = gridslam.Session(CONFIG)
    result = session.add(write(folder, "monday", first.measurements))
    session.save(folder / "building.gridslam")
    return folder / "building.gridslam", result


def files_of(result, folder):
    result.save(folder)
    return {name: (folder / name).read_bytes() for name in ("trajectory.tum", "map.pgm", "graph.g2o", "trajectory.csv")}


def test_a_log_that_is_cut_gives_identical_files(first, tmp_path):
    measurements = first.measurements[: CUTS[-1]]
    whole = gridslam.map_log(write(tmp_path, "whole", measurements), configuration=CONFIG)
    session = gridslam.Session(CONFIG)
    for begin, end in pairwise(CUTS):
        result = session.add(write(tmp_path, "part", measurements[begin:end]))
        assert begin == 0 or session.is_same_place, session.decision
        session.save(tmp_path / "session.gridslam")
        session = gridslam.Session.open(tmp_path / "session.gridslam", threads=2)
    assert files_of(result, tmp_path / "parts") == files_of(whole, tmp_path / "one")
    assert [len(drive.logs) for drive in session.saved.drives] == [3]


def test_a_robot_is_found_again_on_another_day(first, second, one_day, tmp_path):
    session = gridslam.Session.open(one_day[0])
    result = session.add(write(tmp_path, "tuesday", moved(second.measurements)))
    assert not session.is_same_place
    found = result.found_again
    assert found.drives == ("monday",)
    assert found.way_m < 15
    assert len(session.pieces) == 1
    expected = between(first.truth[0], second.truth)
    own = result.trajectories["tuesday"].poses
    monday = result.trajectories["monday"].poses - between(first.truth[0], first.truth)
    error_m = np.hypot(*monday[:, :2].T).mean()  # nobody knows better where the second day lies
    assert np.hypot(*(own - expected)[:, :2].T).mean() < 0.03 + error_m < 0.12
    result.save(tmp_path / "out")
    assert {"trajectory_monday.tum", "trajectory_tuesday.tum"} <= {path.name for path in (tmp_path / "out").iterdir()}
    assert len(result.trajectory) == len(first.measurements) + len(second.measurements)
    session.save(tmp_path / "both.gridslam")
    again = gridslam.Session.open(tmp_path / "both.gridslam")
    for name, path in session.trajectories.items():
        assert again.trajectories[name].poses.tobytes() == path.poses.tobytes()


def test_a_robot_in_another_building_is_not_found_and_two_pieces_are_left(one_day, tmp_path):
    elsewhere = drive(make_world("random", np.random.default_rng(11)), 3, 0, 350)
    session = gridslam.Session.open(one_day[0])
    result = session.add(write(tmp_path, "annex", moved(elsewhere.measurements)))
    assert result.found_again is None
    assert [len(piece.drives) for piece in session.pieces] == [1, 1]
    result.save(tmp_path / "out")
    assert (tmp_path / "out" / "map_2.pgm").is_file()
    assert session.map.shape != session.maps[1].shape
    session.merge()
    assert len(session.pieces) == 2


def test_frozen_key_scans_do_not_move_by_a_bit(second, one_day, tmp_path):
    path, before = one_day
    session = gridslam.Session.open(path)
    result = session.add(write(tmp_path, "tuesday", moved(second.measurements)), frozen=True)
    assert result.found_again is not None
    old = len(before.graph.poses)
    assert result.graph.poses[:old].tobytes() == before.graph.poses.tobytes()
    assert result.trajectories["monday"].poses.tobytes() == before.trajectory.poses.tobytes()
    session.save(tmp_path / "frozen.gridslam")
    again = gridslam.Session.open(tmp_path / "frozen.gridslam")
    assert again.trajectories["monday"].poses.tobytes() == before.trajectory.poses.tobytes()


def test_sessions_are_merged_in_any_order(first, second, one_day, tmp_path):
    other = gridslam.Session(CONFIG)
    other.add(write(tmp_path, "tuesday", moved(second.measurements)))
    other.save(tmp_path / "tuesday.gridslam")
    answers = []
    for order in ((one_day[0], tmp_path / "tuesday.gridslam"), (tmp_path / "tuesday.gridslam", one_day[0])):
        sessions = [gridslam.Session.open(path) for path in order]
        full = sessions[0].merge(*sessions[1:])
        answers.append((full.poses.tobytes(), full.map.log_odds.tobytes(), full.graph.poses.tobytes()))
        assert [[drive.name for drive in piece.drives] for piece in sessions[0].pieces] == [["monday", "tuesday"]]
    assert answers[0] == answers[1]
    expected = between(first.truth[0], second.truth)
    assert np.hypot(*(full.poses[len(first.measurements) :] - expected)[:, :2].T).mean() < 0.12
    result = sessions[0].add(write(tmp_path, "wednesday", moved(second.measurements[:170], later_s=200_000)))
    assert result.found_again.drives == ("monday", "tuesday")


def test_a_session_is_not_merged_with_one_that_continues_it(second, one_day, tmp_path):
    session = gridslam.Session.open(one_day[0])
    session.add(write(tmp_path, "tuesday", moved(second.measurements[:100])))
    with pytest.raises(ArgumentError, match=r"without a log in common.*monday"):
        session.merge(gridslam.Session.open(one_day[0]))


def test_bad_calls_are_refused(one_day, tmp_path):
    with pytest.raises(ArgumentError, match="place"):
        gridslam.Session(CONFIG).add(one_day[0].parent / "monday.csv", place="same place")
    with pytest.raises(ArgumentError, match="never saved"):
        gridslam.Session(CONFIG).save()
    with pytest.raises(ArgumentError, match="at least one log"):
        _ = gridslam.Session(CONFIG).map
    with pytest.raises(ArgumentError, match="same configuration"):
        gridslam.Session.open(one_day[0]).merge(gridslam.Session(override(CONFIG, "particles=6")))
    with pytest.raises(InputError, match="session"):
        gridslam.Session.open(one_day[0].parent / "monday.csv")
    with pytest.raises(ArgumentError, match="pose"):
        gridslam.Session(CONFIG).add(one_day[0].parent / "monday.csv", pose=(0, 0, 0))
