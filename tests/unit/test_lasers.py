"""Lasers' figures laid over presets: what changes, what does not, and that it pays in simulation."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gridslam.config import Configuration, apply_laser, build, override, preset
from gridslam.errors import ConfigurationError
from gridslam.evaluation import absolute_errors
from gridslam.observers import TrajectoryRecorder
from gridslam.pipeline import run
from gridslam.sim import LidarConfig, OdometryNoise, RobotConfig, SimulatedLog, make_world, simulate
from gridslam.types import Trajectory
from support.faults import range_limits


def test_exact_lasers_get_finer_cells_where_scans_are_matched_by_gauss_newton():
    fine = apply_laser(preset("default"), "hokuyo-utm-30lx")
    expected = override(
        preset("default"),
        "resolution_m=0.03",
        "range_min_m=0.1",
        "tracker.matcher.cauchy_m=0.05",
        "proposal.matcher.cauchy_m=0.05",
    )
    assert fine == expected
    assert apply_laser(preset("gmapping"), "hokuyo-utm-30lx").mapper == preset("gmapping").mapper
    assert apply_laser(preset("default"), "rplidar-a1").mapper == Configuration().mapper


def test_an_unknown_laser_is_refused_with_what_may_be_meant():
    with pytest.raises(ConfigurationError, match=r"laser: expected sick-lms, .* got 'rplidar'; did you mean rplidar-a"):
        apply_laser(Configuration(), "rplidar")


def recorded(lidar: LidarConfig, seed: int) -> SimulatedLog:
    rng = np.random.default_rng(seed)
    return simulate(make_world("rooms", rng), RobotConfig(), OdometryNoise(), lidar, rng)


def error_m(measurements, truth: Trajectory, config: Configuration) -> float:
    """RMSE of the trajectory, aligned; by the filter alone, with few particles."""
    recorder, config = TrajectoryRecorder(), override(config, "particles=8", "loop_closure=false")
    rng = np.random.default_rng(0)
    state = run(measurements, build(config), rng=rng, observers=[recorder])
    return absolute_errors(recorder.best_trajectory(state), truth).trans_rmse_m


def test_finer_cells_pay_with_exact_lasers():
    """Over six buildings by a fifth to a third, in this one by more than a tenth."""
    log = recorded(LidarConfig(beams=450, field_of_view_rad=math.tau, range_max_m=12.0, rate_hz=4.0), 1)
    finer = error_m(log.measurements, log.truth, apply_laser(Configuration(), "ld19"))
    assert finer < 0.9 * error_m(log.measurements, log.truth, Configuration())


@pytest.mark.parametrize(("name", "range_max_m"), [("lds-01", 3.5), ("hokuyo-urg-04lx", 5.6), ("rplidar-a1", 12.0)])
def test_beams_without_return_are_no_walls_where_the_log_lies_about_the_greatest_range(name, range_max_m):
    """Told twice the range, what did not return reads as a circle of walls about the robot."""
    lidar = LidarConfig(beams=360, field_of_view_rad=math.tau, range_max_m=range_max_m, rate_hz=2.0)
    log = recorded(lidar, 1)
    lies = [scan for _, scan in range_limits(log.measurements, 2.0)]
    limits = apply_laser(Configuration(), name)
    true = [len(scan.beams(limits.range_min_m, limits.range_max_m)) for _, scan in log.measurements]
    assert [len(scan.beams(limits.range_min_m, limits.range_max_m)) for scan in lies] == true
    assert all(len(scan.beams(0.05, 30.0)) == 360 for scan in lies)
    assert sum(true) < 360 * len(true)
