"""Many Gaussians of two and three dimensions at once, in closed form: calling LAPACK for each would take longer."""

from __future__ import annotations

import math

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.kernels import backend
from gridslam.types import FloatArray


def transpose(matrices: FloatArray) -> FloatArray:
    """Transposes (N, j, i) of matrices (N, i, j), copied: products of many small matrices are twice as fast so."""
    return np.ascontiguousarray(matrices.swapaxes(-1, -2))


def transform_covariances(jacobians: FloatArray, covariances: FloatArray) -> FloatArray:
    """J C J' (N, i, i) of Jacobians (N, i, j) and covariances (N, j, j)."""
    return np.asarray(jacobians @ covariances @ transpose(jacobians))


def matvec(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Products (N, i) of matrices (N, i, j) and vectors (N, j)."""
    return np.asarray(np.einsum("nij,nj->ni", matrices, vectors))


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
    """Draw a pose (N, 3) from each Gaussian (N, 3), (N, 3, 3)."""
    drawn = draw(means, covariances, rng)
    drawn[:, 2] = wrap(drawn[:, 2])
    return drawn


def draw(means: FloatArray, covariances: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw a vector (N, i) from each Gaussian (N, i), (N, i, i); variances may be 0."""
    drawn: FloatArray = backend.draw_gaussians(means, covariances, rng.standard_normal(means.shape))
    return drawn
