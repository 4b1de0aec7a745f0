"""A scan that shows one thing of a person's size says nothing about the robot's motion."""

import math

import numpy as np
import pytest

from gridslam.doctor.diagnose import Doctor
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.slam.grid_fastslam.grid_fastslam import GridFastSlam
from gridslam.types import LaserScan, Odometry, ScanGeometry

BEARINGS = np.linspace(-math.pi, math.pi, 360, endpoint=False)
GEOMETRY = ScanGeometry(BEARINGS)


def ranges_to_circle(place, radius_m):
    """Ranges (360,) to a round thing at a place (2,) in the laser's frame; infinite where it is not hit."""
    along = place[0] * np.cos(BEARINGS) + place[1] * np.sin(BEARINGS)
    inside = radius_m**2 - (place @ place - along**2)
    return np.where((inside > 0) & (along > 0), along - np.sqrt(np.maximum(inside, 0)), np.inf)


def ranges_to_wall(distance_m, half_width_m):
    """Ranges to a wall ahead, of some width."""
    aside = distance_m * np.tan(BEARINGS)
    hit = (np.abs(aside) < half_width_m) & (np.abs(BEARINGS) < 1.5)
    return np.where(hit, distance_m / np.cos(BEARINGS), np.inf)


def scan(ranges, stamp_s=0.0):
    return LaserScan.from_ranges(round(stamp_s * 1e9), ranges, GEOMETRY, range_max_m=8.0)


@pytest.mark.parametrize(
    ("ranges", "is_one_thing"),
    [
        (ranges_to_circle(np.array([0.8, 0.2]), 0.25), True),
        (ranges_to_circle(np.array([-3.0, 1.0]), 0.3), True),
        (ranges_to_wall(2.0, 2.0), False),
        (np.minimum(ranges_to_circle(np.array([1.0, 1.0]), 0.2), ranges_to_circle(np.array([1.0, -1.0]), 0.2)), False),
        (np.full(360, 0.4), False),
        (np.full(360, np.inf), False),
    ],
)
def test_one_thing_is_small_and_leaves_most_of_the_view_empty(ranges, is_one_thing):
    assert scan(ranges).beams(0.05, 8.0).shows_one_thing is is_one_thing


def person(x, y):
    return ranges_to_circle(np.array([x, y]), 0.22)


FAR_WALL = np.where(np.abs(BEARINGS - 2.5) < 0.3, 4.0, np.inf)


@pytest.mark.parametrize(
    ("things", "kept"),
    [
        ([person(1.0, 1.0)], 0),
        ([person(1.0, 1.0), person(1.0, -1.0)], 0),
        ([person(1.0, 1.0), person(1.0, -1.0), person(-2.0, 0.5)], 0),
        ([person(1.0, 0.0), FAR_WALL], np.isfinite(FAR_WALL).sum()),
        ([person(2.0, 0.0), person(0.0, 2.0), person(-2.0, 0.0), person(0.0, -2.0)], None),  # columns
        ([ranges_to_wall(2.0, 2.0)], None),
        ([np.full(360, 2.0), person(1.0, 0.0)], None),  # more is seen than could be hidden
        ([np.full(360, np.inf)], None),
    ],
)
def test_what_may_move_by_itself_is_left_out(things, kept):
    beams = scan(np.minimum.reduce(things)).beams(0.05, 8.0)
    left = beams.without_movable()
    assert (left is beams) if kept is None else len(left) == kept
    assert set(left.indices.tolist()) <= set(beams.indices.tolist())
    np.testing.assert_array_equal(left.ends, beams.ends[np.isin(beams.indices, left.indices)])


def follow(count=120, others=()):
    """A robot that drives a bend at 0.3 m/s, and a person ahead of it who walks from side to side."""
    pose = np.zeros(3)
    for k in range(count):
        place = np.array([1.0 + 0.25 * math.sin(0.31 * k), 0.35 * math.sin(0.23 * k)])
        ranges = np.minimum.reduce([ranges_to_circle(place, 0.25), *(other(k) for other in others)])
        yield Measurement(Odometry.at(round(2e8 * k), pose), scan(ranges, 0.2 * k))
        pose = pose + np.array([0.06 * math.cos(pose[2]), 0.06 * math.sin(pose[2]), 0.01])


@pytest.mark.parametrize("others", [(), (lambda k: person(-1.5 + 0.02 * k, 1.5),)])
def test_a_robot_that_sees_nobody_but_people_is_where_its_odometry_is(others):
    measurements = list(follow(others=others))
    recorder = TrajectoryRecorder()
    run(measurements, GridFastSlam(particles=5), rng=np.random.default_rng(0), observers=[recorder])
    true = np.array([odometry.pose for odometry, _ in measurements])
    off = between(true, between(true[0], recorder.online_trajectory().poses))
    assert np.abs(off).max() < 1e-6


def test_such_scans_are_named_and_no_witness_of_the_odometry():
    doctor = Doctor()
    for measurement in follow():
        doctor.take(measurement)
    (finding,) = (found for found in doctor.findings() if found.is_fault)
    assert (finding.code, finding.size) == ("single_object", 1.0)
    assert "what is seen may move by itself" in finding.message
