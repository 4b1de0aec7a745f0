"""Ranges in other units, of a frozen laser and at random are named; rest, corridors, round rooms and crowds are not."""

import math
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from gridslam.doctor import CheckedLog, Doctor, Severity
from gridslam.doctor.range_units import UNITS
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.sim.floor_plan import box
from gridslam.types import Odometry
from support.hand_logs import MadeLog, seen
from support.implausible_ranges import CODES, VARIANTS, found_early

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
    early = [f for f in found_early(MadeLog(measurements)) if f.code in CODES]
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


def at_rest(first, seconds, rng=None, pose=lambda at_s: (0.0, 0.0, 0.0)):
    """Scans from one place at 5 Hz, identical without `rng`."""
    for k in range(round(5 * seconds)):
        noise = 0.0 if rng is None else 0.01 * rng.standard_normal(len(first.ranges))
        yield seen(k / 5, first.ranges + noise, pose(k / 5), first.geometry)


@pytest.mark.parametrize("view_rad", [math.pi, math.tau])
def test_a_bare_corridor_without_noise_looks_the_same_everywhere(view_rad):
    corridor = World.of("corridor", box(0, 0, 400, 2.4), [(180, 1.2), (220, 1.2)])
    log = drive(corridor, noise=EXACT, range_max_m=30.0, field_of_view_rad=view_rad, **NOISELESS)
    rounded = [m._replace(scan=replace(m.scan, ranges=np.round(m.scan.ranges, 2))) for m in log]
    assert len({m.scan.ranges.tobytes() for m in rounded}) == 1
    assert named(rounded) == []
    assert named(drive(corridor, range_max_m=30.0, field_of_view_rad=view_rad)) == []


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


@pytest.mark.parametrize("ranges", [1e300, 1e-300, 5e-324, 1.7e308])
def test_absurd_ranges_and_poses_are_looked_at_without_a_warning(ranges):
    rng = np.random.default_rng(0)
    log = [
        seen(k / 5, ranges * rng.uniform(0.1, 1, 181), (10.0 ** rng.uniform(-9, 15), 0.0, 1e3 * rng.normal()))
        for k in range(100)
    ]
    assert {finding.code for finding in named(log)} <= set(CODES)
