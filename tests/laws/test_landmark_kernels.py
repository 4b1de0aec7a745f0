"""The kernels of landmark filters: their NumPy twins, and the sensors' own Jacobians."""

import numpy as np
import pytest

from gridslam.kernels import reference
from gridslam.kernels.reference_landmarks import DEPTH_BEARING, RANGE_BEARING, RELATIVE_POSITION
from gridslam.models.landmark import DepthBearing, RangeBearing, RelativePosition, linearize_calibrated
from gridslam.models.motion import GaussianIncrement

compiled = pytest.importorskip("gridslam.kernels._compiled")

SENSORS = {
    RANGE_BEARING: RangeBearing(),
    DEPTH_BEARING: DepthBearing(),
    RELATIVE_POSITION: RelativePosition(),
}
BOTH = pytest.mark.parametrize("kernels", [compiled, reference], ids=["compiled", "reference"])


def covariances(rng, *shape):
    """Covariances (*shape[:-1], D, D) of D = shape[-1] variables."""
    root = rng.normal(size=(*shape, shape[-1]))
    return root @ root.swapaxes(-1, -2)


def case(seed, particles=40, landmarks=7):
    """Particles all around, headings beyond a turn too; some of their landmarks, and one observation of them."""
    rng = np.random.default_rng(seed)
    poses = rng.normal(size=(particles, 3)) * [20.0, 20.0, 4.0]
    rows = np.sort(rng.permutation(particles)[: particles - 5])
    return {
        "poses": poses,
        "calibration": rng.normal(size=(particles, 2)) * 0.2 if seed % 3 else np.empty((0, 2)),
        "positions": poses[:, None, :2] + rng.normal(size=(particles, landmarks, 2)) * 10,
        "covariances": covariances(rng, particles, landmarks, 2),
        "rows": rows,
        "columns": rng.integers(landmarks, size=len(rows)),
        "pose_covariances": covariances(rng, len(rows), 3) if seed % 2 else np.empty((0, 3, 3)),
        "measured": rng.normal(size=2) * [10, 3],
        "noise": covariances(rng, 2),
    }


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("sensor", SENSORS)
def test_predictions_are_those_of_the_twin(sensor, seed):
    given = case(seed)
    for ours, theirs in zip(
        compiled.predict_landmarks(sensor, **given), reference.predict_landmarks(sensor, **given), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)


@BOTH
@pytest.mark.parametrize("sensor", SENSORS)
def test_a_sensor_without_errors_is_one_of_errors_of_zero(sensor, kernels):
    given = case(3)
    zeros = kernels.predict_landmarks(sensor, **{**given, "calibration": np.zeros((len(given["poses"]), 2))})
    none = kernels.predict_landmarks(sensor, **given)
    assert none[4].shape == (0, 2, 2)
    for ours, theirs in zip(none[:4], zeros[:4], strict=True):
        np.testing.assert_array_equal(ours, theirs)


@BOTH
@pytest.mark.parametrize("sensor", SENSORS)
def test_predictions_are_those_of_the_sensor(sensor, kernels):
    given, model = case(1), SENSORS[sensor]
    rows, columns = given["rows"], given["columns"]
    residuals, innovations, by_pose, by_landmark, by_sensor = kernels.predict_landmarks(sensor, **given)
    predicted, *jacobians = linearize_calibrated(
        model, given["poses"][rows], given["positions"][rows, columns], given["calibration"][rows]
    )
    np.testing.assert_allclose(residuals, model.residual(given["measured"], predicted), atol=1e-9)
    for ours, theirs in zip((by_pose, by_landmark, by_sensor), jacobians, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    expected = by_landmark @ given["covariances"][rows, columns] @ by_landmark.swapaxes(1, 2) + given["noise"]
    expected += by_pose @ given["pose_covariances"] @ by_pose.swapaxes(1, 2)
    np.testing.assert_allclose(innovations, expected, rtol=1e-9)


@BOTH
@pytest.mark.parametrize(("width", "size"), [(2, 2), (3, 3), (3, 6), (8, 8)])
def test_update_is_that_of_the_information_filter(kernels, width, size):
    """Inverse covariances add up, P^-1 + H' Q^-1 H, and the mean is that of both: another way to the same numbers."""
    rng = np.random.default_rng(size)
    P, means = covariances(rng, 9, size), rng.normal(size=(9, width))
    rows, H, Q = np.array([5, 0, 7]), rng.normal(size=(3, 2, size)), covariances(rng, 3, 2)
    residuals = rng.normal(size=(3, 2))
    S = H @ P[rows] @ H.swapaxes(1, 2) + Q
    after, moved = P.copy(), means.copy()
    shifts, gains = kernels.kalman_update(moved, after, rows, H, S, residuals)
    both = np.linalg.inv(P[rows]) + H.swapaxes(1, 2) @ np.linalg.solve(Q, H)
    expected = np.linalg.solve(both, H.swapaxes(1, 2) @ np.linalg.solve(Q, residuals[..., None]))[..., 0]
    np.testing.assert_allclose(after[rows], np.linalg.inv(both), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(shifts, expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose((gains @ residuals[..., None])[..., 0], shifts, atol=1e-12)
    np.testing.assert_array_equal(moved[rows], means[rows] + shifts[:, :width])
    untouched = np.setdiff1d(np.arange(9), rows)
    np.testing.assert_array_equal(after[untouched], P[untouched])
    np.testing.assert_array_equal(moved[untouched], means[untouched])


@BOTH
def test_what_has_no_variance_is_drawn_as_it_is(kernels):
    rng = np.random.default_rng(0)
    C = covariances(rng, 50, 3)
    C[::2, 1], C[::2, :, 1] = 0.0, 0.0
    means, numbers = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    drawn = kernels.draw_gaussians(means, C, numbers)
    np.testing.assert_array_equal(drawn[::2, 1], means[::2, 1])
    np.testing.assert_allclose(
        drawn[1::2], means[1::2] + (np.linalg.cholesky(C[1::2]) @ numbers[1::2, :, None])[..., 0], rtol=1e-9, atol=1e-9
    )
    np.testing.assert_array_equal(drawn, reference.draw_gaussians(means, C, numbers))


@pytest.mark.parametrize("is_isotropic", [False, True])
def test_many_poses_have_the_covariances_of_each_alone(is_isotropic):
    rng = np.random.default_rng(4)
    covariance = np.diag([0.3, 0.3, 0.1]) if is_isotropic else covariances(rng, 3)
    motion, poses = GaussianIncrement.with_covariance(rng.normal(size=3), covariance), rng.normal(size=(150, 3))
    alone = np.concatenate([motion.moments(pose[None])[1] for pose in poses])
    np.testing.assert_allclose(motion.moments(poses)[1], alone, atol=1e-12)
