"""The tracker: smooth, nearly exact odometry out of any odometry."""

from dataclasses import replace

import numpy as np
import pytest

from gridslam.geometry.se2 import between, compose
from gridslam.mapping import OccupancyGridMapping
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, World, make_world, simulate
from gridslam.sim.floor_plan import furniture, join, room
from gridslam.slam import Tracker
from gridslam.types import BeamStatus, Odometry

PERFECT = OdometryNoise(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
BIASED = OdometryNoise(1.1, 0.85, 0.0, 0.0, 0.0, 0.0, 0.0)

BAND = np.array([0.2, 0.1])
"""Metres and radians over 12 m: twice what the tracker strays by, 0.115 m and 0.049 rad, nearly all of it heading that
a map of a single scan leaves open in the first two metres."""


def driven(noise):
    """A furnished room of 8 m x 6 m, once around: 12 m in 38 s."""
    tables = [furniture(4, 3, 1.2, 0.8, 0.4), furniture(1, 5.4, 1.5, 0.6), furniture(7.3, 1, 0.7, 1.4)]
    route = [(1.5, 1.2), (6.2, 1.3), (6.4, 4.6), (1.6, 4.3), (1.5, 1.6)]
    world = World.of("room", join(room(0, 0, 8, 6), *tables), route)
    return simulate(world, RobotConfig(), noise, LidarConfig(beams=120), np.random.default_rng(0))


def track(tracker, log, measurements=None):
    """Poses told and predicted for each scan, in the frame of the first, and the tracker's state after the last."""
    (odometry, scan), *rest = measurements or log.measurements
    state = tracker.init(odometry, scan.stamp_ns, scan.beams(0.05, 30.0), OccupancyGridMapping())
    told, predicted = [state.pose], [state.pose]
    for odometry, scan in rest:
        tracked = tracker.step(state, odometry, scan.stamp_ns, scan.beams(0.05, 30.0))
        told.append(tracked.pose)
        predicted.append(tracked.predicted)
        assert state.pose is tracked.pose
    return np.array(told), np.array(predicted), state


def missed(poses, log):
    """Metres and radians (N, 2) between poses and the truth, both in the frame of the first pose."""
    off = between(between(log.truth.poses[0], log.truth.poses), poses)
    return np.column_stack([np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])])


@pytest.fixture(scope="module")
def perfect():
    return driven(PERFECT)


@pytest.fixture(scope="module")
def biased():
    return driven(BIASED)


def test_surfaces_are_of_scans_that_are_apart(perfect):
    _, _, state = track(Tracker(), perfect)
    kept = np.array([scan.pose for scan in state.recent.scans])
    x, y, turn = between(kept[:-1], kept[1:]).T
    assert len(kept) == 4
    assert ((np.hypot(x, y) >= 0.4) | (np.abs(turn) >= 0.2)).all()


def test_biased_odometry_is_corrected_in_a_room(biased):
    """Odometry alone strays by more than four times as much."""
    alone = missed(between(biased.odometry.poses[0], biased.odometry.poses), biased).max(axis=0)
    assert (alone > 4 * BAND).all()
    assert (missed(track(Tracker(), biased)[0], biased).max(axis=0) < BAND).all()


def jumping(log, at, offset):
    """The log with its odometry carried by `offset` from scan `at` on."""
    moved = compose(offset, log.odometry.poses)
    poses = np.concatenate([log.odometry.poses[:at], moved[at:]])
    pairs = zip(poses, log.measurements, strict=True)
    return [(type(odometry).at(odometry.stamp_ns, pose), scan) for pose, (odometry, scan) in pairs]


@pytest.mark.parametrize("offset", [(5.0, 0.0, 0.0), (0.0, -40.0, 2.0), (0.0, 0.0, 3.1), (-2.0, 1.0, -2.0)])
@pytest.mark.parametrize("at", [1, 50, 51, 120])
def test_a_jump_of_the_odometry_leaves_no_trace(perfect, at, offset):
    told, _, _ = track(Tracker(), perfect, jumping(perfect, at, offset))
    assert (missed(told, perfect).max(axis=0) < BAND).all()


def without(log, lost=slice(None)):
    """The log with the odometry of the scans `lost` thrown away."""
    measurements = list(log.measurements)
    measurements[lost] = [(None, scan) for _, scan in measurements[lost]]
    return measurements


def test_without_odometry_the_prediction_is_the_velocity_of_the_scans_before(perfect):
    """Constant but for the robot's acceleration, 0.6 m/s^2: 2.4 cm in 0.2 s, beside the match's own error."""
    told, predicted, _ = track(Tracker(), perfect, without(perfect))
    off = between(told, predicted)
    assert np.percentile(np.hypot(off[:, 0], off[:, 1]), 95) < 0.05
    _, _, state = track(Tracker(), perfect, without(perfect)[:100])
    velocity = between(perfect.truth.poses[98], perfect.truth.poses[99]) / 0.2
    np.testing.assert_allclose(state.twist, velocity, atol=0.1)


def restamped(measurements, shift_ns):
    """The same scans with other stamps, by so much (N,)."""
    pairs = zip(measurements, shift_ns.tolist(), strict=True)
    return [(odometry, replace(scan, stamp_ns=scan.stamp_ns + shift)) for (odometry, scan), shift in pairs]


@pytest.mark.parametrize("kind", ["bursts", "jitter", "backward", "descending", "seconds", "same", "leap", "wrap"])
def test_without_odometry_stamps_need_not_be_true(perfect, kind):
    """Scans in bursts; clocks that jitter, go back, run backward, have whole seconds, stand, are set, or overflow."""
    n = np.arange(len(perfect))
    stamps = np.round(n * 2e8).astype(np.int64)
    noise = np.random.default_rng(4).uniform(-1, 1, len(n))
    shift = {
        "bursts": (2 - n % 3) * 199_000_000,
        "jitter": (90e6 * noise).astype(np.int64),
        "backward": (600e6 * noise).astype(np.int64),
        "descending": -2 * stamps,
        "seconds": -(stamps % 10**9),
        "same": -stamps,
        "wrap": np.where(n < 60, 2**62, -(2**62)),
        "leap": np.where(n < 60, 0, 3600 * 10**9),
    }[kind]
    told, _, _ = track(Tracker(), perfect, restamped(without(perfect), shift))
    assert (missed(told, perfect).max(axis=0) < BAND).all()


@pytest.mark.parametrize("lost", [slice(0, 1), slice(0, 60), slice(50, 51), slice(50, 120), slice(1, None, 2)])
def test_odometry_may_be_missing_and_come_back(biased, lost):
    told, _, _ = track(Tracker(), biased, without(biased, lost))
    assert (missed(told, biased).max(axis=0) < BAND).all()


@pytest.mark.parametrize("scans", [1, 4, 30])
def test_odometry_that_comes_late_is_overruled(perfect, scans):
    """It says nothing of the motion for a while, and then all at once, as where messages are held up."""
    poses = perfect.odometry.poses.copy()
    for begin in range(40, len(poses) - scans, 3 * scans + 10):
        poses[begin : begin + scans] = poses[begin]
    pairs = zip(poses, perfect.measurements, strict=True)
    log = [(type(odometry).at(odometry.stamp_ns, pose), scan) for pose, (odometry, scan) in pairs]
    told, _, _ = track(Tracker(), perfect, log)
    assert (missed(told, perfect).max(axis=0) < BAND).all()


@pytest.mark.parametrize("times", [(0, 0, 0), (1, 1, -1)], ids=["frozen", "reflected"])
def test_odometry_that_helps_nothing_is_noticed_and_done_without(perfect, times):
    told = [np.zeros(3)]
    for increment in between(perfect.odometry.poses[:-1], perfect.odometry.poses[1:]) * times:
        told.append(compose(told[-1], increment))
    log = [(type(o).at(o.stamp_ns, pose), scan) for pose, (o, scan) in zip(told, perfect.measurements, strict=True)]
    poses, _, state = track(Tracker(), perfect, log)
    assert not state.odometry_errors.trusted
    assert (missed(poses, perfect).max(axis=0) < BAND).all()


def mixed(log, at, ahead, share):
    """Scan `at` with a share of its beams from where the robot is `ahead` scans later, and how far that is, m."""
    later = np.random.default_rng(1).random(len(log.measurements[at][1].ranges)) < share
    scan, other = log.measurements[at][1], log.measurements[at + ahead][1]
    way = between(log.truth.poses[at], log.truth.poses[at + ahead])
    return replace(scan, ranges=np.where(later, other.ranges, scan.ranges)), float(np.hypot(*way[:2]))


@pytest.mark.parametrize(("share", "is_believed"), [(0.7, False), (0.9, True)])
def test_the_farther_a_match_is_from_steady_odometry_the_more_beams_must_agree(perfect, share, is_believed):
    """Equal doors of a corridor look alike one farther on: a few more beams are no slip of a quarter of a metre."""
    at = 116  # the odometry is calibrated by then
    _, _, state = track(Tracker(), perfect, perfect.measurements[:at])
    scan, way = mixed(perfect, at, 3, share)
    odometry, _ = perfect.measurements[at]
    tracked = Tracker().step(state, odometry, scan.stamp_ns, scan.beams(0.05, 30.0))
    moved = np.hypot(*(np.array(tracked.pose) - tracked.predicted)[:2])
    assert abs(moved - (way if is_believed else 0.0)) < 0.03


@pytest.mark.parametrize("seed", [201, 204])
def test_a_narrow_laser_that_turns_on_the_spot_does_not_slide_along_a_wall(seed):
    """Of 60 degrees, noise 3 cm: a third of what it sees is new, and none of the rest contradicts the odometry.

    Slid by 0.3 to 0.5 m along the wall, what is new would end on its mapped part.
    """
    lidar = LidarConfig(beams=60, field_of_view_rad=np.radians(60), sigma_range_m=0.03)
    world = make_world("random", np.random.default_rng(seed))
    log = simulate(world, RobotConfig(), OdometryNoise(), lidar, np.random.default_rng(seed))
    told, _, _ = track(Tracker(), log, log.measurements[:120])
    truth = log.truth.poses[:120]
    steps = between(between(truth[:-1], truth[1:]), between(told[:-1], told[1:]))
    assert np.hypot(*steps[:, :2].T).max() < 0.15


def test_the_mean_step_follows_steps_of_any_length_and_no_gap(perfect):
    """Scans of which no beam is usable: the robot is where the odometry has it."""
    _, scan = perfect.measurements[0]
    blind = replace(scan, status=np.full(len(scan), BeamStatus.INVALID, np.uint8))
    steps = np.array([*[0.05] * 100, 10.0, *[0.05] * 100, *[2.0] * 100])
    stamps_ns = scan.stamp_ns + np.cumsum(np.where(steps > 5, 20, 2)) * 10**9
    tracker, state, means = Tracker(), None, []
    for stamp_ns, x in zip(stamps_ns.tolist(), np.cumsum(steps), strict=True):
        odometry, beams = Odometry.at(stamp_ns, [x, 0.0, 0.0]), replace(blind, stamp_ns=stamp_ns).beams(0.05, 30.0)
        if state is None:
            state = tracker.init(odometry, stamp_ns, beams, OccupancyGridMapping())
        else:
            tracker.step(state, odometry, stamp_ns, beams)
        means.append(state.mean_step)
    assert state.pose[0] == pytest.approx(np.sum(steps[1:]))
    np.testing.assert_allclose(np.array(means)[[99, 200, 300]], [0.05, 0.05, 2.0], rtol=0.05)
    assert means[100] < 0.1
