"""Exercise 7: EKF SLAM

*Probabilistic Robotics*, Table 10.1 (`EKF_SLAM_known_correspondences`).
"""

# %% [markdown]
# The state is the pose and all landmarks, $y = (x, y, \theta, m_1, m_2, \ldots)$, with one covariance $P$. Motion
# moves the pose only, but its errors become correlated with all landmarks:
#
# $$ \bar P = F P F^\top + N, \qquad F = \begin{pmatrix} G & 0 \\ 0 & I \end{pmatrix}, \quad N = \begin{pmatrix} V M
# V^\top & 0 \\ 0 & 0 \end{pmatrix} $$
#
# An observation of landmark $j$ has the Jacobian $H = (H_x, 0, \ldots, H_m, \ldots, 0)$, and corrects *everything*. The
# first observation of a landmark adds it: at $m = h^{-1}(x, z)$, with
#
# $$ A = -H_m^{-1} H_x, \qquad P_{mm} = A P_{xx} A^\top + H_m^{-1} Q H_m^{-\top}, \qquad P_{my} = A P_{xy} $$
#
# `sensor` gives $h$ and its Jacobians: `h, H_x, H_m = sensor.linearize(pose, landmark)`; the innovation
# `sensor.residual(z, h)`, with bearings in $[-\pi, \pi)$; and $h^{-1}$: `sensor.locate(pose, z)`.

# %%
import math

import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.geometry.se2 import compose
from gridslam.models.landmark import LandmarkObservations, RangeBearing


# %% [task]
def predict(mean, P, increment, noise):
    """Move the pose of the state.

    Parameters
    ----------
    mean, P : (3 + 2 L,), (3 + 2 L, 3 + 2 L) float64
        Pose and landmarks, and their covariance.
    increment, noise : (3,), (3, 3) float64
        Increment in the frame of the robot, and its covariance.

    Returns
    -------
    mean, P
        Of the same shapes.
    """
    c = math.cos(mean[2])
    s = math.sin(mean[2])
    dx, dy, _ = increment
    F = np.eye(len(mean))
    F[:2, 2] = -s * dx - c * dy, c * dx - s * dy
    V = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    moved = np.concatenate([compose(mean[:3], increment), mean[3:]])
    P = F @ P @ F.T
    P[:3, :3] += V @ noise @ V.T
    return moved, P


def add_landmark(mean, P, sensor, z, Q):
    """Append a landmark that is observed for the first time.

    Parameters
    ----------
    mean, P : (3 + 2 L,), (3 + 2 L, 3 + 2 L) float64
    sensor : LandmarkModel
    z, Q : (2,), (2, 2) float64
        The observation and its covariance.

    Returns
    -------
    mean, P
        With two more rows, and columns.
    """
    landmark = sensor.locate(mean[:3], z)
    _, H_x, H_m = sensor.linearize(mean[:3], landmark)
    inverse = np.linalg.inv(H_m)
    A = -inverse @ H_x
    across = A @ P[:3]
    own = A @ P[:3, :3] @ A.T + inverse @ Q @ inverse.T
    return np.concatenate([mean, landmark]), np.block([[P, across.T], [across, own]])


def correct(mean, P, sensor, j, z, Q):
    """Correct the state by an observation of the landmark j, counted from 0 in the order of the state.

    Parameters and results as of `add_landmark`, of the shapes of the state; heading in [-pi, pi).
    """
    at = slice(3 + 2 * j, 5 + 2 * j)
    h, H_x, H_m = sensor.linearize(mean[:3], mean[at])
    H = np.zeros((2, len(mean)))
    H[:, :3] = H_x
    H[:, at] = H_m
    S = H @ P @ H.T + Q
    K = P @ H.T @ np.linalg.inv(S)
    mean = mean + K @ sensor.residual(z, h)
    mean[2] = math.remainder(mean[2], math.tau)
    P = (np.eye(len(mean)) - K @ H) @ P
    return mean, (P + P.T) / 2


# %%
def ekf_slam(sensor, steps):
    """Mean and covariance after all steps; landmarks in the order of first observation."""
    mean, P, place = np.zeros(3), np.zeros((3, 3)), {}
    for step in steps:
        mean, P = predict(mean, P, step.increment, step.noise)
        noises = sensor.noise(LandmarkObservations.of(step.z.reshape(-1, 2)))
        for name, z, Q in zip(step.names, step.z, noises, strict=True):
            if name in place:
                mean, P = correct(mean, P, sensor, place[name], z, Q)
            else:
                place[name] = len(place)
                mean, P = add_landmark(mean, P, sensor, z, Q)
    return mean, P


# %% [markdown]
# Each function is compared with numerical derivatives. Where all is linear, the result must be that of the Kalman
# filter. Otherwise its errors must be as large as its covariance states.

# %%
checks.slam_prediction(predict)
checks.landmark_is_added(add_landmark)
checks.slam_correction(correct)
checks.slam_is_the_kalman_filter(ekf_slam)
checks.ring_is_mapped(ekf_slam)
print("passed")

# %% [markdown]
# Standard deviations of the landmarks over time. A landmark is at first as uncertain as the robot. When the loop closes
# the robot becomes certain, and with it, by the correlations, all landmarks.

# %%
steps, truth = checks.drive_in_a_circle(np.random.default_rng(1), 190)
counts = np.arange(5, 190, 5)
sigmas = np.full((len(counts), len(checks.RING)), np.nan)
for row, count in zip(sigmas, counts, strict=True):
    _, P = ekf_slam(RangeBearing(sigma_range_m=0.1, sigma_bearing_rad=0.02), steps[:count])
    variances = np.diag(P)[3:].reshape(-1, 2).sum(axis=1)
    row[: len(variances)] = np.sqrt(variances)
plt.plot(counts, sigmas)
plt.xlabel("step")
plt.ylabel("standard deviation of a landmark, m")
plt.show()
