"""EKF localization tracks real robots, and its covariances are of the size of the errors."""

import numpy as np
import pytest

from gridslam.api.landmark_localization import localize_by_landmarks
from gridslam.evaluation import nees
from gridslam.geometry.se2 import compose, inverse, transform_points
from gridslam.io.landmark_logs import open_landmark_log
from gridslam.localization.ekf import KnownLandmarks
from support.global_localization import INSIDE


@pytest.fixture(scope="module", params=[1, 3])
def mrclam(request, data_dir):
    return open_landmark_log(data_dir / "landmarks" / f"mrclam6_Robot{request.param}_Odometry.dat.gz")


@pytest.mark.parametrize("unknown", [False, True])
def test_mrclam(mrclam, unknown):
    """Measured: 0.116 and 0.097 m with known correspondences, 0.127 and 0.094 m without, of landmarks 0.18 m apart.

    A filter that is lost is off by metres. The greatest error comes where nothing is seen for up to 24 s.
    """
    result = localize_by_landmarks(mrclam, unknown=unknown)
    errors = result.errors()
    assert errors.n > 3000
    assert errors.trans_rmse_m < 0.2
    assert errors.trans_max_m < 0.8
    assert errors.rot_rmse_deg < 7
    assert result.outliers <= 10  # robot 3 reads one barcode four times where another stands
    poses, truth = result.compare()
    covariances = result.covariances[np.searchsorted(result.stamps_ns, poses.stamps_ns)]
    squares = nees(poses.poses, truth.poses, covariances)  # measured: 2.6, 2.0; unknown: 3.2, 2.0
    assert 1.5 < squares.mean() < 4
    assert 0.9 < (squares < INSIDE).mean() < 0.98


def test_the_frame_of_the_map_does_not_matter(data_dir):
    """The same map from elsewhere: the way is the same one, seen from there. The start is as uncertain in x as in y."""
    mrclam = open_landmark_log(data_dir / "landmarks" / "mrclam6_Robot1_Odometry.dat.gz")
    there = np.array([2.0, -3.0, 0.8])
    here = localize_by_landmarks(mrclam, pose=[1.0, 2.0, 0.1])
    places = transform_points(inverse(there), mrclam.truth.positions)
    moved = localize_by_landmarks(
        mrclam, KnownLandmarks.of(mrclam.truth.landmarks, places), pose=compose(inverse(there), [1.0, 2.0, 0.1])
    )
    np.testing.assert_allclose(compose(there, moved.trajectory.poses)[:, :2], here.trajectory.poses[:, :2], atol=1e-6)
    assert (here.in_true_frame, moved.in_true_frame) == (True, False)
