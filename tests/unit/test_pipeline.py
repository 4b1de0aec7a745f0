"""The one loop and its observers."""

import itertools
import time
from dataclasses import replace

import numpy as np
import pytest

from gridslam.config import Configuration, build, override
from gridslam.errors import ArgumentError
from gridslam.geometry.se2 import between
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
    end = run(measurements, replace(slam, particles=PARTICLES), rng=np.random.default_rng(1), observers=observers)
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


def test_source_must_give_something_and_odometry_where_the_tracker_needs_it(measurements, slam):
    with pytest.raises(ArgumentError, match="at least one measurement"):
        run([], slam, rng=np.random.default_rng(1))
    without = [(None, scan) for _, scan in measurements[:3]]
    run(without, replace(slam, particles=PARTICLES), rng=np.random.default_rng(1))
    with pytest.raises(ArgumentError, match="a pose with every scan"):
        run(without, build(override(Configuration(), "tracker.kind=OdometryTracker")), rng=np.random.default_rng(1))


def test_full_trajectory_is_where_the_particle_was_and_the_online_one_near_it(measurements, slam):
    recorder, reports = TrajectoryRecorder(), []
    observers = [recorder, seen(reports)]
    state = run(measurements, replace(slam, particles=1), rng=np.random.default_rng(1), observers=observers)
    online, full = recorder.online_trajectory(), recorder.best_trajectory(state)
    assert np.array_equal(online.stamps_ns, [scan.stamp_ns for _, scan in measurements])
    assert np.array_equal(full.stamps_ns, online.stamps_ns)
    is_key = np.array([report.skipped is None for report, _ in reports])
    assert 20 < is_key.sum() < len(is_key)
    of_particle = np.concatenate([report.poses for report, _ in reports if report.skipped is None])
    assert np.abs(between(of_particle, full.poses[is_key])).max() < 1e-12
    # what is reported is smoothed; after the last key scan and between key scans the motion is the tracker's
    assert 0 < np.abs(between(full.poses, online.poses))[is_key].max() < 0.02
    assert np.abs(between(full.poses, online.poses)).max() < 0.15


def test_recorder_survives_arrays(measurements, slam):
    recorder = TrajectoryRecorder()
    state = run(measurements, replace(slam, particles=2), rng=np.random.default_rng(4), observers=[recorder])
    twin = TrajectoryRecorder.from_arrays(recorder.to_arrays())
    assert np.array_equal(twin.best_trajectory(state).poses, recorder.best_trajectory(state).poses)
    broken = recorder.to_arrays() | {"online": np.zeros((3, 3))}
    with pytest.raises(ArgumentError, match="online: expected float64"):
        TrajectoryRecorder.from_arrays(broken)
    with pytest.raises(ArgumentError, match="an array named keys"):
        TrajectoryRecorder.from_arrays({"stamps_ns": np.zeros(1, np.int64)})


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


def test_stopwatch_gives_every_moment_to_one_stage(measurements, slam, monkeypatch):
    ticks = itertools.count()
    monkeypatch.setattr(time, "perf_counter", lambda: float(next(ticks)))  # each look at the clock takes a second
    watch = Stopwatch()
    run(measurements, replace(slam, particles=1), rng=np.random.default_rng(1), stopwatch=watch)
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
