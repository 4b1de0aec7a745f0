"""Exercise 8: FastSLAM 1.0 and 2.0

*Probabilistic Robotics*, Tables 13.1 (`FastSLAM_1.0_known_correspondences`) and 13.3 (`FastSLAM_2.0`).
"""

# %% [markdown]
# Given the path, landmarks are independent of each other. So each particle samples the path, and has a small Kalman
# filter for each landmark. With $S = H_m \Sigma H_m^\top + Q$ of a particle's landmark:
#
# $$ K = \Sigma H_m^\top S^{-1}, \quad \mu \leftarrow \mu + K (z - h), \quad \Sigma \leftarrow (I - K H_m) \Sigma, \quad
# w \leftarrow w \, N(z; h, S) $$
#
# Write it for all particles at once: NumPy's `@`, `inv`, `det` and gridslam's sensor models take stacks of matrices.

# %%
import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam.models.landmark import LandmarkObservations, RangeBearing
from gridslam.models.motion import GaussianIncrement


# %% [task]
def log_density(residual, S):
    """Log density of a Gaussian N(0, S) at residuals (N, 2) with covariances (N, 2, 2): (N,) nats."""
    solved = np.linalg.solve(S, residual[..., None])
    return -0.5 * (residual[:, None] @ solved)[:, 0, 0] - 0.5 * np.log(np.linalg.det(2 * np.pi * S))


def update_landmarks(means, covariances, sensor, poses, z, Q):
    """Update one landmark in all particles by an observation.

    Parameters
    ----------
    means, covariances : (N, 2), (N, 2, 2) float64
        Of the landmark, in each particle.
    sensor : LandmarkModel
        `h, H_x, H_m = sensor.linearize(poses, means)`, of shapes (N, 2), (N, 2, 3), (N, 2, 2).
    poses : (N, 3) float64
    z, Q : (2,), (2, 2) float64
        The observation and its covariance.

    Returns
    -------
    means, covariances : (N, 2), (N, 2, 2) float64
    log_weights : (N,) float64
        log N(z; h, S).
    """
    h, _, H_m = sensor.linearize(poses, means)
    S = H_m @ covariances @ H_m.swapaxes(1, 2) + Q
    K = covariances @ H_m.swapaxes(1, 2) @ np.linalg.inv(S)
    residual = sensor.residual(z, h)
    updated = means + (K @ residual[..., None])[..., 0]
    return updated, (np.eye(2) - K @ H_m) @ covariances, log_density(residual, S)


# %% [markdown]
# FastSLAM 1.0 samples the motion model, weighs and updates. (A landmark observed first starts at $h^{-1}(x, z)$ with
# covariance $H_m^{-1} Q H_m^{-\top}$.) Resampling is left to exercise 5; the check needs the weights.


# %%
def fastslam(sensor, steps, count, rng, propose=None):
    """Weights, poses, landmarks and covariances; FastSLAM 2.0 if there is a proposal."""
    poses, log_weights = np.zeros((count, 3)), np.zeros(count)
    total = 1 + max(name for step in steps for name in step.names)
    means, covariances, known = np.zeros((count, total, 2)), np.zeros((count, total, 2, 2)), set()
    for step in steps:
        motion = GaussianIncrement.with_covariance(step.increment, step.noise)
        observed = list(zip(step.names, step.z, sensor.noise(LandmarkObservations.of(step.z)), strict=True))
        old = [one for one in observed if one[0] in known]
        if propose and old:
            centres, spreads = motion.moments(poses)
            for j, z, Q in old:
                centres, spreads, log_w = propose(centres, spreads, sensor, means[:, j], covariances[:, j], z, Q)
                log_weights += log_w
            values, axes = np.linalg.eigh(spreads)
            roots = axes * np.sqrt(np.maximum(values, 0))[:, None]
            poses = centres + (roots @ rng.standard_normal((count, 3, 1)))[..., 0]
        else:
            poses = motion(poses, rng)
        for j, z, Q in observed:
            if j in known:
                means[:, j], covariances[:, j], log_w = update_landmarks(
                    means[:, j], covariances[:, j], sensor, poses, z, Q
                )
                log_weights += 0 if propose else log_w
            else:
                means[:, j] = sensor.locate(poses, np.tile(z, (count, 1)))
                inverse = np.linalg.inv(sensor.linearize(poses, means[:, j])[2])
                covariances[:, j] = inverse @ Q @ inverse.swapaxes(1, 2)
                known.add(j)
    weights = np.exp(log_weights - log_weights.max())
    return weights / weights.sum(), poses, means, covariances


# %%
checks.log_densities(log_density)
checks.landmark_update(update_landmarks)
checks.particles_find_the_kalman_filter(fastslam)
print("passed")

# %% [markdown]
# FastSLAM 2.0 samples from a proposal that includes the observation. With the pose predicted as $N(\mu, R)$:
#
# $$ S = H_m \Sigma H_m^\top + Q, \quad L = H_x R H_x^\top + S, \quad K = R H_x^\top L^{-1}, \quad \mu \leftarrow \mu
# + K (z - h), \quad R \leftarrow (I - K H_x) R $$
#
# and the weight is the likelihood of the observation *before* the pose is known: $N(z; h, L)$. (The book writes the
# same with inverse covariances.)


# %% [task]
def propose(centres, spreads, sensor, means, covariances, z, Q):
    """Include an observation in the Gaussian from which poses are sampled.

    Parameters
    ----------
    centres, spreads : (N, 3), (N, 3, 3) float64
        The pose as predicted, in each particle.
    sensor, means, covariances, z, Q
        As of `update_landmarks`.

    Returns
    -------
    centres, spreads : (N, 3), (N, 3, 3) float64
    log_weights : (N,) float64
        log N(z; h, L).
    """
    h, H_x, H_m = sensor.linearize(centres, means)
    S = H_m @ covariances @ H_m.swapaxes(1, 2) + Q
    L = H_x @ spreads @ H_x.swapaxes(1, 2) + S
    K = spreads @ H_x.swapaxes(1, 2) @ np.linalg.inv(L)
    residual = sensor.residual(z, h)
    moved = centres + (K @ residual[..., None])[..., 0]
    return moved, (np.eye(3) - K @ H_x) @ spreads, log_density(residual, L)


# %%
def fastslam2(sensor, steps, count, rng):
    """FastSLAM 2.0."""
    return fastslam(sensor, steps, count, rng, propose)


checks.proposal(propose)
checks.particles_find_the_kalman_filter(fastslam2)
print("passed")

# %% [markdown]
# With an exact sensor most samples of the motion model are far from the posterior; those of the proposal are not.

# %%
steps, truth = checks.drive_in_a_circle(np.random.default_rng(2), 20)
sigmas = np.geomspace(0.01, 0.3, 8)
for run in (fastslam, fastslam2):
    found = [run(RangeBearing(s, s / 5), steps, 500, np.random.default_rng(0))[0] for s in sigmas]
    plt.semilogx(sigmas, [1 / np.square(w).sum() for w in found])
plt.legend(["FastSLAM 1.0", "FastSLAM 2.0"])
plt.xlabel("standard deviation of the range, m")
plt.ylabel("effective sample size of 500")
plt.show()
