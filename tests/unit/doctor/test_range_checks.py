"""Ranges in other units, of a frozen laser and at random are named; rest, corridors, round rooms and crowds are not."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from gridslam.doctor import CheckedLog, Doctor, Severity, quick_check
from gridslam.doctor.range_units import UNITS, measured_beams
from gridslam.doctor.scan_prediction import PolarScan, disagreements, move_laser
from gridslam.geometry.se2 import between
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, PeopleConfig, RobotConfig, World, make_world, simulate
from gridslam.sim.floor_plan import box, pillar
from gridslam.types import LaserScan, Odometry, ScanGeometry
from support.hand_logs import MadeLog, seen
from support.implausible_ranges import CODES, VARIANTS

pytestmark = pytest.mark.filterwarnings("ignore:ranges have a median")  # as made here, and found by the doctor

EXACT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
FAIR = OdometryNoise()
NOT_KNOWN = ("in centimetres, without odometry", "in feet, every tenth scan")
"""Fractions without odometry, and 30 scans that are 1.2 m and up to 2 rad apart."""
NOISELESS = {"sigma_range_m": 0.0, "no_return_probability": 0.0}


def drive(world="rooms", scans=300, noise=FAIR, people=None, **lidar):
    rng = np.random.default_rng(2)
    world = make_world(world, rng) if isinstance(world, str) else world
    log = simulate(world, RobotConfig(), noise, LidarConfig(**lidar), rng, people=people)
    return list(log.measurements[:scans])


@pytest.fixture(scope="module")
def rooms():
    return drive()


def named(measurements):
    """The findings on ranges, of all scans and of those that `map` looks at; they must be the same."""
    doctor = Doctor(matching=False)
    for measurement in measurements:
        doctor.take(measurement)
    found = [f for f in doctor.findings() if f.code in CODES]
    early = [f for f in quick_check(MadeLog(measurements)) if f.code in CODES]
    assert [f.code for f in early] == [f.code for f in found]
    return found


@pytest.mark.parametrize("variant", [name for name in VARIANTS if name not in NOT_KNOWN])
def test_each_fault_is_named(rooms, variant):
    due, change = VARIANTS[variant]
    found = named(list(change(rooms)))
    assert [f.code for f in found] == ([due] if due else [])
    assert all(f.severity is Severity.ERROR and f.remedy and f.sensor == "laser" for f in found)
    if due == "range_units" and "without" not in variant:
        (unit,) = (unit for unit in UNITS if unit in variant)
        assert unit in found[0].message
        assert found[0].size == pytest.approx(UNITS[unit])


def test_whole_numbers_are_no_metres_whatever_the_odometry(rooms):
    def rounded(factor):
        return [Measurement(None, replace(m.scan, ranges=np.round(factor * m.scan.ranges))) for m in rooms]

    (found,) = named(rounded(100.0))
    assert "whole numbers" in found.message
    assert found.size is None
    assert named(rounded(1.0)) == [], "some whole numbers may be chance"


def at_rest(first, seconds, rng=None, pose=lambda at_s: (0.0, 0.0, 0.0)):
    """Scans from one place at 5 Hz, identical without `rng`."""
    for k in range(round(5 * seconds)):
        noise = 0.0 if rng is None else 0.01 * rng.standard_normal(len(first.ranges))
        yield seen(k / 5, first.ranges + noise, pose(k / 5), first.geometry)


def test_a_robot_at_rest_has_no_frozen_laser(rooms):
    first = rooms[0].scan
    assert named(list(at_rest(first, 90))) == []
    assert named(list(at_rest(first, 90, np.random.default_rng(0)))) == []
    assert named(list(at_rest(first, 90, pose=lambda at_s: (0.001 * (at_s % 2), 0.0, 0.003 * at_s)))) == []
    (found,) = named(list(at_rest(first, 90, pose=lambda at_s: (0.0, 0.0, 0.1 * at_s))))
    assert found.code == "laser_frozen"


def test_scans_repeated_by_a_driver_are_no_frozen_laser(rooms):
    repeated = [
        Measurement(m.odometry, replace(rooms[k // 2 * 2].scan, stamp_ns=m.scan.stamp_ns)) for k, m in enumerate(rooms)
    ]
    assert named(repeated) == []


def test_a_laser_that_freezes_for_a_while_is_a_warning(rooms):
    def freeze(first, count):
        still = rooms[first].scan
        return [
            Measurement(m.odometry, replace(still, stamp_ns=m.scan.stamp_ns)) if first <= k < first + count else m
            for k, m in enumerate(rooms)
        ]

    doctor = Doctor(matching=False)
    for measurement in freeze(100, 25):
        doctor.take(measurement)
    (found,) = doctor.range_findings()
    assert (found.code, found.severity) == ("laser_frozen", Severity.WARNING)
    assert 0.02 < found.size < 0.1


@pytest.mark.parametrize("view_rad", [math.pi, math.tau])
def test_a_bare_corridor_without_noise_looks_the_same_everywhere(view_rad):
    corridor = World.of("corridor", box(0, 0, 400, 2.4), [(180, 1.2), (220, 1.2)])
    log = drive(corridor, noise=EXACT, range_max_m=30.0, field_of_view_rad=view_rad, **NOISELESS)
    rounded = [m._replace(scan=replace(m.scan, ranges=np.round(m.scan.ranges, 2))) for m in log]
    assert len({m.scan.ranges.tobytes() for m in rounded}) == 1
    assert named(rounded) == []
    assert named(drive(corridor, range_max_m=30.0, field_of_view_rad=view_rad)) == []


def test_a_round_room_has_no_random_ranges():
    room = World.of("round", pillar(0, 0, 6, 256), [(0, 0), (0.5, 0), (0, 0.5), (0, 0)])
    assert named(drive(room, scans=60, sigma_range_m=0.03, beams=360, field_of_view_rad=math.tau)) == []


def test_a_crowd_is_no_fault():
    crowd = PeopleConfig(count=30, distance_m=0.6)
    assert named(drive("hall", people=crowd)) == []


def test_wheels_that_turn_on_the_spot_are_a_laser_that_sees_no_motion(rooms):
    rng = np.random.default_rng(0)
    spinning = list(at_rest(rooms[0].scan, 60, rng, lambda at_s: (0.3 * at_s, 0.0, 0.0)))
    (found,) = named(spinning)
    assert found.code == "laser_frozen"
    assert "wheels" in found.message


def test_units_are_found_after_the_first_minute_where_the_robot_rests_before(rooms):
    begin = list(at_rest(rooms[0].scan, 90, np.random.default_rng(0)))
    x, y, theta = rooms[0].odometry.pose.tolist()
    c, s = math.cos(theta), math.sin(theta)
    late = []
    for odometry, scan in rooms:
        stamp_ns = scan.stamp_ns + 90 * 10**9
        dx, dy = odometry.pose[0] - x, odometry.pose[1] - y
        pose = (c * dx + s * dy, c * dy - s * dx, odometry.pose[2] - theta)
        late.append(Measurement(Odometry.at(stamp_ns, pose), replace(scan, stamp_ns=stamp_ns)))
    log = list(VARIANTS["in feet"][1]([*begin, *late]))
    given, reported = [], []
    checked = CheckedLog(MadeLog(log), lambda found: reported.append((len(given), [f.code for f in found])))
    for measurement in islice(checked, 700):  # a first reading that breaks off, as for a repair
        given.append(measurement)
    given.clear()
    given.extend(checked)
    assert reported == [(pytest.approx(600, abs=150), ["range_units"])], "once"
    assert "range_units (laser)" in checked.statistics.faults
    assert named(begin + late) == []


def test_the_motion_of_an_implausible_laser_is_not_compared(rooms):
    doctor = Doctor()
    for measurement in VARIANTS["in feet"][1](rooms[:150]):
        doctor.take(measurement)
    assert [f.code for f in doctor.findings() if f.is_fault] == ["range_units"]


def test_readings_that_vary_beyond_the_limit_are_measured_and_codes_are_not():
    geometry = ScanGeometry(np.linspace(-1, 1, 100))
    ranges = np.linspace(200, 900, 100)
    beyond = LaserScan.from_ranges(0, ranges, geometry, range_max_m=12.0)
    assert measured_beams(beyond).all()
    codes = LaserScan.from_ranges(0, 81.83 + 0.01 * (np.arange(100) % 7), geometry, range_max_m=80.0)
    assert not measured_beams(codes).any()


@pytest.mark.parametrize("unit", [1.0, 1000.0])
def test_a_scan_is_predicted_at_the_true_scale_in_every_unit(unit):
    world = World.of("room", box(0, 0, 6, 4), [(2, 2), (2.5, 2), (2.7, 2.3)])
    log = drive(world, scans=20, noise=EXACT, beams=720, field_of_view_rad=math.tau, x_m=0.2, y_m=-0.1, **NOISELESS)
    scans = [replace(m.scan, ranges=unit * m.scan.ranges) for m in (log[0], log[-1])]
    first, second = (PolarScan(scan, measured_beams(scan)) for scan in scans)
    motion = move_laser(first, second, between(log[0].odometry.pose, log[-1].odometry.pose))
    right, twice, none = disagreements(first, second, motion, unit * np.array([1.0, 2.0, 0.0]))
    assert right < 1e-3
    assert min(twice, none) > 0.02


@pytest.mark.parametrize("ranges", [1e300, 1e-300, 5e-324, 1.7e308])
def test_absurd_ranges_and_poses_are_looked_at_without_a_warning(ranges):
    rng = np.random.default_rng(0)
    log = [
        seen(k / 5, ranges * rng.uniform(0.1, 1, 181), (10.0 ** rng.uniform(-9, 15), 0.0, 1e3 * rng.normal()))
        for k in range(100)
    ]
    assert {finding.code for finding in named(log)} <= set(CODES)
