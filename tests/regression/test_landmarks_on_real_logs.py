"""Landmark SLAM on MRCLAM and Victoria Park, with known correspondences."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from gridslam.api.landmarks import LandmarkMethod, LandmarkResult, map_landmarks
from gridslam.evaluation import align
from gridslam.evaluation.consistency import nees
from gridslam.evaluation.maps import pair_by_name
from gridslam.geometry.se2 import compose, inverse, transform_points


@cache
def mapped(log: Path, method: LandmarkMethod) -> LandmarkResult:
    """Map a log once for all tests."""
    return map_landmarks(log, method)


@pytest.mark.parametrize("robot", [1, 3])
@pytest.mark.parametrize("method", ["ekf", "graph"])
def test_mrclam(data_dir, robot, method):
    """Landmarks and poses, misread barcodes included; nothing is drawn, so the margin is for other models of noise."""
    result = mapped(data_dir / "landmarks" / f"mrclam6_Robot{robot}_Odometry.dat.gz", method)
    poses, landmarks = result.errors()
    assert (landmarks.found, landmarks.missing, landmarks.surplus) == (15, 0, 0)
    # Measured 0.056 and 0.035 m by the EKF, which estimates the scale of the ranges, and 0.08 to 0.10 m by the graph.
    assert landmarks.rmse_m <= {"ekf": 0.08, "graph": 0.15}[method]
    # Measured 0.18 and 0.15 m by the EKF, online and over 24 s without a sighting, and 0.09 and 0.08 m by the graph.
    assert poses.trans_rmse_m <= {"ekf": 0.25, "graph": 0.12}[method]


def test_mrclam_by_particles(data_dir):
    """Robot 1 with FastSLAM 2.0: landmarks off by 0.10 m, poses by 0.16 m; a filter that is lost is off by metres."""
    result = map_landmarks(data_dir / "landmarks" / "mrclam6_Robot1_Odometry.dat.gz", "fastslam2", seed=0)
    poses, landmarks = result.errors()
    assert landmarks.found == 15
    assert landmarks.rmse_m <= 0.2
    assert poses.trans_rmse_m <= 0.3


def test_misread_barcodes_are_not_believed(data_dir):
    """Robot 3 reads one barcode four times where another stands, 3.3 rad away."""
    result = mapped(data_dir / "landmarks" / "mrclam6_Robot3_Odometry.dat.gz", "ekf")
    assert result.estimate.outliers == 4


def test_victoria_park(data_dir):
    """The graph's chi2 is what its file's noise explains; EKF SLAM and FastSLAM 2.0 find all trunks of that park."""
    log = data_dir / "landmarks" / "victoria_park.txt.gz"
    graph, ekf = (map_landmarks(log, method) for method in ("graph", "ekf"))
    particles = map_landmarks(log, "fastslam2", seed=0)
    figures = graph.estimate.figures
    assert figures["converged"]
    assert figures["degrees_of_freedom"] == 2 * (3640 - 151)
    assert 0.8 < figures["chi2"] / figures["degrees_of_freedom"] < 1.0
    # Measured 0.88 m and 0.81 m, from 100 m away; a path that errs by 1.8 m has no systematic errors.
    landmarks, way = _apart(ekf, graph)
    assert landmarks < 1.3
    assert way < 1.3
    # Four seeds: 2.3 to 5.3 m and 2.4 to 3.9 m, half their range added; 14 to 21 m without the calibration.
    landmarks, way = _apart(particles, graph)
    assert landmarks < 6.8
    assert way < 4.7


def _apart(result: LandmarkResult, other: LandmarkResult) -> list[float]:
    """Medians of what separates all landmarks and all poses of two results, after alignment."""
    assert len(result.landmarks) == len(other.landmarks) == 151
    ours, theirs = pair_by_name(result.landmarks.names, other.landmarks.names)
    return [
        float(np.median(np.hypot(*(transform_points(align(a, b), a) - b).T)))
        for a, b in (
            (result.landmarks.positions[ours], other.landmarks.positions[theirs]),
            (result.estimate.poses[:, :2], other.estimate.poses[:, :2]),
        )
    ]


@pytest.fixture(params=[1, 3])
def log(request, data_dir):
    return data_dir / "landmarks" / f"mrclam6_Robot{request.param}_Odometry.dat.gz"


def _median_nees(result):
    """Of the poses, in the frame of the first one: x, y and theta have 3 degrees of freedom, with a median of 2.37."""
    found, truth = result.compare()
    true_from_map = compose(truth.poses[0], inverse(found.poses[0]))
    c, s = np.cos(true_from_map[2]), np.sin(true_from_map[2])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    spread = turn @ result.covariances[np.searchsorted(result.stamps_ns, found.stamps_ns)] @ turn.T
    return np.median(nees(compose(true_from_map, found.poses), truth.poses, spread + 1e-9 * np.eye(3)))


@pytest.mark.parametrize("method", ["ekf", "graph"])
def test_covariances_are_of_the_size_of_the_errors(log, method):
    """A third to three times the median of chi2, and a little: measured 1.2 to 3.8."""
    assert 0.7 < _median_nees(mapped(log, method)) < 7.2


def test_systematic_errors_are_those_that_the_ground_truth_has(log):
    """Against the truth the odometry turns by -0.041 and -0.075 rad/m, +- 0.013, and both cameras read 2.5 % too much.

    The filter's own standard deviations are 0.015 rad/m and 2.5 %; two of both together, and one.
    """
    errors = mapped(log, "ekf").estimate.figures["systematic_errors"]
    assert abs(errors["turn_per_m"] - {"1": -0.041, "3": -0.075}[log.name[13]]) < 0.04
    assert abs(errors["range_scale"] - 0.025) < 0.025


def test_unknown_correspondences(data_dir):
    """Robot 1 with FastSLAM 2.0: each of the 15 landmarks once on three of four seeds; EKF SLAM misses one."""
    log = data_dir / "landmarks" / "mrclam6_Robot1_Odometry.dat.gz"
    poses, landmarks = map_landmarks(log, "fastslam2", unknown=True).errors()
    assert (landmarks.found, landmarks.surplus) == (15, 0)
    assert poses.trans_rmse_m < 0.3
    _, single = map_landmarks(log, "ekf", unknown=True).errors()
    assert single.found < 15
