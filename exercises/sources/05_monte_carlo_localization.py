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


# %% [markdown]
# A resampling wheel is right as well: it turns by random steps, uniform between 0 and twice the greatest weight. The
# check states which of the two it has found.

# %%
print(checks.resampling(low_variance_resampling))
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


# %%
checks.mcl_weights(mcl_step)
print("passed")

# %% [markdown]
# The loop around it uses gridslam's models. It keeps 300 particles and reports their mean.

# %%
MOTION = OdometryMotion(alpha1=0.05, alpha2=0.02, alpha3=0.02, alpha4=0.02)
SENSOR = LikelihoodField(tempering=0.1)


def follow(grid, measurements, poses, rng, sensor=SENSOR):
    """Poses (T, 3) of all measurements, from the first particles (N, 3)."""
    known = KnownMap(grid)
    before, estimates = measurements[0].odometry.pose, []
    for odometry, scan in measurements:
        weigh = sensor(scan.beams(0.05, 30.0))

        def log_likelihood(poses, weigh=weigh):
            return weigh(known, np.zeros(len(poses), np.int32), poses)

        poses = mcl_step(poses, MOTION(between(before, odometry.pose)), log_likelihood, rng)
        before = odometry.pose
        heading = np.arctan2(np.sin(poses[:, 2]).mean(), np.cos(poses[:, 2]).mean())
        estimates.append([*poses[:, :2].mean(axis=0), heading])
    return np.array(estimates)


def localize(grid, measurements, pose, rng):
    """Poses (T, 3) of all measurements, from a first pose."""
    return follow(grid, measurements, pose + rng.normal(0, [0.1, 0.1, 0.05], (300, 3)), rng)


# %%
checks.robot_is_tracked(localize)
print("passed")

# %% [markdown]
# **Global localization.** Without an initial pose the belief is uniform over all free cells and all headings. MCL needs
# many more particles, one of which must be near the robot, and a wider likelihood: a narrow one soon leaves a few
# particles, of which none may be right.


# %% [task]
def draw_uniformly(grid, count, rng):
    """Draw poses anywhere in the free space of a map.

    Parameters
    ----------
    grid : OccupancyGrid
        `known` and `probability`, (H, W), [row = y, column = x]; cell [i, j] covers x from `origin[0] + j *
        resolution_m` and y from `origin[1] + i * resolution_m`. A cell is free if it is known and its probability is
        below 0.5.
    count : int
    rng : numpy.random.Generator

    Returns
    -------
    (count, 3) float64
        Uniform over the area of the free cells, and over headings in [-pi, pi).
    """
    cells = np.argwhere(grid.known & (grid.probability < 0.5))
    row, column = cells[rng.integers(len(cells), size=count)].T
    x = grid.origin[0] + (column + rng.random(count)) * grid.resolution_m
    y = grid.origin[1] + (row + rng.random(count)) * grid.resolution_m
    return np.stack([x, y, rng.uniform(-np.pi, np.pi, count)], axis=1)


# %%
WIDE = LikelihoodField(sigma_hit_m=0.5, tempering=0.02)


def localize_globally(grid, measurements, rng):
    """Poses (T, 3) of all measurements, from anywhere."""
    return follow(grid, measurements, draw_uniformly(grid, 5000, rng), rng, WIDE)


checks.poses_are_uniform(draw_uniformly)
checks.robot_is_found(localize_globally)
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
