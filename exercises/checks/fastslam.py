"""Checks of exercise 8: FastSLAM."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from feedback import expect, require
from numpy.typing import NDArray

from checks.ekf_slam import LandmarkMeasurements
from gridslam.models.landmark import LandmarkModel, LandmarkObservations, RangeBearing, RelativePosition
from gridslam.models.motion import GaussianIncrement
from gridslam.slam.landmarks.ekf_slam import EkfSlam

FloatArray = NDArray[np.float64]
Rng = np.random.Generator


Particles = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""Weights (N,), poses (N, 3), landmarks (N, L, 2) by name, and their covariances (N, L, 2, 2)."""
FastSlamRun = Callable[[LandmarkModel, Sequence[LandmarkMeasurements], int, Rng], Particles]


Landmarks = tuple[FloatArray, FloatArray, FloatArray]
"""Means, covariances and log weights (N,)."""


def _density(residual: FloatArray, S: FloatArray) -> FloatArray:
    squared = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(S), residual)
    return np.asarray(-0.5 * squared - 0.5 * np.log(np.linalg.det(math.tau * S)))


def log_densities(log_density: Callable[[FloatArray, FloatArray], FloatArray]) -> None:
    """`log_density(residual, S)` -> (N,) nats: the normal density of each residual (2,) with its covariance."""
    residual, S = np.random.default_rng(8).normal(0, 0.3, (5, 2)), _stack(0.3, 5)
    squared = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(S), residual)
    determinant = np.log(np.linalg.det(S))
    right = _density(residual, S)
    wrong = {
        "the exponent has a factor of 1/2": right - 0.5 * squared,
        "the normalizer is missing: - 1/2 log det(2 pi S)": -0.5 * squared,
        "the normalizer has det(2 pi S), (2 pi)^2 det S of a 2 x 2 matrix": -0.5 * squared - 0.5 * determinant,
        "the normalizer has det(2 pi S), (2 pi)^2 det S of a 2 x 2 matrix ": (
            -0.5 * squared - 0.5 * np.log(math.tau) - 0.5 * determinant
        ),
        "the normalizer has the square root of the determinant": -0.5 * squared - np.log(np.linalg.det(math.tau * S)),
        "the sign of the normalizer is wrong": -0.5 * squared + 0.5 * np.log(np.linalg.det(math.tau * S)),
        "the residual is multiplied with the inverse of S": (
            right + 0.5 * squared - 0.5 * np.einsum("ni,nij,nj->n", residual, S, residual)
        ),
        "expected a log density, got a density": np.exp(right),
        "the sign of the exponent is wrong": right + squared,
    }
    expect("log density", log_density(residual, S), right, 1e-9, wrong)


def _stack(sigma: float, count: int = 6, size: int = 2) -> FloatArray:
    roots = sigma * (np.eye(size) + 0.3 * np.random.default_rng(9).normal(size=(count, size, size)))
    return np.asarray(roots @ roots.swapaxes(1, 2))


def _observed() -> tuple[RangeBearing, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Sensor, poses (6, 3), one landmark in six particles, and an observation of it, behind the robots."""
    rng = np.random.default_rng(10)
    poses = np.column_stack([rng.normal(0, 0.3, (6, 2)), rng.normal(0.02, 0.02, 6)])
    means = np.array([-4.0, 0.05]) + rng.normal(0, 0.2, (6, 2))
    return (
        RangeBearing(0.2, 0.05),
        poses,
        means,
        _stack(0.4),
        np.array([4.1, -math.pi + 0.02]),
        np.diag([0.04, 0.0025]),
    )


def landmark_update(
    update: Callable[[FloatArray, FloatArray, LandmarkModel, FloatArray, FloatArray, FloatArray], Landmarks],
) -> None:
    """`update(means, covariances, sensor, poses, z, Q)`: a Kalman filter for the landmark of each particle."""
    sensor, poses, means, covariances, z, Q = _observed()
    h, _, H_m = sensor.linearize(poses, means)
    T = H_m.swapaxes(1, 2)
    S = H_m @ covariances @ T + Q
    K = covariances @ T @ np.linalg.inv(S)
    residual = sensor.residual(z, h)

    def moved(K: FloatArray, residual: FloatArray) -> FloatArray:
        return np.asarray((K @ residual[..., None])[..., 0])

    noiseless = covariances @ T @ np.linalg.inv(H_m @ covariances @ T)
    alone = covariances @ T @ np.linalg.inv(np.tile(Q, (6, 1, 1)))
    found, shrunk, log_weights = update(means.copy(), covariances.copy(), sensor, poses, z, Q)
    expect(
        "change of the landmark",
        np.asarray(found) - means,
        moved(K, residual),
        1e-9,
        {
            "differences of bearings must be wrapped: `sensor.residual(z, h)`": moved(K, z - h),
            "the innovation is the measurement less the prediction, z - h": -moved(K, residual),
            "the noise Q of the observation belongs in S": moved(noiseless, residual),
            "S has the uncertainty of the landmark, H_m Sigma H_m'": moved(alone, residual),
            "the landmark moves by K times the innovation": np.zeros((6, 2)),
        },
    )
    expect(
        "covariance of the landmark",
        shrunk,
        (np.eye(2) - K @ H_m) @ covariances,
        1e-9,
        {
            "the covariance shrinks: (I - K H_m) Sigma": covariances,
            "(I - K H_m) Sigma, with a minus sign": (np.eye(2) + K @ H_m) @ covariances,
            "I - K H_m is multiplied with Sigma": np.eye(2) - K @ H_m,
        },
    )
    after = sensor.residual(z, sensor.linearize(poses, means + moved(K, residual))[0])
    wrong = {
        "the weight is the density of the observation before the landmark is corrected": _density(after, S),
        "the weight has the covariance S of the innovation, not the noise Q alone": _density(residual, 0 * S + Q),
        "the weight multiplies: its logarithm is log N(z; h, S), not 0": np.zeros(6),
        "the weight is a logarithm": np.exp(_density(residual, S)),
        "the weight is N(z; h, S): the normalizer is missing": _density(residual, S)
        + 0.5 * np.log(np.linalg.det(math.tau * S)),
    }
    expect("log weight", log_weights, _density(residual, S), 1e-9, wrong)


def proposal(propose: Callable[..., Landmarks]) -> None:
    """`propose(centres, spreads, sensor, means, covariances, z, Q)`: the Gaussian of the pose given the observation."""
    sensor, poses, means, covariances, z, Q = _observed()
    spreads = _stack(0.1, size=3)
    h, H_x, H_m = sensor.linearize(poses, means)
    T = H_x.swapaxes(1, 2)
    S = H_m @ covariances @ H_m.swapaxes(1, 2) + Q
    L = H_x @ spreads @ T + S
    residual = sensor.residual(z, h)
    gain = spreads @ T

    def moved(L: FloatArray, residual: FloatArray = residual) -> FloatArray:
        return np.asarray((gain @ np.linalg.inv(L) @ residual[..., None])[..., 0])

    found, narrowed, log_weights = propose(poses.copy(), spreads.copy(), sensor, means, covariances, z, Q)
    expect(
        "change of the centre",
        np.asarray(found) - poses,
        moved(L),
        1e-9,
        {
            "differences of bearings must be wrapped: `sensor.residual(z, h)`": moved(L, z - h),
            "the innovation is the measurement less the prediction, z - h": -moved(L),
            "K has the inverse of L, which includes the uncertainty of the pose, not that of S": moved(S),
            "L includes the uncertainty of the landmark: S, not Q alone": moved(L - S + Q),
            "L includes the noise of the observation": moved(L - Q),
            "the centre moves by K times the innovation": np.zeros((6, 3)),
        },
    )
    K = gain @ np.linalg.inv(L)
    expect(
        "covariance of the proposal",
        narrowed,
        (np.eye(3) - K @ H_x) @ spreads,
        1e-9,
        {
            "the observation narrows the proposal: (I - K H_x) R": spreads,
            "(I - K H_x) R, with a minus sign": (np.eye(3) + K @ H_x) @ spreads,
        },
    )
    squared = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(L), residual)
    after = sensor.residual(z, sensor.linearize(poses + moved(L), means)[0])
    expect(
        "log weight",
        log_weights,
        _density(residual, L),
        1e-9,
        {
            "the weight is that before the pose is known: its covariance is L, not S": _density(residual, S),
            "the weight is N(z; h, L): the normalizer is missing": -0.5 * squared,
            "the weight multiplies: its logarithm is log N(z; h, L), not 0": np.zeros(6),
            "the weight is that before the pose is known: h is predicted from the centre before": _density(after, L),
            "the weight has the covariance L, not the noise Q alone": _density(residual, 0 * L + Q),
        },
    )


def particles_find_the_kalman_filter(run: FastSlamRun) -> None:
    """A robot that cannot turn and measures positions: the posterior of 20,000 particles is EKF SLAM's.

    Means err by sigma / sqrt(N_eff) = 0.3 / sqrt(1000) = 0.01 m; five times that. Variances by sqrt(2 / N_eff), 5 %.
    Resampling is left out: the weights are those of all measurements.
    """
    sensor = RelativePosition(sigma_x_m=0.3, sigma_y_m=0.3)
    increment = np.array([0.5, 0.0, 0.0])
    noise = np.diag(np.square([0.2, 0.2, 0.0]))
    seen = np.random.default_rng(8)
    ekf = EkfSlam(sensor)
    state = ekf.init()
    steps = []
    for k in range(4):
        z = np.array([[6.0, 1.0], [3.0, -2.0]]) - [0.5 * k, 0] + seen.normal(0, 0.3, (2, 2))
        steps.append(LandmarkMeasurements(increment, noise, [0, 1], z))
        motion = GaussianIncrement.with_covariance(increment, noise)
        state, _ = ekf.step(state, motion, LandmarkObservations.of(z, [0, 1]))
    expected = ekf.landmark_map(state)
    weights, poses, positions, covariances = run(sensor, steps, 20_000, np.random.default_rng(7))
    require(abs(weights.sum() - 1) < 1e-9, "the weights do not sum to 1")
    require(1 / np.square(weights).sum() > 1000, "fewer than 1000 effective particles")
    mean = np.einsum("n,nlk->lk", weights, positions)
    away = positions - mean
    spread = np.einsum("n,nlj,nlk->ljk", weights, away, away) + np.einsum("n,nljk->ljk", weights, covariances)
    expect("landmarks, against EKF SLAM", mean, expected.positions, 0.05)
    wide = 0.2 * expected.covariances.max()
    expect("covariances of the landmarks, against EKF SLAM", spread, expected.covariances, wide)
    expect("pose, against EKF SLAM", weights @ poses, state.pose, 0.05)
    away = poses - weights @ poses
    spread = np.einsum("n,nj,nk->jk", weights, away, away)
    wide = 0.2 * state.pose_covariance.max()
    expect("covariance of the pose, against EKF SLAM", spread, state.pose_covariance, wide)
