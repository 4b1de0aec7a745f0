"""Each fault does to a log what its size says, and leaves the rest of it alone."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.geometry import se2
from gridslam.io.measurement import Measurement
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import BeamStatus, LaserScan, ScanGeometry
from support.faults import FAULTS, clock_skew, standing_still, tilted_laser, with_fault

EXACT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def log() -> SimulatedLog:
    """Exact odometry, a laser askew and off-centre that sees 10 m: 3 scans a second."""
    rng = np.random.default_rng(0)
    lidar = LidarConfig(beams=90, range_max_m=10.0, x_m=0.2, heading_rad=0.5, rate_hz=3.0)
    return simulate(make_world("rooms", rng), RobotConfig(), EXACT, lidar, rng)


def faulty(log: SimulatedLog, name: str, size: float | None = None, seed: int = 0) -> list[Measurement]:
    return list(with_fault(log.measurements, name, np.random.default_rng(seed), size))


def scans(measurements) -> list[LaserScan]:
    return [scan for _, scan in measurements]


def stamps(measurements) -> np.ndarray:
    return np.array([scan.stamp_ns for _, scan in measurements])


def odometry(measurements) -> np.ndarray:
    return np.array([reading.pose for reading, _ in measurements])


def twists(measurements) -> np.ndarray:
    poses = odometry(measurements)
    return se2.log(se2.between(poses[:-1], poses[1:]))


def test_all_faults_are_streams_that_one_seed_repeats(log):
    for name in FAULTS:
        first, again = (faulty(log, name, seed=3) for _ in range(2))
        assert [m.scan.ranges.tobytes() for m in first] == [m.scan.ranges.tobytes() for m in again]
        assert odometry(first).tobytes() == odometry(again).tobytes()
        assert (stamps(first) == stamps(again)).all()
        endless = iter(with_fault(iter(log.measurements), name, np.random.default_rng(0)))
        assert isinstance(next(endless), Measurement)


def test_a_reflected_laser_sees_the_world_mirrored_about_its_axis(log):
    for scan, true in zip(scans(faulty(log, "reflected_laser")), scans(log.measurements), strict=True):
        assert (scan.ranges == true.ranges[::-1]).all()
        assert (scan.status == true.status[::-1]).all()
        assert scan.geometry is true.geometry


def test_with_the_yaw_added_to_the_told_mounting_it_is_the_true_one(log):
    told = scans(faulty(log, "yaw_offset", 2.0))
    assert len({id(scan.geometry) for scan in told}) == 1
    true = log.measurements[0].scan.geometry
    fixed = ScanGeometry(true.bearings + 2.0, told[0].geometry.base_from_laser)
    np.testing.assert_allclose(fixed.directions, true.directions, atol=1e-12)
    np.testing.assert_array_equal(fixed.origin, true.origin)


@pytest.mark.parametrize("skew", [0.03, -0.03, 0.5, -0.5])
def test_skewed_scans_come_with_odometry_of_another_time(log, skew):
    """Between the poses at two readings the twist is taken as constant."""
    late = list(clock_skew(log.measurements, skew))
    shift, period = round(skew * 1e9), stamps(log.measurements)[1]
    known = {scan.stamp_ns: k for k, (_, scan) in enumerate(log.measurements)}
    lost = math.ceil(abs(skew) / 0.334)
    assert len(late) == len(log) - lost
    rates = twists(log.measurements) / (period * 1e-9)
    for reading, scan in late:
        k = known[scan.stamp_ns - shift]
        assert scan.ranges is log.measurements[k].scan.ranges
        assert reading.stamp_ns == scan.stamp_ns
        whole, part = divmod(scan.stamp_ns / 1e9, 1 / 3)
        before = int(whole)
        expected = se2.compose(log.truth.poses[before], se2.exp(part * rates[min(before, len(rates) - 1)]))
        assert reading.pose == pytest.approx(expected, abs=1e-6)


def test_without_skew_nothing_changes(log):
    same = list(clock_skew(log.measurements, 0.0))
    assert len(same) == len(log)
    np.testing.assert_allclose(odometry(same), odometry(log.measurements), atol=1e-12)


@pytest.mark.parametrize(
    ("name", "factors"), [("odometry_scale", [1.1, 1.1, 1.0]), ("odometry_rotation_bias", [1.0, 1.0, 1.1])]
)
def test_increments_are_scaled(log, name, factors):
    np.testing.assert_allclose(twists(faulty(log, name, 0.1)), twists(log.measurements) * factors, atol=1e-12)


def test_unequal_wheels_turn_with_each_metre(log):
    true, told = twists(log.measurements), twists(faulty(log, "odometry_drift", 0.1))
    np.testing.assert_allclose(told[:, :2], true[:, :2], atol=1e-12)
    np.testing.assert_allclose(told[:, 2] - true[:, 2], 0.1 * np.hypot(true[:, 0], true[:, 1]), atol=1e-12)


def test_each_slip_tells_as_much_more_way(log):
    extra = (twists(faulty(log, "wheel_slip", 0.3)) - twists(log.measurements))[:, 0]
    spinning = extra > 1e-9
    episodes = np.flatnonzero(np.diff(np.concatenate([[False], spinning]).astype(int)) == 1)
    assert len(episodes) >= 3
    assert extra.sum() == pytest.approx(0.3 * round(extra.sum() / 0.3), abs=1e-9)
    assert round(extra.sum() / 0.3) >= len(episodes)
    assert spinning.sum() <= 4 * round(extra.sum() / 0.3)  # an episode of 1 s touches at most 4 periods


def test_beam_counts_vary_over_all_of_their_range(log):
    seen = scans(faulty(log, "beam_count_varies", 6))
    assert {len(scan) for scan in seen} == set(range(84, 91))
    assert len({id(scan.geometry) for scan in seen}) == 7  # of one count they share one
    for scan, true in zip(seen, scans(log.measurements), strict=True):
        assert (scan.ranges == true.ranges[: len(scan)]).all()
        assert (scan.geometry.bearings == true.geometry.bearings[: len(scan)]).all()


def test_a_share_of_the_beams_is_nan(log):
    seen = scans(faulty(log, "invalid_beams", 0.2))
    wrong = np.array([np.isnan(scan.ranges) for scan in seen])
    # Five standard deviations of a binomial share.
    assert wrong.mean() == pytest.approx(0.2, abs=5 * math.sqrt(0.16 / wrong.size))
    assert (np.array([scan.status for scan in seen])[wrong] == BeamStatus.INVALID).all()


def test_a_greatest_range_that_lies(log):
    true = np.array([scan.status for scan in scans(log.measurements)])
    assert (true == BeamStatus.NO_RETURN).any()
    above = np.array([scan.status for scan in scans(faulty(log, "range_limits", 2.0))])
    assert (above == BeamStatus.HIT).all()
    below = scans(faulty(log, "range_limits", 0.5))
    assert {scan.range_max_m for scan in below} == {5.0}
    assert all((scan.status == BeamStatus.NO_RETURN).sum() == (scan.ranges >= 5.0).sum() for scan in below)


def test_gaps_of_that_length_once_in_each_part_of_the_log(log):
    seconds = stamps(faulty(log, "gaps", 2.0)) * 1e-9
    wide = np.diff(seconds)[np.diff(seconds) > 0.4]
    parts = stamps(log.measurements)[-1] * 1e-9 / 30
    assert math.floor(parts) <= len(wide) <= math.ceil(parts)
    assert wide == pytest.approx(np.full(len(wide), 2.0), abs=0.334)


def test_stamps_go_backward_or_repeat(log):
    count = len(log) - 1
    for name, size, step_s, share in (("backward_stamps", 0.05, -0.05, 0.02), ("duplicate_stamps", 0.1, 0.0, 0.1)):
        steps = np.diff(stamps(faulty(log, name, size)))
        wrong = steps <= 0
        assert (steps[wrong] == round(step_s * 1e9)).all()
        assert wrong.mean() == pytest.approx(share, abs=5 * math.sqrt(share / count))  # a binomial share
        assert wrong.any()


def test_standing_still_before_the_drive(log):
    seen = list(standing_still(log.measurements, 60.0, np.random.default_rng(0)))
    count = len(seen) - len(log)
    assert count == 180
    assert (odometry(seen)[: count + 1] == log.odometry.poses[0]).all()
    assert np.allclose(np.diff(stamps(seen)), 1e9 / 3, atol=2)
    first = np.array([scan.ranges for scan in scans(seen)[:count]])
    hits = log.measurements[0].scan.status == BeamStatus.HIT
    # Five standard deviations of a standard deviation.
    assert first[:, hits].std(axis=0).mean() == pytest.approx(0.01, rel=5 / math.sqrt(2 * count * hits.sum()))
    assert (first[:, ~hits] == log.measurements[0].scan.ranges[~hits]).all()


def room_scan(bearings: np.ndarray) -> LaserScan:
    """From the middle of a room 4 m x 4 m."""
    return LaserScan.from_ranges(
        0, 2.0 / np.maximum(np.abs(np.cos(bearings)), np.abs(np.sin(bearings))), ScanGeometry(bearings), range_max_m=9.0
    )


def test_a_tilted_laser_sees_the_floor_before_it_and_the_ceiling_behind():
    scan = room_scan(np.linspace(-math.pi, math.pi, 721))
    (_, tilted) = next(tilted_laser([Measurement(None, scan)], 0.2))
    # Ahead the floor, 0.3 m down; aside the wall; behind the wall again, reached 0.4 m up, below the ceiling.
    assert tilted.ranges[[360, 540, 0]] == pytest.approx([0.3 / math.sin(0.2), 2.0, 2.0 / math.cos(0.2)], rel=1e-6)
    assert tilted.geometry is scan.geometry
    (_, steep) = next(tilted_laser([Measurement(None, scan)], 1.4))
    assert steep.ranges[0] == pytest.approx(2.2 / math.sin(1.4), rel=1e-6)


def test_a_tilting_laser_tells_its_mounting_and_its_walls_stay_where_they_are():
    """Over the ground the ends lie on the walls, or inside the room where the floor was seen."""
    scan = room_scan(np.linspace(-math.pi, math.pi, 721))
    many = [Measurement(None, LaserScan.from_ranges(k * 10**8, scan.ranges, scan.geometry)) for k in range(40)]
    tilts = []
    for _, seen in with_fault(many, "tilting_laser", np.random.default_rng(0), 0.3):
        ends = np.abs(seen.beams(0.0, 9.0).ends).max(axis=1)
        rotation = seen.geometry.base_from_laser[:3, :3]
        tilts.append(math.atan2(rotation[0, 2], rotation[0, 0]))
        assert ends.max() == pytest.approx(2.0, abs=2e-3)  # at the corners the interpolated wall is rounded
        assert (np.abs(ends - 2.0) < 2e-2).mean() > 0.5
    assert (min(tilts), max(tilts)) == pytest.approx((-0.3, 0.3))
