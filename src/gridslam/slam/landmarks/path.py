"""Smoothed trajectory of a FastSLAM particle."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.models.odometry_bias import EXACT_ODOMETRY, OdometryBias
from gridslam.slam.landmarks.particles import LandmarkParticles
from gridslam.types import FloatArray, MotionSampler

__all__ = ["smooth_trajectory"]


def smooth_trajectory(
    state: LandmarkParticles, particle: int, motions: Sequence[MotionSampler], bias: OdometryBias = EXACT_ODOMETRY
) -> FloatArray:
    """Trajectory (1 + T, 3) of a particle, map frame: sampled poses, and smoothed poses between them.

    Poses sampled in a local frame are transformed by its final pose, and all sampled poses are corrected by the final
    estimate of the odometry errors. Poses that were not sampled, since nothing was observed, are the means of
    p(x_t | u, the poses sampled before and after), by one pass of a Kalman smoother. For FastSLAM 1.0, which samples
    every pose, the trajectory is the ancestry.

    Parameters
    ----------
    state : LandmarkParticles
    particle : int
        In [0, N).
    motions : sequence of MotionSampler
        The T motions that were taken since the first pose.
    bias : OdometryBias
        The errors of the odometry that the filter learned.

    Source: H. Rauch, F. Tung, C. Striebel, Maximum likelihood estimates of linear dynamic systems, 1965.
    """
    rows = state.ancestry.trajectory(particle)
    poses, local_frames, local_frame_step = rows[:, :3], rows[:, 3:6], rows[:, 6]
    in_local_frame, drawn = rows[:, 7] > 0, rows[:, 8] > 0
    errors = _smooth_bias(poses, rows[:, 9:], len(bias))
    for frame in np.unique(local_frame_step[local_frame_step > 0]).astype(int).tolist():
        mine = local_frame_step == frame
        end = local_frames[mine][-1]
        poses[mine & in_local_frame] = compose(
            end, between(local_frames[mine & in_local_frame], poses[mine & in_local_frame])
        )
        poses[frame] = end  # it came to be where the robot was
    drawn[0] = True
    keys = np.flatnonzero(drawn)
    for begin, end in zip(keys[:-1].tolist(), keys[1:].tolist(), strict=True):
        if end > begin + 1:
            poses[begin + 1 : end] = _interpolate(poses[begin], poses[end], motions[begin:end], bias, errors[begin:end])
    if keys[-1] < len(poses) - 1:  # only the motion constrains these
        for t in range(int(keys[-1]), len(poses) - 1):
            poses[t + 1] = bias.predict(motions[t], np.append(poses[t], errors[t])[None])[0][0, :3]
    return poses


def _smooth_bias(poses: FloatArray, rows: FloatArray, count: int) -> FloatArray:
    """Turn poses (T, 3) by what the odometry's errors (T, B), which it returns, turned out to be at each of them."""
    believed, by_errors, before = np.split(rows, [count, 4 * count], axis=1)
    errors = believed.copy()
    for t in range(len(rows) - 1, 0, -1):
        errors[t - 1] = before[t].reshape(count, 1 + count) @ np.append(1.0, errors[t])
    poses += (by_errors.reshape(len(rows), 3, count) @ (errors - believed)[:, :, None])[:, :, 0]
    poses[:, 2] = wrap(poses[:, 2])
    return errors


def _interpolate(
    begin: FloatArray, end: FloatArray, motions: Sequence[MotionSampler], bias: OdometryBias, errors: FloatArray
) -> FloatArray:
    """Expected poses (K - 1, 3) between two that K motions by an odometry of errors (K, B) are apart."""
    means, covariances, moves = [begin], [np.zeros((3, 3))], list[FloatArray]()
    for motion, known in zip(motions, errors, strict=True):
        (mean,), (F,), (Q,) = bias.predict(motion, np.append(means[-1], known)[None])
        G = F[:3, :3]
        moves.append(G)
        means.append(mean[:3])
        covariances.append(G @ covariances[-1] @ G.T + Q[:3, :3])
    smoothed = np.array(means)
    smoothed[-1] = end
    for t in range(len(motions) - 1, 0, -1):
        gain = covariances[t] @ moves[t].T @ np.linalg.pinv(covariances[t + 1], hermitian=True)
        change = smoothed[t + 1] - means[t + 1]
        change[2] = wrap(change[2])
        smoothed[t] += gain @ change
    smoothed[:, 2] = wrap(smoothed[:, 2])
    return smoothed[1:-1]
