"""The Python interface: five lines from a log to a map, and every part that can be chosen."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import gridslam
from gridslam.config import override
from gridslam.evaluation import absolute_errors
from gridslam.io.trajectory import read_tum


def test_import_is_quick_because_it_imports_nothing():
    code = "import sys, gridslam; dir(gridslam); sys.exit('numpy' in sys.modules or 'pydantic' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", gridslam.__all__)
def test_every_public_name_is_there(name):
    assert getattr(gridslam, name) is not None
    assert name in dir(gridslam)


def test_other_names_are_not():
    with pytest.raises(AttributeError, match="module 'gridslam' has no attribute 'map_lot'"):
        gridslam.map_lot  # noqa: B018


def test_five_lines_from_a_log_to_a_map(log, tmp_path):
    result = gridslam.map_log(log, particles=3)
    result.save(tmp_path / "out")
    assert len(result.trajectory) == len(result.online_trajectory) == 120
    assert result.trajectory.poses[-1].shape == (3,)
    assert np.hypot(*(result.trajectory.poses[-1] - result.online_trajectory.poses[-1])[:2]) < 0.1
    assert result.covariances.shape == (120, 3, 3)
    assert len(result.graph.poses) == len(result.key_stamps_ns) == result.statistics.key_scans
    assert result.loops is not None
    assert result.map.known.any()
    assert result.statistics.scans == 120
    assert len(result.state.poses) == 3
    assert (tmp_path / "out" / "map.yaml").is_file()


def test_ones_own_loop_gives_the_same(log):
    slam, rng, state, poses = gridslam.build(gridslam.preset("default", 3)), np.random.default_rng(0), None, []
    for odometry, scan in gridslam.CarmenLog(log):
        state, report = slam.step(state, odometry, scan, rng) if state else slam.init(odometry, scan)
        poses.append(report.pose)
    assert np.array_equal(poses, gridslam.map_log(log, particles=3).online_trajectory.poses)


def test_a_built_filter_knows_its_number_of_particles(log):
    measurements = list(gridslam.CarmenLog(log))[:2]
    for configured in (gridslam.preset("accurate"), gridslam.preset("fast"), gridslam.Configuration(particles=7)):
        slam = gridslam.build(configured)
        state, _ = slam.init(*measurements[0])
        assert len(state.poses) == slam.particles == configured.particles
        assert len(slam.init(*measurements[0], 4)[0].poses) == 4
        assert len(gridslam.run(measurements, slam, rng=np.random.default_rng(0)).poses) == configured.particles


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"seed": -1}, "seed: expected a number >= 0, got -1"),
        ({"threads": 0}, "threads: expected at least one, got 0"),
        ({"particles": 3, "configuration": gridslam.Configuration()}, "particles, laser: expected none where"),
    ],
)
def test_bad_calls_are_told(log, options, message):
    with pytest.raises(gridslam.ArgumentError, match=message):
        gridslam.map_log(log, **options)


@pytest.mark.parametrize(
    "choice",
    [
        "tracker.kind=OdometryTracker", "motion.kind=OdometryMotion", "motion.kind=GMappingMotion",
        "sensor.kind=EndPoint", "sensor.kind=LikelihoodField", "sensor.kind=BeamRangeFinder",
        "proposal.kind=Prior", "proposal.kind=Gaussian", "proposal.matcher.kind=HillClimbing",
        "when_to_resample.kind=Always", "when_to_resample.kind=Never", "resampler=wheel", "resampler=stratified",
        "resampler=residual", "resampler=multinomial", "resolution_m=0.1", "tracker.map_scans=5",
    ],
)  # fmt: skip
def test_every_choice_of_a_part_maps_the_log(log, choice):
    truth = read_tum(log.with_name("truth.tum"))
    result = gridslam.map_log(log, configuration=override(gridslam.preset("default", 10), choice))
    errors = absolute_errors(result.trajectory, truth)
    # no figure of merit, but whoever is lost, or takes a sign wrong, is off by more on 12 m
    assert errors.trans_rmse_m < 0.15
    assert errors.rot_rmse_deg < 3
