"""Checks of exercise 11: the gmapping node."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from checks.grid_fastslam import worst_error
from gridslam import OccupancyGrid, Trajectory
from gridslam.geometry.se2 import between, compose
from gridslam.io.bags.writer import write_bag
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Rng = np.random.Generator


PARAMETERS = {
    "particles": 10,
    "linearUpdate": 1.0,
    "angularUpdate": 0.5,
    "temporalUpdate": -1.0,
    "resampleThreshold": 0.5,
    "delta": 0.05,
    "occ_thresh": 0.25,
}
"""Parameters of slam_gmapping by their names in ROS."""


class NodeDrive(NamedTuple):
    """A simulated bag: messages as (topic, message) in the order of their recording, and the truth."""

    messages: list[tuple[str, Any]]
    truth: Trajectory


def simulated_bag() -> NodeDrive:
    """Return 40 s of a drive through a suite of rooms, from a ROS 1 bag that gridslam has written; no ROS needed.

    The topics are /odom, /tf, /tf_static and /scan; the laser is mounted 20 cm ahead, turned by 0.3 rad.
    """
    rng = np.random.default_rng(3)
    lidar = LidarConfig(beams=120, field_of_view_rad=4.0, x_m=0.2, heading_rad=0.3, range_max_m=12.0)
    noise = OdometryNoise(distance_scale=1.05, turn_scale=0.9, bias_rad_per_m=0.01)
    log = simulate(make_world("rooms", rng), RobotConfig(), noise, lidar, rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rooms.bag"
        write_bag(path, log.measurements[:200])
        with AnyReader([path]) as reader:
            messages = [
                (connection.topic, reader.deserialize(raw, connection.msgtype))
                for connection, _, raw in reader.messages()
            ]
    return NodeDrive(messages, Trajectory(log.truth.stamps_ns[:200], log.truth.poses[:200]))


def planar_pose(to_pose: Callable[[Any], FloatArray]) -> None:
    """`to_pose(transform)` of a geometry_msgs/Transform -> [x m, y m, yaw rad]."""
    for yaw in (0.7, -2.9, math.pi / 2):
        turn = SimpleNamespace(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))
        message = SimpleNamespace(translation=SimpleNamespace(x=1.0, y=-2.0, z=0.4), rotation=turn)
        wrong = {
            "the quaternion has half the angle: yaw = atan2(2 w z, 1 - 2 z^2)": [1.0, -2.0, yaw / 2],
            "z of the quaternion is not the yaw": [1.0, -2.0, turn.z],
            "z of the quaternion is not the yaw ": [1.0, -2.0, 2 * turn.z],
            "the sine of the yaw is 2 w z, which alone does not know turns above 90 degrees": (
                [1.0, -2.0, math.asin(2 * turn.w * turn.z)]
            ),
            "the yaw has the opposite sign: it is counter-clockwise": [1.0, -2.0, -yaw],
            "expected rad, got degrees": [1.0, -2.0, math.degrees(yaw)],
            "x and y are exchanged": [-2.0, 1.0, yaw],
        }
        expect("pose of a transform", to_pose(message), [1.0, -2.0, yaw], 1e-9, wrong)


def scan_message(to_beams: Callable[[Any], tuple[FloatArray, NDArray[np.bool_]]]) -> None:
    """`to_beams(message)` of a sensor_msgs/LaserScan -> bearings (B,), and which beams (B,) have hit something."""
    ranges = np.array([1.0, math.inf, 0.05, 12.0, math.nan, 2.0, 0.0], np.float32)
    message = SimpleNamespace(
        angle_min=-0.6, angle_max=0.6, angle_increment=0.2, range_min=0.1, range_max=12.0, ranges=ranges
    )
    right = -0.6 + 0.2 * np.arange(7)
    bearings, hits = to_beams(message)
    expect(
        "bearings",
        bearings,
        right,
        1e-9,
        {
            "the first beam points to angle_min": 0.2 * np.arange(7),
            "beam k points to angle_min + k * angle_increment, the first to angle_min": right + 0.2,
            "beams turn counter-clockwise: add the increments": -0.6 - 0.2 * np.arange(7),
            "the step is angle_increment": np.linspace(-0.6, 0.6, 7, endpoint=False),
            "angles are in rad in the message already": np.deg2rad(right),
        },
    )
    expect(
        "beams that have hit",
        hits,
        [True, False, False, False, False, True, False],
        0,
        {
            "a range of range_max or more is no hit": [True, False, False, True, False, True, False],
            "a range of range_max or more is no hit ": [True, True, False, True, False, True, False],
            "a range below range_min is no hit": [True, False, True, False, False, True, True],
            "a range below range_min is no hit ": [True, False, True, False, False, True, False],
            "an infinite range is no hit": [True, True, False, False, False, True, False],
            "NaN is no hit: comparisons with it are false": [True, False, False, False, True, True, False],
        },
    )


def update_rule(is_due: Callable[[FloatArray, float, Mapping[str, float]], bool]) -> None:
    """`is_due(moved, elapsed_s, parameters)`: linearUpdate, angularUpdate or temporalUpdate is reached."""
    parameters = PARAMETERS | {"linearUpdate": 0.5, "angularUpdate": 0.3, "temporalUpdate": -1.0}
    timed = parameters | {"temporalUpdate": 4.0}
    cases = (
        ([0.0, 0.0, 0.0], 99.0, parameters, False, "a negative temporalUpdate disables updates by time"),
        ([0.4, 0.0, 0.1], 1.0, parameters, False, "neither threshold is reached"),
        ([0.0, 0.0, 0.4], 1.0, parameters, True, "a turn alone suffices: either threshold, not both"),
        ([0.6, 0.0, 0.0], 1.0, parameters, True, "a translation alone suffices: either threshold, not both"),
        ([0.5, 0.0, 0.0], 1.0, parameters, True, "0.5 m is linearUpdate: an update is due from it on"),
        ([0.0, 0.0, -0.4], 1.0, parameters, True, "turns to the right count, too: take the absolute value"),
        ([-0.3, 0.45, 0.0], 1.0, parameters, True, "the distance is the length of (x, y), not x alone"),
        ([0.35, 0.35, 0.0], 1.0, parameters, False, "the distance is the length of (x, y), not the sum"),
        ([-0.6, 0.0, 0.0], 1.0, parameters, True, "a robot that drives backward moves, too"),
        ([0.0, 0.0, 0.0], 5.0, timed, True, "temporalUpdate is reached: a robot at rest is updated, too"),
        ([0.0, 0.0, 0.0], 3.0, timed, False, "temporalUpdate is not reached"),
    )
    for moved, elapsed_s, given, expected, sentence in cases:
        found = bool(is_due(np.array(moved), elapsed_s, given))
        require(found == expected, f"update after {moved} and {elapsed_s:g} s: expected {expected}; {sentence}")


def map_to_odometry(map_from_odom: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
    """`map_from_odom(map_from_base, odom_from_base)` -> the transform that the node publishes."""
    map_from_base, odom_from_base = np.array([3.0, 1.0, 2.0]), np.array([2.5, -0.5, -1.7])
    nothing = np.zeros(3)
    right = compose(map_from_base, between(odom_from_base, nothing))
    wrong = {
        "poses are not subtracted component by component: compose with the inverse": (
            _wrapped_pose(map_from_base - odom_from_base)
        ),
        "poses are not subtracted component by component: compose with the inverse ": map_from_base - odom_from_base,
        "the inverse belongs to the odometry, and stands on the right": between(odom_from_base, map_from_base),
        "this is odom_from_map, the inverse": between(right, nothing),
        "between(a, b) is a^-1 b: here b is inverted": between(map_from_base, odom_from_base),
        "the odometry is inverted": compose(map_from_base, odom_from_base),
        "publish map -> odom, not map -> base": map_from_base,
    }
    found = map_from_odom(map_from_base, odom_from_base)
    expect("map -> odom", found, right, 1e-9, wrong)


def _wrapped_pose(pose: FloatArray) -> FloatArray:
    return np.array([*pose[:2], math.remainder(pose[2], math.tau)])


def map_message(to_data: Callable[[OccupancyGrid, float], NDArray[np.int8]]) -> None:
    """`to_data(grid, occ_thresh)` -> data (H * W,) of a nav_msgs/OccupancyGrid: -1, 0 or 100, row by row."""
    known = np.array([[True, True, False], [True, True, True]])
    log_odds = np.array([[-3.0, 2.0, 0.0], [-0.9, -1.3, 3.0]], np.float32)
    grid = OccupancyGrid(log_odds, known, 0.05, (0.0, 0.0))
    right = np.array([0, 100, -1, 100, 0, 100])

    def arranged(table: Sequence[Sequence[int]]) -> FloatArray:
        return np.array(table, np.float64).ravel()

    wrong = {
        "unknown cells are -1": arranged([[0, 100, 100], [100, 0, 100]]),
        "unknown cells are -1 ": arranged([[0, 100, 0], [100, 0, 100]]),
        "unknown cells are -1, not 255": arranged([[0, 100, 255], [100, 0, 100]]),
        "cells are row by row, the row of the least y first": arranged([[100, 0, 100], [0, 100, -1]]),
        "cells are row by row, not column by column": np.array([0, 100, 100, 0, -1, 100]),
        "a cell is occupied above occ_thresh, 0.25, not above 0.5": arranged([[0, 100, -1], [0, 0, 100]]),
        "occupied is 100 and free is 0: they are exchanged": arranged([[100, 0, -1], [0, 100, 0]]),
        "occupied is 100, not 1": arranged([[0, 1, -1], [1, 0, 1]]),
        "three values: above occ_thresh 100, else 0": np.where(known, np.rint(100 * grid.probability), -1).ravel(),
        "compare the probability, not the log-odds": arranged([[0, 100, -1], [0, 0, 100]]),
    }
    data = np.asarray(to_data(grid, 0.25))
    require(data.ndim == 1, f"data is a list of cells: expected shape (6,), got {data.shape}")
    expect("data of the map", data, right, 0, wrong)


NodeRun = Callable[[Sequence[tuple[str, Any]], Mapping[str, float], Rng], tuple[IntArray, FloatArray, OccupancyGrid]]


def node_maps_the_rooms(run: NodeRun) -> None:
    """`run(messages, parameters, rng)` -> stamps (T,) in ns, poses (T, 3) map frame, and the map of 40 s.

    With ten particles the poses of three seeds were within 0.16 m of the truth, aligned.
    """
    drive = simulated_bag()
    stamps, poses, grid = run(drive.messages, PARAMETERS, np.random.default_rng(0))
    require(len(stamps) == len(poses), f"expected a pose for each stamp, got {len(stamps)} and {len(poses)}")
    require(len(poses) > 15, f"only {len(poses)} scans were processed: see linearUpdate and angularUpdate")
    require(len(poses) < 120, f"{len(poses)} of 200 scans were processed: see linearUpdate and angularUpdate")
    index = np.searchsorted(drive.truth.stamps_ns, stamps)
    truth = between(drive.truth.poses[0], drive.truth.poses[index])
    worst = worst_error(np.asarray(poses), truth)
    require(worst < 0.25, f"a pose is {worst:.2f} m from the truth: is the mounting of the laser used?")
    square_m = float(grid.known.sum()) * grid.resolution_m**2
    require(square_m > 40, f"the map has {square_m:.0f} m^2 of known cells")
