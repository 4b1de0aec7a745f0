"""Consistency of an estimator: the normalized estimation error squared (NEES)."""

from __future__ import annotations

import numpy as np

from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap
from gridslam.types import FloatArray


@checked
def nees(estimates: FloatArray, truths: FloatArray, covariances: FloatArray) -> FloatArray:
    """Normalized estimation error squared e' P^-1 e of each pose, e = [dx, dy, dtheta] in the world frame.

    Parameters
    ----------
    estimates, truths : (N, 3) float64
        Poses in one frame.
    covariances : (N, 3, 3) float64
        What the estimator claims, positive definite.

    Returns
    -------
    (N,) float64
        Chi-square distributed with 3 degrees of freedom where the claim is true.

    Raises
    ------
    ArgumentError
        A covariance is not positive definite.

    References
    ----------
    Y. Bar-Shalom, X. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), 5.4.2.
    """
    errors = estimates - truths
    errors[:, 2] = wrap(errors[:, 2])
    try:
        roots = np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:
        raise ArgumentError("covariances", "positive definite matrices", "one that is not") from None
    whitened = np.linalg.solve(roots, errors[:, :, None])
    return np.asarray(np.square(whitened[:, :, 0]).sum(axis=1))
