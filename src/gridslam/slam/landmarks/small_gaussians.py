"""Many Gaussians of two and three dimensions at once, in closed form: calling LAPACK for each would take longer."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.angles import wrap_headings
from gridslam.types import FloatArray, IntArray


def transform_covariances(jacobians: FloatArray, covariances: FloatArray) -> FloatArray:
    """J C J' (N, i, i) of Jacobians (N, i, j) and covariances (N, j, j), or one for all."""
    transposed = np.ascontiguousarray(jacobians.swapaxes(-1, -2))  # products are twice as fast with a copy
    return np.asarray(jacobians @ covariances @ transposed)


def kalman_update(
    means: FloatArray,
    covariances: FloatArray,
    rows: IntArray,
    jacobians: FloatArray,
    innovations: FloatArray,
    residuals: FloatArray,
) -> None:
    """Condition R of X Gaussians, all different, on an observation of two numbers each; writes to them.

    Parameters
    ----------
    means, covariances : (X, D), (X, D, D) float64
    rows : (R,) int64
        Which.
    jacobians : (R, 2, D) float64
        H.
    innovations, residuals : (R, 2, 2), (R, 2) float64
        S, of full rank, and z - h: K = P H' S^-1 is Kalman's gain.
    """
    before = covariances[rows]
    shared = before @ jacobians.swapaxes(1, 2)
    gains = shared @ inverse_2x2(innovations)
    covariances[rows] = before - gains @ shared.swapaxes(1, 2)
    means[rows] += (gains @ residuals[..., None])[..., 0]


def inverse_2x2(matrices: FloatArray) -> FloatArray:
    """Inverses (..., 2, 2) of matrices (..., 2, 2)."""
    a, b, c, d = (matrices[..., i, j] for i in (0, 1) for j in (0, 1))
    adjugate = np.stack([d, -b, -c, a], axis=-1).reshape(matrices.shape)
    return np.asarray(adjugate / (a * d - b * c)[..., None, None])


def mahalanobis(residuals: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squared Mahalanobis distances (...) of residuals (..., 2), and log determinants (...) of the covariances."""
    a, b, _, d = (covariances[..., i, j] for i in (0, 1) for j in (0, 1))
    x, y = (residuals[..., i] for i in (0, 1))
    determinant = a * d - b * b
    return np.asarray((d * x * x - 2 * b * x * y + a * y * y) / determinant), np.log(determinant)


def log_density(squared: FloatArray | float, log_dets: FloatArray) -> FloatArray:
    """Compute log N (...) in nats from the result of `mahalanobis`."""
    return np.asarray(-0.5 * (squared + log_dets) - math.log(2 * math.pi))


def draw_poses(means: FloatArray, covariances: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw a pose (N, 3) from each Gaussian (N, 3), (N, 3, 3); variances may be 0.

    Cholesky's factor comes column by column, and each takes away what it explains.
    """
    drawn = means.T.copy()
    left = covariances.transpose(1, 2, 0).copy()  # loops run along the Gaussians
    for i, number in enumerate(rng.standard_normal(means.shape).T):
        sigma = np.sqrt(np.maximum(left[i, i], 0.0))
        column = np.divide(left[i], sigma, out=np.zeros_like(left[i]), where=sigma > 0)  # no variance, no covariance
        drawn += number * column
        left -= column[:, None] * column
    return wrap_headings(np.ascontiguousarray(drawn.T))
