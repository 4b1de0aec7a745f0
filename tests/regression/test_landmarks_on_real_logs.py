"""Landmark SLAM on MRCLAM and Victoria Park, with known correspondences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gridslam.api.landmarks import COMMANDS, MOTION, LandmarkEstimate, LandmarkResult, map_landmarks
from gridslam.evaluation import align
from gridslam.evaluation.consistency import nees
from gridslam.evaluation.maps import pair_by_name
from gridslam.geometry.se2 import compose, inverse, transform_points
from gridslam.io.landmark_logs import open_landmark_log
from gridslam.models.association import NEW, LandmarkExistence
from gridslam.models.landmark import DepthBearing, with_durations
from gridslam.slam.landmarks.ekf_slam import EkfSlam


@pytest.mark.parametrize("robot", [1, 3])
@pytest.mark.parametrize("method", ["ekf", "graph"])
def test_mrclam(data_dir, robot, method):
    """Landmarks within the 0.15 m that is asked for, misread barcodes included: both methods have 0.08 to 0.10 m."""
    result = map_landmarks(data_dir / "landmarks" / f"mrclam6_Robot{robot}_Odometry.dat.gz", method)
    poses, landmarks = result.errors()
    assert (landmarks.found, landmarks.missing, landmarks.surplus) == (15, 0, 0)
    assert landmarks.rmse_m <= 0.15
    # Measured 0.13 and 0.26 m by the EKF, online and over 24 s without a sighting, and 0.10 and 0.08 m by the graph.
    assert poses.trans_rmse_m <= {"ekf": 0.35, "graph": 0.12}[method]


def test_mrclam_by_particles(data_dir):
    """Robot 1 with FastSLAM 2.0: 0.11 to 0.16 m over eight seeds; a filter that is lost is off by metres."""
    result = map_landmarks(data_dir / "landmarks" / "mrclam6_Robot1_Odometry.dat.gz", "fastslam2", seed=0)
    poses, landmarks = result.errors()
    assert landmarks.found == 15
    assert landmarks.rmse_m <= 0.2
    assert poses.trans_rmse_m <= 0.3


def test_misread_barcodes_are_not_believed(data_dir):
    """Robot 3 reads one barcode four times where another stands, 3.3 rad away."""
    result = map_landmarks(data_dir / "landmarks" / "mrclam6_Robot3_Odometry.dat.gz", "ekf")
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
    # Measured 0.95 m and 1.75 m, from 100 m away; 0.7 to 1.9 m and 1.5 to 2.0 m with half or twice the prior.
    landmarks, way = _apart(ekf, graph)
    assert landmarks < 2.0
    assert way < 3.0
    # Ten seeds: 2.1 to 4.2 m and 2.2 to 3.6 m, half their range added. Without the learned errors 14 m and 16 m.
    landmarks, way = _apart(particles, graph)
    assert landmarks < 5.3
    assert way < 4.1
    assert ekf.estimate.outliers == 4  # trunks that are taken for others, 7 to 10 m away


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


@pytest.mark.parametrize("method", ["ekf", "fastslam2", "graph"])
def test_covariances_are_of_the_size_of_the_errors(log, method):
    """A third to three times the median of chi2, and a little: measured 1.0 to 2.9.

    With noise that is independent in time and newest Jacobians EKF SLAM has 187 on robot 3, and the spread of the
    particles of FastSLAM 2.0 gives 16 and 20.
    """
    assert 0.7 < _median_nees(map_landmarks(log, method)) < 7.2


def test_the_scale_of_the_camera_is_estimated(log):
    """Against the truth both cameras read 2.5 % too much; the estimate is within two of its deviations of 2.4 %."""
    errors = map_landmarks(log, "ekf").estimate.figures["systematic_errors"]
    assert abs(errors["range_scale"] - 0.025) < 0.05
    assert abs(errors["mounting_m"] + 0.05) < 0.05


class NearestNeighbor:
    """Each observation is of the nearest landmark, whatever the others are of, and beyond a gate of a new one."""

    uses_signatures = False
    outlier_distance = 9.2

    def __call__(self, observations, names, distances, log_dets):
        if not len(names):
            return np.full(len(observations), NEW)
        nearest = distances.argmin(axis=1)
        return np.where(distances.min(axis=1) <= self.outlier_distance, nearest, NEW)


def _run_with_nearest_neighbors(log, known):
    """EKF SLAM that decides at once, without provisional landmarks, without mutual exclusion."""
    slam = EkfSlam(DepthBearing(), NearestNeighbor(), LandmarkExistence(log_odds_confirmed=1e-9), bias=COMMANDS)
    state = slam.init()
    reports = []
    for step in with_durations(open_landmark_log(log)):
        state, report = slam.step(state, step.motion(MOTION), step.observations.drop_correspondences())
        reports.append(report)
    poses = np.array([report.pose for report in reports])
    covariances = np.array([report.covariance for report in reports])
    estimate = LandmarkEstimate(poses, poses, covariances, slam.landmark_map(state), 0, {})
    return replace(known, unknown=True, estimate=estimate)


def _faults(result, known):
    """What of unknown correspondences is worse than asked: within 1.5 times the known ones, none missing or surplus."""
    poses, landmarks = result.errors()
    faults = []
    if landmarks is None or landmarks.found < 15:
        faults.append("missing")
    if landmarks is None or landmarks.surplus:
        faults.append("surplus")
    if poses.trans_rmse_m > 1.5 * known.errors()[0].trans_rmse_m:
        faults.append("error")
    return faults


def test_unknown_correspondences_and_what_nearest_neighbors_miss(log):
    """EKF SLAM meets what is asked of unknown correspondences, and plain nearest neighbors do not.

    Measured 0.19 and 0.14 m with known 0.19 and 0.15 m; nearest neighbors have four surplus landmarks on
    robot 1, and ten and 0.48 m on robot 3.
    """
    known = map_landmarks(log, "ekf")
    assert _faults(map_landmarks(log, "ekf", unknown=True), known) == []
    assert _faults(_run_with_nearest_neighbors(log, known), known) != []
