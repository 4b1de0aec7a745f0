"""How the particles are first drawn."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gridslam.arguments import describe, freeze, require_generator, require_instance
from gridslam.checked import checked
from gridslam.errors import ArgumentError
from gridslam.geometry.angles import wrap_headings
from gridslam.types import FloatArray

_MOST = 1 << 30


@checked
def repeat_pose(count: int, pose: ArrayLike) -> FloatArray:
    """Put all particles at one pose: SLAM's map frame is where the robot starts, so nothing is uncertain yet.

    Parameters
    ----------
    count : int >= 1
        Number of particles N.
    pose : (3,) float64
        [x m, y m, theta rad], finite.

    Returns
    -------
    (N, 3) float64

    Raises
    ------
    ArgumentError
        If `count` or `pose` is anything else.
    """
    require_instance("count", count, int, np.integer)
    if not 1 <= count <= _MOST:
        raise ArgumentError("count", f"1 to {_MOST} particles", count)
    mean = freeze(pose, np.float64, (3,), "pose").copy()
    if not np.isfinite(mean).all():
        raise ArgumentError("pose", "finite x, y, theta", mean.tolist())
    return np.tile(wrap_headings(mean), (count, 1))


def copy_poses(particles: object, least: int = 0, expected: str = "finite poses of shape (N, 3)") -> FloatArray:
    """Copy finite poses (N, 3) of particles, N >= `least`, theta wrapped; raises ArgumentError for anything else."""
    try:
        poses: FloatArray = np.array(particles, np.float64)
    except (TypeError, ValueError):
        poses = np.empty(0)
    if poses.ndim != 2 or poses.shape[1] != 3 or len(poses) < least or not np.isfinite(poses).all():
        raise ArgumentError("particles", expected, describe(particles))
    return wrap_headings(poses)


@checked
def sample_gaussian(count: int, pose: ArrayLike, covariance: ArrayLike, rng: np.random.Generator) -> FloatArray:
    """Draw particles from a Gaussian about a pose, theta wrapped around the circle.

    Parameters
    ----------
    count : int >= 1
        Number of particles N.
    pose : (3,) float64
        Mean [x m, y m, theta rad], finite.
    covariance : (3, 3) float64, m^2, m rad, rad^2
        Of the coordinates, in the frame in which `pose` is given; symmetric and positive semidefinite. A variance of 0
        keeps a coordinate fixed.
    rng : numpy.random.Generator

    Returns
    -------
    (N, 3) float64

    Raises
    ------
    ArgumentError
        If an argument is anything else.
    """
    require_generator(rng)
    poses = repeat_pose(count, pose)
    matrix = freeze(covariance, np.float64, (3, 3), "covariance")
    if not np.isfinite(matrix).all():
        raise ArgumentError("covariance", "a finite (3, 3) matrix", matrix.tolist())
    rounding = 1e-12 * np.abs(matrix).max()
    variances, axes = np.linalg.eigh(matrix)
    if np.abs(matrix - matrix.T).max() > rounding or variances[0] < -rounding:
        raise ArgumentError("covariance", "a symmetric matrix without negative eigenvalue", matrix.tolist())
    return wrap_headings(poses + (rng.standard_normal((count, 3)) * np.sqrt(np.maximum(variances, 0.0))) @ axes.T)
