"""How the particles of FastSLAM 2.0 move, and what becomes of what they know of the odometry's errors."""

from __future__ import annotations

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.models.odometry_bias import OdometryBias
from gridslam.slam.landmarks.particles import LandmarkParticles
from gridslam.slam.landmarks.small_gaussians import draw, matvec, transform_covariances, transpose
from gridslam.types import FloatArray, MotionSampler

__all__ = ["predict"]


def predict(
    state: LandmarkParticles, bias: OdometryBias, motion: MotionSampler, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Predict where the particles are, and how the odometry errs from now on.

    Pose and landmarks lean on the errors b that were. Of those, b = c + G b' of the errors b' that are now and a rest
    that is independent of b'. The rest is drawn, so that all comes to lean on b' alone: by the derivatives times G.

    Parameters
    ----------
    state : LandmarkParticles
        Its landmarks move with what is drawn.
    bias : OdometryBias
        The errors that are learned, perhaps none.
    motion : MotionSampler
        The motion model, conditioned on the odometry.
    rng : numpy.random.Generator

    Returns
    -------
    mean, spread : (N, 3 + B), (N, 3 + B, 3 + B) float64
        Of poses and errors.
    """
    mean, F, Q = bias.predict(motion, state.state_means)
    before = state.state_covariances
    spread = Q + transform_covariances(F, before) if before.any() else Q  # drawn poses have none
    if not len(bias):
        return mean, spread
    back = state.state_covariances[:, 3:, 3:] @ np.linalg.inv(spread[:, 3:, 3:])
    rest = back @ Q[:, 3:, 3:]
    rest = (rest + transpose(rest)) / 2
    G = back @ F[:, 3:, 3:]
    drawn = draw(np.zeros((len(state), len(bias))), rest, rng)
    by_bias = F[:, :3, :3] @ state.pose_by_bias + F[:, :3, 3:]
    mean[:, :3] += matvec(by_bias, drawn)
    mean[:, 2] = wrap(mean[:, 2])
    spread[:, :3, :3] -= transform_covariances(by_bias, rest)
    leaning = state.positions_by_bias.reshape(len(state), -1, len(bias))  # few products of larger matrices: faster
    state.positions += (leaning @ drawn[:, :, None]).reshape(state.positions.shape)
    state.positions_by_bias = (leaning @ G).reshape(state.positions_by_bias.shape)
    state.bias_before[..., 0], state.bias_before[..., 1:] = state.state_means[:, 3:] - matvec(G, mean[:, 3:]) + drawn, G
    return mean, spread
