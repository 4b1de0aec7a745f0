"""A FastSLAM particle's trajectory, told from the end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gridslam.geometry.angles import wrap
from gridslam.geometry.se2 import between, compose
from gridslam.slam.landmark_particles import LandmarkParticles
from gridslam.types import FloatArray, MotionSampler

__all__ = ["path"]


def path(state: LandmarkParticles, particle: int, motions: Sequence[MotionSampler]) -> FloatArray:
    """Trajectory (1 + T, 3) of a particle, map frame: what was drawn, and between that what is to be expected.

    What was drawn on a raft is told from where the raft came to lie. Poses that were not drawn, since nothing was seen,
    are the means of p(x_t | u, the poses drawn before and after), by one pass of a Kalman smoother. With FastSLAM 1.0,
    which draws every pose, it is the ancestry; with errors of the odometry that are learned, too.

    Parameters
    ----------
    state : LandmarkParticles
    particle : int
        In [0, N).
    motions : sequence of MotionSampler
        The T motions that were taken since the first pose.

    Source: H. Rauch, F. Tung, C. Striebel, Maximum likelihood estimates of linear dynamic systems, 1965.
    """
    rows = state.ancestry.trajectory(particle)
    if state.known.shape[1] > 3:  # the motions are not those of an odometry without errors
        return rows[:, :3]
    poses, rafts, launched, aboard, drawn = rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7] > 0, rows[:, 8] > 0
    for raft in np.unique(launched[launched > 0]).astype(int).tolist():
        mine = launched == raft
        end = rafts[mine][-1]
        poses[mine & aboard] = compose(end, between(rafts[mine & aboard], poses[mine & aboard]))
        poses[raft] = end  # it came to be where the robot was
    drawn[0] = True
    keys = np.flatnonzero(drawn)
    for begin, end in zip(keys[:-1].tolist(), keys[1:].tolist(), strict=True):
        if end > begin + 1:
            poses[begin + 1 : end] = _between(poses[begin], poses[end], motions[begin:end])
    if keys[-1] < len(poses) - 1:  # nothing tells of these but the motion
        for t in range(int(keys[-1]), len(poses) - 1):
            poses[t + 1] = motions[t].moments(poses[t : t + 1])[0][0]
    return poses


def _between(begin: FloatArray, end: FloatArray, motions: Sequence[MotionSampler]) -> FloatArray:
    """Expected poses (K - 1, 3) between two that K motions are apart."""
    means, covariances, moves = [begin], [np.zeros((3, 3))], list[FloatArray]()
    for motion in motions:
        (mean,), (noise,) = motion.moments(means[-1][None])
        G = np.eye(3)
        G[:2, 2] = means[-1][1] - mean[1], mean[0] - means[-1][0]
        moves.append(G)
        means.append(mean)
        covariances.append(G @ covariances[-1] @ G.T + noise)
    smoothed = np.array(means)
    smoothed[-1] = end
    for t in range(len(motions) - 1, 0, -1):
        gain = covariances[t] @ moves[t].T @ np.linalg.pinv(covariances[t + 1], hermitian=True)
        change = smoothed[t + 1] - means[t + 1]
        change[2] = wrap(change[2])
        smoothed[t] += gain @ change
    smoothed[:, 2] = wrap(smoothed[:, 2])
    return smoothed[1:-1]
