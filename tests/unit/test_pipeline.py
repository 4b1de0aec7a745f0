"""The one loop and its observers."""

from __future__ import annotations

import itertools
import time

import numpy as np
import pytest

from gridslam.config import Configuration, build, override
from gridslam.errors import ArgumentError, ConsumedStateError
from gridslam.geometry.se2 import between, compose
from gridslam.observers import StatisticsRecorder, TrajectoryRecorder
from gridslam.pipeline import Stopwatch, run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, make_world, simulate
from gridslam.types import SkipReason, StepReport

PARTICLES = 6


@pytest.fixture(scope="module")
def measurements():
    rng = np.random.default_rng(2)
    log = simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), LidarConfig(beams=90), rng)
    return log.measurements[:150]


@pytest.fixture(scope="module")
def slam():
    return build(override(Configuration(), "when_to_resample.kind=AlwaysResample"))


def seen(reports):
    def observe(report, state, seconds):
        reports.append((report, seconds))

    return observe


def test_run_is_init_then_steps_and_tells_every_observer(measurements, slam):
    reports, others = [], []
    observers = [seen(reports), seen(others)]
    end = run(measurements, slam, particles=PARTICLES, rng=np.random.default_rng(1), observers=observers)
    rng = np.random.default_rng(1)
    state, expected = slam.init(*measurements[0], PARTICLES)
    for k, (odometry, scan) in enumerate(measurements):
        if k:
            state, expected = slam.step(state, odometry, scan, rng)
        report, seconds = reports[k]
        assert report.stamp_ns == scan.stamp_ns
        assert np.array_equal(report.pose, expected.pose)
        assert report.skipped == expected.skipped
        assert seconds > 0
    assert others == reports
    assert np.array_equal(end.poses, state.poses)


def test_run_goes_on_from_a_state_and_consumes_it(measurements, slam):
    whole = run(measurements, slam, particles=PARTICLES, rng=np.random.default_rng(1))
    rng = np.random.default_rng(1)
    half = run(measurements[:70], slam, particles=PARTICLES, rng=rng)
    end = run(iter(measurements[70:]), slam, rng=rng, state=half)
    assert np.array_equal(end.poses, whole.poses)
    assert np.array_equal(end.log_weights, whole.log_weights)
    with pytest.raises(ConsumedStateError):
        half.snapshot()


def test_a_state_without_measurements_stays_as_it_is(measurements, slam):
    state = run(measurements[:1], slam, particles=PARTICLES, rng=np.random.default_rng(1))
    assert run([], slam, rng=np.random.default_rng(1), state=state) is state


def test_source_must_give_something_and_odometry_where_the_tracker_needs_it(measurements, slam):
    with pytest.raises(ArgumentError, match="at least one measurement"):
        run([], slam, rng=np.random.default_rng(1))
    without = [(None, scan) for _, scan in measurements[:3]]
    run(without, slam, particles=PARTICLES, rng=np.random.default_rng(1))
    with pytest.raises(ArgumentError, match="a pose with every scan"):
        run(without, build(override(Configuration(), "tracker.kind=OdometryTracker")), rng=np.random.default_rng(1))


def fixed_by_the_particle(reports):
    """Which scans' poses the particle alone decides: key scans, and those after the last one."""
    is_key = np.array([report.skipped is None for report, _ in reports])
    is_key[is_key.nonzero()[0][-1] :] = True
    return is_key


def test_trajectory_of_one_particle_is_the_same_online_and_in_full(measurements, slam):
    recorder, reports = TrajectoryRecorder(), []
    observers = [recorder, seen(reports)]
    state = run(measurements, slam, particles=1, rng=np.random.default_rng(1), observers=observers)
    online, full = recorder.online_trajectory(), recorder.best_trajectory(state)
    assert np.array_equal(online.stamps_ns, [scan.stamp_ns for _, scan in measurements])
    assert np.array_equal(full.stamps_ns, online.stamps_ns)
    fixed = fixed_by_the_particle(reports)
    assert 20 < fixed.sum() < len(fixed)
    assert np.abs(between(full.poses, online.poses))[fixed].max() < 1e-12
    # between two key scans full may know better where the second one lies; the tracker is good to some centimetres
    assert np.abs(between(full.poses, online.poses)).max() < 0.15


def test_full_trajectory_follows_the_best_particles_own_past(measurements, slam):
    """Against brute force: each particle's whole history is copied at each resampling."""
    recorder, reports = TrajectoryRecorder(), []
    state = run(
        measurements, slam, particles=PARTICLES, rng=np.random.default_rng(4), observers=[recorder, seen(reports)]
    )
    histories = [[] for _ in range(PARTICLES)]
    for report, _ in reports:
        if report.skipped is None:
            for history, pose in zip(histories, report.poses, strict=True):
                history.append(pose)
            if report.parents is not None:
                histories = [list(histories[parent]) for parent in report.parents]
        else:
            for history in histories:
                history.append(report.key_from_base)
    assert sum(report.parents is not None for report, _ in reports) >= 3  # else it would prove little
    expected, key = [], np.zeros(3)
    for (report, _), entry in zip(reports, histories[state.best], strict=True):
        key = entry if report.skipped is None else key
        expected.append(key if report.skipped is None else compose(key, entry))
    full, fixed = recorder.best_trajectory(state).poses, fixed_by_the_particle(reports)
    assert np.abs(between(np.array(expected), full))[fixed].max() < 1e-12
    assert np.abs(between(np.array(expected), full)).max() < 0.1
    assert not np.array_equal(full, recorder.online_trajectory().poses)  # the best particle changed on the way


def test_recorder_survives_arrays(measurements, slam):
    recorder = TrajectoryRecorder()
    state = run(measurements, slam, particles=2, rng=np.random.default_rng(4), observers=[recorder])
    twin = TrajectoryRecorder.from_arrays(recorder.to_arrays())
    assert np.array_equal(twin.best_trajectory(state).poses, recorder.best_trajectory(state).poses)
    broken = recorder.to_arrays() | {"online": np.zeros((3, 3))}
    with pytest.raises(ArgumentError, match="online: expected float64"):
        TrajectoryRecorder.from_arrays(broken)
    with pytest.raises(ArgumentError, match="an array named repeats"):
        TrajectoryRecorder.from_arrays({"stamps_ns": np.zeros(1, np.int64)})


def test_a_robot_that_stands_takes_8_bytes_a_scan():
    """Of a thousand scans where the robot was, only their stamps are kept; the poses are given for all."""
    recorder = TrajectoryRecorder()
    recorder(report(), None, 0.01)
    moved = StepReport(1, np.ones(3), np.eye(3), np.ones(3), skipped=SkipReason.BETWEEN_KEY_SCANS)
    for _ in range(1000):
        recorder(moved, None, 0.01)
    assert sum(values.nbytes for values in recorder.to_arrays().values()) == 1001 * 8 + 2 * 64
    twin = TrajectoryRecorder.from_arrays(recorder.to_arrays())
    twin(moved, None, 0.01)
    assert twin.to_arrays()["repeats"].tolist() == [1, 1001]
    assert twin.keys.tolist() == [0] * 1002
    np.testing.assert_array_equal(twin.key_from_base, np.concatenate([np.zeros((1, 3)), np.ones((1001, 3))]))
    np.testing.assert_array_equal(twin.online_trajectory().poses, twin.key_from_base)
    with pytest.raises(ArgumentError, match="repeats: expected positive numbers of 1001 scans in all, got 1002"):
        TrajectoryRecorder.from_arrays(recorder.to_arrays() | {"repeats": np.array([1, 1001])})


def report(skipped=None, **options):
    return StepReport(0, np.zeros(3), np.eye(3), np.zeros(3), skipped=skipped, **options)


def test_statistics_count_and_time_what_they_were_told():
    recorder = StatisticsRecorder()
    recorder(report(n_eff=4.0, parents=np.arange(4)), None, 0.4)
    recorder(report(n_eff=2.0, degenerate_direction=np.array([1.0, 0.0]), lost=True, corrected=True), None, 0.2)
    for k in range(97):
        recorder(report(SkipReason.BETWEEN_KEY_SCANS, lost=k == 0), None, 0.001)
    recorder(report(SkipReason.NO_VALID_BEAM), None, 0.001)
    twin = StatisticsRecorder.from_arrays(recorder.to_arrays())
    for summary in (recorder.summary(), twin.summary()):
        assert (summary.scans, summary.key_scans) == (100, 2)
        assert summary.skipped == {SkipReason.BETWEEN_KEY_SCANS: 97, SkipReason.NO_VALID_BEAM: 1}
        assert (summary.resamplings, summary.lost, summary.degenerate, summary.corrections) == (1, 2, 1, 1)
        assert (summary.n_eff_mean, summary.n_eff_min) == (3.0, 2.0)
        assert summary.latency.median_s == 0.001
        assert summary.latency.p99_s == pytest.approx(0.202)
        assert summary.latency.max_s == 0.4
        assert (summary.key_latency.median_s, summary.key_latency.max_s) == (pytest.approx(0.3), 0.4)


def test_statistics_of_nothing_are_zero():
    summary = StatisticsRecorder().summary()
    assert (summary.scans, summary.key_scans, summary.n_eff_mean, summary.latency.max_s) == (0, 0, 0.0, 0.0)


def test_stopwatch_gives_every_moment_to_one_stage(measurements, slam, monkeypatch):
    ticks = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(ticks)))  # each look at the clock takes a second
    watch = Stopwatch()
    run(measurements, slam, particles=1, rng=np.random.default_rng(1), stopwatch=watch)
    stages = {name: wall for name, (wall, _) in watch.stages.items()}
    count = len(measurements)
    assert stages.pop("read") == count + 1  # once more, to learn that the source has ended
    assert stages.pop("observe") == count
    assert stages["track"] + stages["step"] == count
    wall, cpu = watch.total()
    assert wall == 3 * count + 1 == next(ticks) - 1
    assert 0 < cpu < 60
    next(ticks)  # someone else's time
    watch.resume()
    watch.lap("write")
    assert watch.stages["write"][0] == 1


def test_a_lap_measures_wall_and_cpu_time_of_its_stage(monkeypatch):
    wall, cpu = iter([0.0, 1.0, 4.0, 10.0, 11.0, 12.0]), iter([0.0, 0.75, 3.0, 8.0, 8.25, 8.5])
    monkeypatch.setattr(time, "perf_counter", lambda: next(wall))
    monkeypatch.setattr(time, "process_time", lambda: next(cpu))
    watch = Stopwatch()
    assert watch.lap("read") == 1
    assert watch.lap("track") == 3
    assert watch.stages == {"read": [1, 0.75], "track": [3, 2.25]}
    watch.resume()  # after 6 s that are no stage's
    watch.lap("read")
    watch.lap("track")
    assert watch.stages == {"read": [2, 1.0], "track": [4, 2.5]}
    assert watch.total() == (6, 3.5)
