"""Exercise 5: Monte Carlo localization

*Probabilistic Robotics*, Tables 4.4 (`Low_variance_sampler`) and 8.2 (`MCL`).
"""

# %% [markdown]
# **Resampling.** Lay $N$ weights end to end on a line of length 1, and take the particles at the points
#
# $$ \frac{r + k}{n}, \qquad k = 0, \ldots, n - 1, \quad r \sim U[0, 1) $$
#
# One random number serves for all points, so a particle of weight $w$ is drawn $\lfloor n w \rfloor$ or
# $\lceil n w \rceil$ times, and $n w$ times on average.

# %%
import checks
import matplotlib.pyplot as plt
import numpy as np

from gridslam import KnownMap
from gridslam.geometry.se2 import between
from gridslam.models import LikelihoodField, OdometryMotion


# %% [task]
def low_variance_resampling(weights, size, rng):
    """Draw particles in proportion to their weights.

    Parameters
    ----------
    weights : (N,) float64
        At least 0, of any scale.
    size : int
        How many are drawn.
    rng : numpy.random.Generator

    Returns
    -------
    (size,) int64
        Indices in [0, N), ascending.
    """
    ends = np.cumsum(weights)
    points = (rng.random() + np.arange(size)) * (ends[-1] / size)
    return np.searchsorted(ends, np.minimum(points, np.nextafter(ends[-1], 0)), side="right")


# %%
checks.low_variance_resampler(low_variance_resampling)
print("passed")

# %% [markdown]
# **MCL.** Each particle is a pose. Move it by the motion model, weigh it by the measurement model, and resample:
#
# $$ x_t^{[k]} \sim p(x_t \mid u_t, x_{t-1}^{[k]}), \qquad w^{[k]} \propto p(z_t \mid x_t^{[k]}, m) $$
#
# Log likelihoods of a scan reach hundreds of nats: subtract the largest before the exponential.


# %% [task]
def mcl_step(poses, sampler, log_likelihood, rng):
    """One step of Monte Carlo localization.

    Parameters
    ----------
    poses : (N, 3) float64
        Particles [x m, y m, theta rad].
    sampler : callable
        `sampler(poses, rng)` draws a successor of each pose.
    log_likelihood : callable
        `log_likelihood(poses)` -> (N,) float64, nats.
    rng : numpy.random.Generator

    Returns
    -------
    (N, 3) float64
        Particles after resampling.
    """
    moved = sampler(poses, rng)
    log_weights = log_likelihood(moved)
    weights = np.exp(log_weights - log_weights.max())
    return moved[low_variance_resampling(weights, len(moved), rng)]


# %% [markdown]
# The loop around it uses gridslam's models. It keeps 300 particles and reports their mean.

# %%
MOTION = OdometryMotion(alpha1=0.05, alpha2=0.02, alpha3=0.02, alpha4=0.02)
SENSOR = LikelihoodField(tempering=0.1)


def localize(grid, measurements, pose, rng):
    """Poses (T, 3) of all measurements, from a first pose."""
    known = KnownMap(grid)
    poses = pose + rng.normal(0, [0.1, 0.1, 0.05], (300, 3))
    before, estimates = measurements[0].odometry.pose, []
    for odometry, scan in measurements:
        weigh = SENSOR(scan.beams(0.05, 30.0))

        def log_likelihood(poses, weigh=weigh):
            return weigh(known, np.zeros(len(poses), np.int32), poses)

        poses = mcl_step(poses, MOTION(between(before, odometry.pose)), log_likelihood, rng)
        before = odometry.pose
        heading = np.arctan2(np.sin(poses[:, 2]).mean(), np.cos(poses[:, 2]).mean())
        estimates.append([*poses[:, :2].mean(axis=0), heading])
    return np.array(estimates)


# %%
checks.robot_is_tracked(localize)
print("passed")

# %%
grid, log = checks.office_map(), checks.office(2)
found = localize(grid, log.measurements[40:140], log.truth.poses[40], np.random.default_rng(0))
height, width = grid.known.shape
x, y = grid.origin
box = [x, x + width * grid.resolution_m, y, y + height * grid.resolution_m]
plt.imshow(np.where(grid.known, 1 - grid.probability, np.nan), origin="lower", cmap="gray", extent=box)
plt.plot(*log.truth.poses[40:140, :2].T, "k", *found[:, :2].T, "C1")
plt.legend(["truth", "mean of the particles"])
plt.show()
