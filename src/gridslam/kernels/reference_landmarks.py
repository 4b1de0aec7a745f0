"""NumPy twins of the kernels of landmark filters: predictions of many particles, and Kalman's update of Gaussians."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

RANGE_BEARING, DEPTH_BEARING, RELATIVE_POSITION = range(3)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def predict_landmarks(
    sensor: int,
    poses: FloatArray,
    calibration: FloatArray,
    positions: FloatArray,
    covariances: FloatArray,
    rows: IntArray,
    columns: IntArray,
    pose_covariances: FloatArray,
    measured: FloatArray,
    noise: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Predict one observation of R landmarks (rows, columns), each in the map of a particle.

    Parameters
    ----------
    sensor : int
        `RANGE_BEARING`, `DEPTH_BEARING` or `RELATIVE_POSITION`.
    poses : (N, 3) float64
        Of the particles.
    calibration : (N, 2) or (0, 2) float64
        How far the sensor is ahead, m, and the share by which it takes ranges for too long; none if it is exact.
    positions, covariances : (N, M, 2), (N, M, 2, 2) float64
        Of the landmarks, map frame.
    pose_covariances : (R, 3, 3) or (0, 3, 3) float64
        Of the poses as seen from the landmarks; none where they are exact.
    measured, noise : (2,), (2, 2) float64
        z and Q.

    Returns
    -------
    residuals, innovations : (R, 2), (R, 2, 2) float64
        z - h, angles in [-pi, pi), and H_m Sigma H_m' + H_x R H_x' + Q.
    by_pose, by_landmark, by_sensor : (R, 2, 3), (R, 2, 2), (R, 2, 2) float64
        H_x, H_m, and the Jacobian by the calibration, if there is any.
    """
    theta = poses[rows, 2]
    c, s = np.cos(theta), np.sin(theta)
    errors = calibration[rows] if len(calibration) else np.zeros((len(rows), 2))
    mounted, scale = errors[:, 0], 1.0 + errors[:, 1]
    x = positions[rows, columns, 0] - (poses[rows, 0] + mounted * c)
    y = positions[rows, columns, 1] - (poses[rows, 1] + mounted * s)
    h, by_landmark, by_heading = _measure(sensor, scale * x, scale * y, theta)
    by_scale = by_landmark[..., 0] * x[:, None] + by_landmark[..., 1] * y[:, None]
    by_landmark = by_landmark * scale[:, None, None]
    along = by_landmark[..., 0] * c[:, None] + by_landmark[..., 1] * s[:, None]
    across = by_landmark[..., 1] * c[:, None] - by_landmark[..., 0] * s[:, None]
    by_pose = np.concatenate([-by_landmark, (by_heading - mounted[:, None] * across)[..., None]], axis=-1)
    innovations = by_landmark @ covariances[rows, columns] @ by_landmark.swapaxes(1, 2) + noise
    if len(pose_covariances):
        innovations += by_pose @ pose_covariances @ by_pose.swapaxes(1, 2)
    residuals = measured - h
    if sensor != RELATIVE_POSITION:
        residuals[:, 1] = _wrap(residuals[:, 1])
    by_sensor = np.stack([-along, by_scale], axis=-1)
    return residuals, innovations, by_pose, by_landmark, by_sensor if len(calibration) else by_sensor[:0]


def kalman_update(
    means: FloatArray,
    covariances: FloatArray,
    rows: IntArray,
    jacobians: FloatArray,
    innovations: FloatArray,
    residuals: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Condition R of X Gaussians, all different, on an observation of two numbers each; writes to them.

    Parameters
    ----------
    means, covariances : (X, W), (X, D, D) float64
        W <= D: of the first W of D variables the mean is kept, and is updated.
    rows : (R,) int64
        Which.
    jacobians : (R, 2, D) float64
        H.
    innovations, residuals : (R, 2, 2), (R, 2) float64
        S, of full rank, and z - h.

    Returns
    -------
    shifts, gains : (R, D), (R, D, 2) float64
        By how much the means change, K (z - h), with Kalman's gain K = P H' S^-1.
    """
    before = covariances[rows]
    shared = before @ jacobians.swapaxes(1, 2)
    determinant = innovations[:, 0, 0] * innovations[:, 1, 1] - innovations[:, 0, 1] * innovations[:, 1, 0]
    adjugate = np.empty_like(innovations)
    adjugate[:, 0, 0], adjugate[:, 1, 1] = innovations[:, 1, 1], innovations[:, 0, 0]
    adjugate[:, 0, 1], adjugate[:, 1, 0] = -innovations[:, 0, 1], -innovations[:, 1, 0]
    gains = shared @ adjugate / determinant[:, None, None]
    shifts = (gains @ residuals[..., None])[..., 0]
    covariances[rows] = before - gains @ shared.swapaxes(1, 2)
    means[rows] += shifts[:, : means.shape[1]]
    return shifts, gains


def draw_gaussians(means: FloatArray, covariances: FloatArray, numbers: FloatArray) -> FloatArray:
    """Vectors (N, D) of Gaussians (N, D), (N, D, D), from standard normal numbers (N, D).

    Cholesky's factor comes column by column, and each takes away what it explains; variances may be 0.
    """
    drawn = means.T.copy()
    left = covariances.transpose(1, 2, 0).copy()  # loops run along the Gaussians
    for i, number in enumerate(numbers.T):
        sigma = np.sqrt(np.maximum(left[i, i], 0.0))
        column = np.divide(left[i], sigma, out=np.zeros_like(left[i]), where=sigma > 0)  # no variance, no covariance
        drawn += number * column
        left -= column[:, None] * column
    return np.ascontiguousarray(drawn.T)


def _measure(
    sensor: int, dx: FloatArray, dy: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return h (R, 2) of points at (dx, dy), its Jacobians by the landmark (R, 2, 2), and by the heading (R, 2)."""
    c, s = np.cos(theta), np.sin(theta)
    ahead, left = c * dx + s * dy, c * dy - s * dx
    if sensor == RELATIVE_POSITION:
        by_landmark = np.stack([c, s, -s, c], axis=-1).reshape(-1, 2, 2)
        return np.stack([ahead, left], axis=-1), by_landmark, np.stack([left, -ahead], axis=-1)
    square = dx * dx + dy * dy
    distance = np.sqrt(square)
    first = [distance, dx / distance, dy / distance] if sensor == RANGE_BEARING else [ahead, c, s]
    turned = np.zeros_like(theta) if sensor == RANGE_BEARING else left
    by_landmark = np.stack([*first[1:], -dy / square, dx / square], axis=-1).reshape(-1, 2, 2)
    h = np.stack([first[0], _wrap(np.arctan2(dy, dx) - theta)], axis=-1)
    return h, by_landmark, np.stack([turned, np.full_like(theta, -1.0)], axis=-1)


def _wrap(angles: FloatArray) -> FloatArray:
    rest: FloatArray = np.fmod(angles, math.tau)
    return rest - math.tau * np.subtract(rest >= math.pi, rest < -math.pi, dtype=np.float64)
